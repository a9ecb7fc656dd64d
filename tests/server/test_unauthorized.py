"""What a role may not do, over every transport: exception 1, counted, and nothing done."""

import contextlib
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest

from fuzz.checks import REQUEST_OBJECTS, examples
from libmodbus_py import Allow, Client, Device, Fault, IllegalFunction, Mapping, Rules, Server, pdu
from libmodbus_py.serve import ClientRequest
from tests.support import transports
from tests.support.attacks import ANSWER_ONE, PATIENCE, READ_ONE, adu, connect, receive
from tests.support.certificates import Pki, client
from tests.support.tls import TlsClient, context, serving
from tests.support.transports import TRANSPORTS


def guarded(authorize: Any) -> Device:
    return Device(
        Mapping(65536, 65536, 65536, 65536),
        files={3: [0] * 100, 4: [0] * 100},
        fifos={0x04DE: [1]},
        canopen=lambda data: data,
        authorize=authorize,
    )


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_unauthorized_requests_are_not_executed(transport: str) -> None:
    requests: list[ClientRequest] = []

    def authorize(asked: ClientRequest) -> bool:
        requests.append(asked)
        return False

    device = guarded(authorize)
    server = Server({17: device})
    with transports.serving(transport, server) as url, Client(url, unit=17) as plc:
        for request in REQUEST_OBJECTS:
            with pytest.raises(IllegalFunction):
                plc.execute(request)
    assert [asked.function for asked in requests] == [item.function for item in REQUEST_OBJECTS]
    role = "Operator" if transport == "tls" else None
    assert {(asked.unit, asked.role) for asked in requests} == {(17, role)}
    assert all(asked.peer for asked in requests)
    assert server.statistics.unauthorized == server.statistics.refused == len(requests)
    assert not any(device.mapping.holding_registers)
    assert not any(device.mapping.coils)


@pytest.mark.parametrize("many", [1, 8])
def test_unauthorized_requests_are_refused_one_by_one_and_in_batches(many: int) -> None:
    """The server answers chunks, and what comes alone, in C where it can."""
    numbered = [(number, pdu) for number, pdu in enumerate(examples("pdu")) if pdu[0] < 0x80]
    # Between requests to a device that C answers.
    other, other_answer = adu(READ_ONE, 0x99, 2), adu(ANSWER_ONE, 0x99, 2)
    plain, guarded_ = Device(Mapping(65536, 65536, 65536, 65536)), guarded(lambda asked: False)
    server = Server({1: guarded_, 2: plain})
    with server.background("tcp://127.0.0.1:0") as running, ExitStack() as stack:
        peers = [stack.enter_context(connect(running.urls[0])) for _ in range(3)]
        for at in range(0, len(numbered), many):
            chunk = numbered[at : at + many]
            requests = [adu(pdu, number, 1) for number, pdu in chunk]
            refusals = [adu(bytes([pdu[0] | 0x80, 1]), number, 1) for number, pdu in chunk]
            answers = b"".join([other_answer, *refusals, other_answer])
            for peer in peers:
                peer.sendall(b"".join([other, *requests, other]))
            for peer in peers:
                assert receive(peer, len(answers)) == answers
    assert server.statistics.unauthorized == 3 * len(numbered)
    assert not any(guarded_.mapping.holding_registers)


def test_faults_refuse_a_request_without_a_call_of_authorize() -> None:
    """A fault answers instead of the device: nothing is done, so nothing needs to be allowed."""
    requests: list[ClientRequest] = []
    server = Server({1: guarded(requests.append)}, faults={1: [Fault("exception", code=6)]})
    with (
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0]) as plc,
        pytest.raises(Exception, match="exception 6"),
    ):
        plc.execute(pdu.WriteCoil(0, True))
    assert requests == []


RULES = Rules(
    {
        "Viewer": Allow(read=["holding_registers"]),
        "Engineer": Allow("all", "all", "all"),
        None: Allow(functions=["43/14"]),
    }
)

REQUESTS = (
    pdu.ReadHoldingRegisters(0, 1),
    pdu.WriteRegister(0, 5),
    pdu.ReadDeviceIdentification(1),
    pdu.ReportServerId(),
)


def allowed(ask: Callable[[pdu.Request[object]], object]) -> list[bool]:
    results = []
    for request in REQUESTS:
        try:
            ask(request)
            results.append(True)
        except IllegalFunction:
            results.append(False)
    return results


@pytest.mark.parametrize(
    ("role", "results"),
    [
        ("Viewer", [True, False, False, False]),
        ("Engineer", [True, True, True, True]),
        (None, [False, False, True, False]),
        ("viewer", [False, False, False, False]),
    ],
)
def test_rules_apply_to_the_role_of_the_certificate(pki: Pki, role, results) -> None:
    device = Device(Mapping(holding_registers=1), authorize=RULES)
    server = Server(device, security=pki.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        Client(running.urls[0], security=pki.client(role)) as plc,
    ):
        assert allowed(plc.execute) == results
    assert server.statistics.unauthorized == results.count(False)
    assert device.mapping.holding_registers[0] == (5 if role == "Engineer" else 0)


@pytest.mark.parametrize(
    ("role", "role_text"),
    [
        ("Viewer", "the server may allow it to other roles than 'Viewer'"),
        (None, "the server may allow it to some roles only, and this certificate has none"),
    ],
)
def test_a_refusal_over_tls_names_the_role(pki: Pki, role: str | None, role_text: str) -> None:
    device = Device(Mapping(holding_registers=1), authorize=RULES)
    server = Server(device, security=pki.server())
    with (
        server.background("tls://127.0.0.1:0", "tcp://127.0.0.1:0") as running,
        Client(running.urls[0], security=pki.client(role)) as plc,
        Client(running.urls[1]) as without,
    ):
        for client, end in ((plc, f"; {role_text}"), (without, "")):
            with pytest.raises(IllegalFunction) as caught:
                client.write_register(0, 1)
            assert str(caught.value).endswith(f"illegal function (exception 1){end}")


def test_requests_of_several_roles_at_once_are_decided_separately(pki: Pki) -> None:
    """Requests that come alone are answered together."""
    is_blocked, goes_on = threading.Event(), threading.Event()

    def authorize(asked: ClientRequest) -> bool:
        if asked.function == 17:
            is_blocked.set()
            assert goes_on.wait(PATIENCE)
        return RULES(asked)

    device = Device(Mapping(holding_registers=1), authorize=authorize)
    roles = ["Viewer", "Engineer", None, "Engineer", "Viewer"]
    write = adu(pdu.WriteRegister(0, 5).encode())
    with contextlib.ExitStack() as stack:
        server, port = stack.enter_context(serving(pki, device))
        busy, *clients = (
            stack.enter_context(TlsClient(port, context(pki, client(role))).handshake())
            for role in ["Engineer", *roles]
        )
        busy.send(adu(b"\x11"))
        assert is_blocked.wait(PATIENCE)
        for entry in clients:
            entry.send(write)
        goes_on.set()
        answers = [client.receive(9)[7:] for client in clients]
    assert answers == [write[7:9] if role == "Engineer" else b"\x86\x01" for role in roles]
    assert (server.statistics.requests, server.statistics.unauthorized) == (6, 3)
