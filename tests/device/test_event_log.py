"""Counters, event log, listen-only mode and delimiter, on serial lines (sections 6.8-6.10)."""

from collections.abc import Iterator
from typing import ClassVar

import pytest

from libmodbus_py import (
    Client,
    Device,
    IllegalDataAddress,
    Mapping,
    ModbusTimeoutError,
    Server,
    ServerDeviceBusy,
    ServerDeviceFailure,
    framing,
    pdu,
)
from libmodbus_py.errors import NegativeAcknowledge
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.protocol.pdu import SubFunction
from tests.simulation.lan import Lan, LineEnd

DEVICE = "/dev/ttyS0"

COUNTERS = {
    "messages": SubFunction.BUS_MESSAGE_COUNT,
    "errors": SubFunction.BUS_COMMUNICATION_ERROR_COUNT,
    "exceptions": SubFunction.BUS_EXCEPTION_ERROR_COUNT,
    "served": SubFunction.SERVER_MESSAGE_COUNT,
    "unanswered": SubFunction.SERVER_NO_RESPONSE_COUNT,
    "nak": SubFunction.SERVER_NAK_COUNT,
    "busy": SubFunction.SERVER_BUSY_COUNT,
    "overrun": SubFunction.BUS_CHARACTER_OVERRUN_COUNT,
}


class Refusals:
    """A hook that refuses by the value that is written."""

    errors: ClassVar = {5: NegativeAcknowledge, 6: ServerDeviceBusy, 7: ServerDeviceFailure}

    def __call__(self, access) -> None:  # type: ignore[no-untyped-def]
        if error := self.errors.get(access.values[0]):
            raise error


@pytest.fixture
def devices() -> dict[int, Device]:
    return {
        unit: Device(Mapping(holding_registers=10, coils=8), before_write=Refusals())
        for unit in (1, 2)
    }


@pytest.fixture(params=["rtu", "ascii"])
def line(request: pytest.FixtureRequest, lan: Lan, devices: dict[int, Device]) -> Iterator[Client]:
    with (
        Server(devices).background(f"{request.param}://{DEVICE}?baudrate=115200"),
        Client(
            f"{request.param}://{DEVICE}?baudrate=115200", timeout=0.15, turnaround=0.01
        ) as context,
    ):
        yield context


ascii_only = pytest.mark.parametrize("line", ["ascii"], indirect=True)


def send(context: Client, data: bytes) -> None:
    """Write bytes that are no request, and let the server read them."""
    context._driver._port._write(data)


def counters(context: Client) -> dict[str, int]:
    """Each read of a counter is a message of its own, and is counted as one."""
    return {name: context.diagnostics(counter) for name, counter in COUNTERS.items()}


def frame(context: Client, unit: int, body: bytes) -> bytes:
    framer = framing.make_framer(parse(context.url).framing, "client")
    return framer.encode(framing.Frame(unit, body))


def spoilt_frame(context: Client) -> bytes:
    frame_ = bytearray(frame(context, 1, pdu.ReadCoils(0, 1).encode()))
    frame_[3] ^= 1
    return bytes(frame_)


def test_every_counter_counts_its_events(line: Client) -> None:
    line.diagnostics(SubFunction.CLEAR_COUNTERS)
    # A request and its answer are one message: the answer is this device's own.
    line.read_holding_registers(0, 1)
    with pytest.raises(IllegalDataAddress):
        line.read_holding_registers(10, 1)
    with pytest.raises(NegativeAcknowledge):
        line.write_register(0, 5)
    with pytest.raises(ServerDeviceBusy):
        line.write_register(0, 6)
    line.for_unit(0).write_register(1, 3)
    line.for_unit(2).read_coils(0, 1)
    with pytest.raises(ModbusTimeoutError):
        line.for_unit(3).read_coils(0, 1)
    send(line, spoilt_frame(line))
    # 5 for this unit, 1 broadcast, 2 for others; each question is one more.
    assert counters(line) == {
        "messages": 4 + 1 + 2 + 1,
        "errors": 1,
        "exceptions": 3,
        "served": 4 + 1 + 4,
        "unanswered": 1,
        "nak": 1,
        "busy": 1,
        "overrun": 0,
    }


def test_units_on_one_line_count_for_themselves(line: Client) -> None:
    other = line.for_unit(2)
    for context in (line, other):
        context.diagnostics(SubFunction.CLEAR_COUNTERS)
    for _ in range(5):
        other.read_coils(0, 1)
    assert line.diagnostics(SubFunction.SERVER_MESSAGE_COUNT) == 1
    assert other.diagnostics(SubFunction.SERVER_MESSAGE_COUNT) == 6
    # All that passed since each was cleared: bus messages are the line's.
    assert line.diagnostics(SubFunction.BUS_MESSAGE_COUNT) == 9


