"""
Over TCP and UDP: who answers the units 0 and 255, and what is counted as messages.

Messaging guide V1.0b, 4.4.2: a server is addressed by its IP address, unit 255 (or 0) says
so. Application protocol V1.1b3, 6.8 (sub-function 11) and 6.10: messages.
"""

import socket
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Client, Device, Fault, Mapping, Server, pdu
from libmodbus_py.protocol import errors
from libmodbus_py.protocol.framing import Frame, TcpFramer
from libmodbus_py.server.faults import Faults
from tests.support.attacks import READ_ONE, adu, ask, connect
from tests.support.cases import each_case

MESSAGES = pdu.SubFunction.BUS_MESSAGE_COUNT
both = pytest.mark.parametrize("scheme", ["tcp", "udp"])


def holding(value: int, **hooks: Any) -> Device:
    """A device whose register has this value, to tell it from others."""
    return Device(Mapping(holding_registers={0: [value, 0, 0, 0]}), **hooks)


def answers(server: Server, scheme: str, units: list[int]) -> list[int | bytes | None]:
    """
    The register that each of these units gives; or its exception; None for silence.

    Asked at once, so that TCP answers them by the chunk, and then one by one.
    """
    frames = [adu(READ_ONE, at, unit) for at, unit in enumerate(units)]
    # Unit 1 always answers, and so tells that nothing more comes.
    frames.append(adu(READ_ONE, 999, 1))
    with server.background(f"{scheme}://127.0.0.1:0") as running, connect(running.urls[0]) as peer:
        together = asked(peer, [b"".join(frames)] if scheme == "tcp" else frames)
        assert together == asked(peer, frames)
    return [together.get(at) for at in range(len(units))]


def asked(peer: socket.socket, pieces: list[bytes]) -> dict[int, int | bytes]:
    for piece in pieces:
        peer.sendall(piece)
    bodies: dict[int, int | bytes] = {}
    framer = TcpFramer()
    while 999 not in bodies:
        for number, body in ((item.transaction, item.pdu) for item in framer.feed(peer.recv(2000))):
            bodies[number] = body if body[0] & 0x80 else int.from_bytes(body[2:], "big")
    return bodies


REFUSED = b"\x83\x0b"


@both
@pytest.mark.parametrize("hooks", [{}, {"before_read": lambda access: None}], ids=["c", "python"])
def test_a_single_device_answers_units_0_and_255_too(scheme: str, hooks: Any) -> None:
    device = holding(7, **hooks)
    assert answers(Server(device), scheme, [0, 255, 1, 9]) == [7, 7, 7, 7]
    assert answers(Server({1: device}), scheme, [0, 255, 1, 9]) == [7, 7, 7, REFUSED]
    silent = Server({1: device}, unknown_unit="silent")
    assert answers(silent, scheme, [0, 255, 1, 9]) == [7, 7, 7, None]


@both
def test_own_unit_selects_one_of_several_devices(scheme: str) -> None:
    devices = {1: holding(7), 2: holding(8)}
    assert answers(Server(devices), scheme, [0, 255, 2]) == [REFUSED, REFUSED, 8]
    assert answers(Server(devices, unknown_unit="silent"), scheme, [0, 255]) == [None, None]
    assert answers(Server(devices, own_unit=2), scheme, [0, 255, 1]) == [8, 8, 7]
    assert answers(Server(devices, own_unit=1), scheme, [0, 255, 2]) == [7, 7, 8]


@both
def test_devices_with_the_units_0_and_255_answer_these_units(scheme: str) -> None:
    devices = {0: holding(6), 1: holding(7), 255: holding(9)}
    assert answers(Server(devices), scheme, [0, 255, 1]) == [6, 9, 7]
    assert answers(Server(devices, own_unit=1), scheme, [0, 255]) == [6, 9]
    assert answers(Server({1: holding(7), 255: holding(9)}, own_unit=255), scheme, [0]) == [9]
    assert answers(Server({1: holding(7), 0: holding(9)}, own_unit=0), scheme, [255]) == [9]


@each_case(
    ("devices", "unit", "error", "message"),
    [
        ({1: holding(7), 2: holding(8)}, 3, ValueError, r"unit that has a device \(1, 2\), not 3"),
        ({1: holding(7)}, 255, ValueError, r"own_unit .*\(1\), not 255"),
        ({}, 0, ValueError, r"own_unit .*\(none\), not 0"),
        ({1: holding(7)}, 256, ValueError, r"own_unit must be in 0..255, not 256"),
        ({1: holding(7)}, -1, ValueError, r"own_unit must be in 0..255, not -1"),
        ({1: holding(7)}, "1", TypeError, r"own_unit must be an integer in 0..255, not str"),
        ({1: holding(7)}, True, TypeError, r"own_unit must be an integer"),
        (holding(7), 1, ValueError, "one device answers every unit"),
    ],
)
def test_invalid_own_units_are_refused(devices, unit, error, message) -> None:
    with pytest.raises(error, match=message):
        Server(devices, own_unit=unit)


