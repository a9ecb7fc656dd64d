"""
Roles from the certificates of clients, and what rules make of them, through TLS.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from libmodbus_py import Allow, Context, Device, IllegalFunction, Mapping, Rules, Server, pdu
from libmodbus_py.serve import Asked
from tests.support.attacks import PATIENCE, adu
from tests.support.certificates import Papers, client
from tests.support.tls import TlsClient, context, serving

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
    found = []
    for request in REQUESTS:
        try:
            ask(request)
            found.append(True)
        except IllegalFunction:
            found.append(False)
    return found


@pytest.mark.parametrize(
    ("role", "expected"),
    [
        ("Viewer", [True, False, False, False]),
        ("Engineer", [True, True, True, True]),
        (None, [False, False, True, False]),
        ("viewer", [False, False, False, False]),
    ],
)
def test_rules_go_by_the_role_of_the_certificate(
    tmp_path: Path, role: str | None, expected: list[bool]
) -> None:
    papers = Papers(tmp_path)
    device = Device(Mapping(holding_registers=1), authorize=RULES)
    server = Server(device, security=papers.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], security=papers.client(role)) as plc,
    ):
        assert allowed(plc.execute) == expected
    assert server.statistics.unauthorized == expected.count(False)
    assert device.mapping.holding_registers[0] == (5 if role == "Engineer" else 0)


@pytest.mark.parametrize(
    ("role", "said"),
    [
        ("Viewer", "the server may allow it to other roles than 'Viewer'"),
        (None, "the server may allow it to some roles only, and this certificate has none"),
    ],
)
def test_a_refusal_over_tls_names_the_role(tmp_path: Path, role: str | None, said: str) -> None:
    papers = Papers(tmp_path)
    device = Device(Mapping(holding_registers=1), authorize=RULES)
    server = Server(device, security=papers.server())
    with (
        server.background("tls://127.0.0.1:0", "tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], security=papers.client(role)) as plc,
        Context.from_url(running.urls[1]) as without,
    ):
        for client, end in ((plc, f"; {said}"), (without, "")):
            with pytest.raises(IllegalFunction) as caught:
                client.write_register(0, 1)
            assert str(caught.value).endswith(f"illegal function (exception 1){end}")


def test_one_device_on_two_endpoints_asks_about_both(tmp_path: Path) -> None:
    """Who comes without TLS has no role, whoever else is there."""
    papers = Papers(tmp_path)
    server = Server(Device(Mapping(holding_registers=1), authorize=RULES), security=papers.server())
    with server.background("tls://127.0.0.1:0", "tcp://127.0.0.1:0") as running:
        secure, plain = running.urls
        with (
            Context.from_url(secure, security=papers.client("Engineer")) as engineer,
            Context.from_url(plain) as anybody,
        ):
            for _ in range(3):
                assert allowed(engineer.execute) == [True] * 4
                assert allowed(anybody.execute) == [False, False, True, False]


def test_roles_of_one_turn_are_kept_apart(tmp_path: Path) -> None:
    """Requests that come alone are answered together."""
    is_blocked, goes_on = threading.Event(), threading.Event()

    def authorize(asked: Asked) -> bool:
        if asked.function == 17:
            is_blocked.set()
            assert goes_on.wait(PATIENCE)
        return RULES(asked)

    papers = Papers(tmp_path)
    device = Device(Mapping(holding_registers=1), authorize=authorize)
    roles = ["Viewer", "Engineer", None, "Engineer", "Viewer"]
    write = adu(pdu.WriteRegister(0, 5).encode())
    with contextlib.ExitStack() as stack:
        server, port = stack.enter_context(serving(papers, device))
        busy, *clients = (
            stack.enter_context(TlsClient(port, context(papers, client(role))).handshake())
            for role in ["Engineer", *roles]
        )
        busy.send(adu(b"\x11"))
        assert is_blocked.wait(PATIENCE)
        for each in clients:
            each.send(write)
        goes_on.set()
        answers = [each.receive(9)[7:] for each in clients]
    assert answers == [write[7:9] if role == "Engineer" else b"\x86\x01" for role in roles]
    assert (server.statistics.requests, server.statistics.unauthorized) == (6, 3)