def test_event_log_has_the_last_64_events_newest_first(line: Client) -> None:
    line.diagnostics(SubFunction.RESTART_COMMUNICATIONS, 0xFF00)
    line.read_coils(0, 1)
    with pytest.raises(IllegalDataAddress):
        line.read_coils(8, 1)
    for value, error in ((5, NegativeAcknowledge), (6, ServerDeviceBusy), (7, ServerDeviceFailure)):
        with pytest.raises(error):
            line.write_register(0, value)
    line.for_unit(0).write_register(1, 3)
    send(line, spoilt_frame(line))
    log = line.read_comm_event_log()
    oldest_first = "00 8040 8041 8048 8044 8042 c040 82 80"
    assert log.events[::-1] == bytes.fromhex(oldest_first)
    assert (log.status, log.message_count, log.event_count) == (0, 7, 2)
    for _ in range(40):
        line.read_coils(0, 1)
    assert line.read_comm_event_log().events == bytes.fromhex("80" + "4080" * 31 + "40")


def test_listen_only_is_silent_until_restarted(line: Client, devices: dict[int, Device]) -> None:
    line.diagnostics(SubFunction.RESTART_COMMUNICATIONS, 0xFF00)
    assert line.diagnostics(SubFunction.FORCE_LISTEN_ONLY) == 0
    for ask in (
        lambda: line.read_coils(0, 1),
        lambda: line.write_register(0, 1),
        lambda: line.read_coils(60000, 1),
        lambda: line.diagnostics(SubFunction.RETURN_QUERY_DATA, 0xA537),
        lambda: line.diagnostics(SubFunction.RESTART_COMMUNICATIONS),
    ):
        with pytest.raises(ModbusTimeoutError):
            ask()
    assert devices[1].mapping.holding_registers[0] == 0
    line.write_register(0, 9)  # the restart was executed, though not answered
    assert devices[1].mapping.holding_registers[0] == 9
    log = line.read_comm_event_log().events[::-1]
    assert log[:4] == bytes.fromhex("00 80 04 60")
    assert log[4:12] == bytes.fromhex("a060" * 4)
    assert log[12:15] == bytes.fromhex("a0 60 00")


def test_broadcasts_are_not_executed_in_listen_only(line: Client, devices: dict[int, Device]):
    line.diagnostics(SubFunction.FORCE_LISTEN_ONLY)
    line.for_unit(0).write_register(0, 77)
    line.for_unit(2).read_coils(0, 1)
    assert [device.mapping.holding_registers[0] for device in devices.values()] == [0, 77]


def test_broadcasts_of_what_is_no_write_do_nothing_but_count(lan: Lan, line: Client) -> None:
    line.diagnostics(SubFunction.CLEAR_COUNTERS)
    for body in (b"\x03\0\0\0\1", b"\x08\0\4\0\0", b"\x08\0\1\0\0", b"\x41", b"\x18\0\0"):
        send(line, frame(line, 0, body))
        lan.pass_time(0.05)  # more than the silence between two frames
    counts = counters(line)
    assert counts["messages"] == 1 + 5
    assert counts["unanswered"] == 5
    assert counts["exceptions"] == 0


@ascii_only
def test_clearing_the_overrun_counter_leaves_the_others(line: Client) -> None:
    send(line, b":" + b"00" * 300)
    assert line.diagnostics(SubFunction.BUS_CHARACTER_OVERRUN_COUNT) == 1
    assert line.diagnostics(SubFunction.CLEAR_OVERRUN) == 0
    assert line.diagnostics(SubFunction.BUS_CHARACTER_OVERRUN_COUNT) == 0
    assert line.diagnostics(SubFunction.BUS_COMMUNICATION_ERROR_COUNT) == 1


@ascii_only
def test_ascii_delimiter_changes_after_the_echo_both_ways(lan: Lan, line: Client) -> None:
    listener = LineEnd(lan.line(DEVICE))
    assert line.diagnostics(SubFunction.CHANGE_ASCII_DELIMITER, 0x2400) == 0x2400
    assert listener.heard.endswith(b"\r\n")
    listener.heard = b""
    framer = framing.AsciiFramer()
    framer.delimiter = 0x24
    request = framer.encode(framing.Frame(1, pdu.ReadHoldingRegisters(0, 1).encode()))
    assert request.endswith(b"\r$")
    send(line, request)
    assert lan.until(lambda: listener.heard.count(b"\r$") == 2)
    answer = listener.heard.removeprefix(request)
    assert framer.feed(answer) == [framing.Frame(1, b"\x03\x02\0\0")]