def test_lines_have_no_own_units() -> None:
    """Unit 0 is a broadcast there, and 255 reserved."""
    with (
        Server({1: holding(7)}, own_unit=1).background("rtu+tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=255, timeout=0.2) as plc,
    ):
        with pytest.raises(errors.ModbusTimeoutError):
            plc.read_holding_registers(0, 1)
        plc.for_unit(0).write_register(0, 3)
        assert plc.for_unit(1, timeout=20).read_holding_registers(0, 1) == [3]


@both
@pytest.mark.parametrize(
    ("faults", "codes"),
    [({1: 6}, [6, 6]), ({255: 5}, [None, 5]), ({1: 6, 255: 5}, [6, 5])],
    ids=str,
)
def test_faults_of_the_own_unit_apply_to_the_units_0_and_255(scheme: str, faults, codes) -> None:
    """Except for faults of the units 0 and 255 themselves."""
    faults_of_units = {unit: [Fault("exception", code=code)] for unit, code in faults.items()}
    server = Server({1: holding(7)}, faults=faults_of_units)
    with (
        server.background(f"{scheme}://127.0.0.1:0") as running,
        Client(running.urls[0], timeout=20) as plc,
    ):
        outcomes: list[int | None] = []
        for unit in (0, 255):
            try:
                plc.for_unit(unit).read_holding_registers(0, 1)
                outcomes.append(None)
            except errors.ExceptionResponse as refusal:
                outcomes.append(refusal.code)
    assert outcomes == codes


@pytest.fixture(params=["tcp", "udp", "rtu+tcp"])
def plc(request: pytest.FixtureRequest) -> Iterator[Client]:
    devices = {1: holding(7), 2: holding(8, before_read=lambda access: None)}
    with (
        Server(devices).background(f"{request.param}://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=20) as client,
    ):
        yield client


@pytest.mark.parametrize("unit", [1, 2], ids=["c", "python"])
def test_every_message_is_counted(plc: Client, unit: int) -> None:
    """Whoever answered it, the one that asks included; as on a serial line."""
    client = plc.for_unit(unit)
    assert client.diagnostics(MESSAGES) == 1
    # Over RTU an exception that follows two values is raised at the end of the timeout only.
    with pytest.raises(errors.IllegalDataAddress):
        client.read_holding_registers(9, 1)
    for _ in range(40):
        client.read_holding_registers(0, 1)
    client.write_register(1, 1)
    assert client.diagnostics(MESSAGES) == 44
    assert client.read_comm_event_log().message_count == 45
    assert client.diagnostics(pdu.SubFunction.SERVER_MESSAGE_COUNT) == 46
    client.diagnostics(pdu.SubFunction.CLEAR_COUNTERS)
    assert client.diagnostics(MESSAGES) == 1


@both
def test_messages_of_other_units_are_ignored(scheme: str) -> None:
    """There is no line on which they would pass."""
    devices = {1: holding(7), 2: holding(8)}
    with (
        Server(devices).background(f"{scheme}://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=20) as plc,
    ):
        for _ in range(3):
            plc.for_unit(2).read_holding_registers(0, 1)
            with pytest.raises(errors.GatewayTargetFailedToRespond):
                plc.for_unit(3).read_holding_registers(0, 1)
        assert plc.diagnostics(MESSAGES) == 1
        assert plc.for_unit(2).diagnostics(MESSAGES) == 4


@both
def test_function_codes_from_128_count_as_messages(scheme: str) -> None:
    """Function codes from 128 on; on lines, too."""
    with (
        Server(holding(7)).background(f"{scheme}://127.0.0.1:0") as running,
        connect(running.urls[0]) as peer,
    ):
        peer.sendall(adu(b"\x83\2", 1))
        ask(peer, adu(b"\x08\0\x0b\0\0", 2), adu(b"\x08\0\x0b\0\2", 2))


READ = b"\3\0\0\0\1"


def test_a_fault_that_does_not_apply_leaves_the_next_one() -> None:
    """Serial lines have no transactions."""
    transaction, answer = Fault("wrong_transaction"), Fault("no_answer")
    for has_transaction, result in ((True, transaction), (False, answer)):
        faults = Faults({1: [transaction, answer]})
        fault = faults.due(Frame(1, READ), has_transaction=has_transaction)
        assert fault == result


@pytest.mark.parametrize("pdu", [b"\x41\1", b"\x08\0\0\0\7", b"\x07", b"\3"])
def test_a_fault_without_a_table_applies_to_requests_without_an_address(pdu: bytes) -> None:
    everywhere = Faults({1: [Fault("no_answer")]})
    assert everywhere.due(Frame(1, pdu), has_transaction=True) is not None
    in_a_table = Faults({1: [Fault("no_answer", table="coils")]})
    assert in_a_table.due(Frame(1, pdu), has_transaction=True) is None
