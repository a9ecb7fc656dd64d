"""Length rules of registered classes that raise or return nonsense: only a frame is lost."""

from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Gateway,
    IllegalDataValue,
    Mapping,
    ModbusError,
    Route,
    Server,
    pdu,
)
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, RtuFramer
from libmodbus_py.protocol.rtu import may_be
from tests.simulation.lan import Lan, LineEnd
from tests.support.cases import each_case
from tests.support.driver import rtu
from tests.support.framing import registration

READ, ANSWER = rtu("01 03 0000 0001"), rtu("01 03 02 0007")
OWN, REFUSAL = rtu("01 6D 01 02"), rtu("01 ED 03")
LINE = "rtu:///dev/line?baudrate=115200"


def _fails(head: bytes) -> int | None:
    raise LookupError("a mistake in a rule")


RULES: dict[str, Callable[[bytes], Any]] = {
    "raises": _fails,
    "negative": lambda head: -1,
    "text": lambda head: "4",
    "fraction": lambda head: 4.0,
    "index": lambda head: head[99],
}


@each_case("rule", RULES.values(), ids=RULES)
@each_case("role", ["server", "client"])
def test_frames_after_the_wrong_length_are_found(role: Any, rule: Callable[[bytes], Any]) -> None:
    """A server takes a whole burst for a request, which is refused."""
    good = READ if role == "server" else ANSWER
    with registration(rule):
        framer = RtuFramer(role)
        results = framer.scan(OWN) + framer.scan_silence()
        assert any(isinstance(result, FrameError) for result in results) == (role == "client")
        for _ in range(2):
            results = framer.scan(good) + framer.scan_silence()
            assert results == [Frame(1, good[1:-2])]


@each_case("rule", RULES.values(), ids=RULES)
def test_a_request_whose_length_rule_fails_is_refused(rule: Callable[[bytes], Any]) -> None:
    with registration(rule), pytest.raises(IllegalDataValue):
        pdu.decode_request(OWN[1:-2])


def test_a_mistake_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with registration(_fails):
        for _ in range(3):
            RtuFramer("server").scan(OWN)
            may_be(OWN[1:-2])
    (record,) = caplog.records
    assert "Own" in record.getMessage()
    assert record.exc_info is not None
    assert "a mistake in a rule" in str(record.exc_info[1])


@pytest.mark.parametrize("kind", ["server", "gateway"])
def test_servers_and_gateways_on_a_line_continue_after_a_wrong_length_rule(lan: Lan, kind: str):
    device = Device(Mapping(holding_registers={0: [7]}))
    behind = "tcp://10.0.0.2:502" if kind == "gateway" else LINE
    with registration(_fails), Server({1: device}).background(behind):
        gateway = Gateway([Route("tcp://10.0.0.2:502", units="1")])
        if kind == "server":
            assert heard(lan) == REFUSAL + ANSWER
        else:
            with gateway.background(LINE):
                assert heard(lan) == REFUSAL + ANSWER


def heard(lan: Lan) -> bytes:
    master = LineEnd(lan.line("/dev/line"))
    for data in (OWN, READ):
        master.write(data)
        lan.pass_time(0.5)
    return master.heard


def test_a_client_on_a_line_continues_after_a_wrong_length_rule(lan: Lan) -> None:
    """The answers to its own class are lost, and nothing else."""
    device = Device(Mapping(holding_registers={0: [7]}))
    with (
        registration(_fails) as own,
        Server({1: device}).background(LINE),
        Client(LINE, unit=1, timeout=0.5) as context,
    ):
        with pytest.raises(ModbusError):
            context.execute(own(0x6D, b"\1\2"))
        assert context.read_holding_registers(0, 1) == [7]
