"""Servers on a line that returns all that is sent: no answer is carried out as a request."""

import logging
import time
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.serve import Fault
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.lan import Lan, LineEnd
from tests.simulation.lines import SerialLine
from tests.support.contexts import context_at
from tests.support.driver import ascii_frame, rtu
from tests.support.lan_server import unit_one
from tests.support.peers import LinePeer, Write, until

FRAMES = {"rtu": rtu, "ascii": ascii_frame}
WRITES = ["01 05 0001 FF00", "01 06 0001 0003", "01 16 0001 00FF 0000", "01 08 0000 A537"]
READ, READ_BACK = "01 03 0000 0001", "01 03 02 0000"
REFUSED = "01 06 0009 0003"
LINE, TCP = "/dev/line?baudrate=9600", "10.0.0.1:502"
STRAYS = [(b"", b""), (b"\0", b""), (b"", b"\0"), (b"\xff\0\xff", b"\xff")]


class Echoing:
    """Returns to each party of a line what it writes, when the line has carried it."""

    def __init__(
        self,
        lan: Lan,
        line: SerialLine,
        stray: tuple[bytes, bytes] = STRAYS[0],
        late: float = 0.0,
    ) -> None:
        self._late = late
        self._lan = lan
        self._line = line
        self._stray = stray
        self._write = line.write
        line.write = self.write  # type: ignore[method-assign]

    def write(self, sender: Any, data: bytes) -> None:
        self._write(sender, data)
        if not isinstance(sender, LineEnd):
            later = len(data) * self._line.character + self._late
            before, behind = self._stray
            self._lan.events.at(self._lan.events.now + later, sender.hear, before + data + behind)


class Converter:
    """A connection whose other end returns all that it receives, after a time."""

    def __init__(self, lan: Lan, way: float) -> None:
        end, _ = lan.connect("10.0.0.1", 502)
        assert end is not None
        self.heard = b""
        self._end = end
        self._lan = lan
        self._way = way
        lan.pass_time(0.1)
        end.on_input = self._return

    def write(self, data: bytes) -> None:
        self._end.send(data)

    def close(self) -> None:
        self._end.on_input = lambda: None
        self._end.close()

    def _return(self) -> None:
        while self._end.is_readable and (data := self._end.recv(4096)):
            self.heard += data
            self._lan.events.after(self._way, self._end.send, data)


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]


@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("request_", WRITES)
@pytest.mark.parametrize("stray", STRAYS)
@pytest.mark.parametrize("is_set", [False, True])
def test_writes_are_carried_out_once(
    lan: Lan, scheme, is_gateway, request_, stray, is_set, caplog
) -> None:
    """From the first on if the echo is set; else from the first read on, which shows it."""
    frame = FRAMES[scheme]
    url = f"{scheme}://{LINE}{'&echo=1' if is_set else ''}"
    with unit_one(url, is_gateway=is_gateway) as (server, writes):
        Echoing(lan, lan.line("/dev/line"), stray)
        master = LineEnd(lan.line("/dev/line"))
        if not is_set:
            master.write(frame(READ))
            lan.pass_time(1)
            assert master.heard == frame(READ_BACK)
        for count in (1, 2, 3):
            master.heard = b""
            master.write(frame(request_))
            lan.pass_time(1)
            assert master.heard == frame(request_)
            assert len(writes) == count * (request_[3:5] != "08")
        master.heard = b""
        master.write(frame(READ))
        lan.pass_time(1)
        assert len(master.heard) == len(frame(READ_BACK))
        assert server.statistics.echoes == (0 if is_set else 1)
        if stray == STRAYS[0]:
            assert server.statistics.bad_frames == 0
    messages = warnings(caplog)
    assert len(messages) == (0 if is_set else 1)
    for text in messages:
        assert text.startswith(f"{scheme}://{LINE}: what is sent comes back (local echo)")
        assert "set echo=1" in text


@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("telling", [READ, REFUSED])
@pytest.mark.parametrize("way", [0.0005, 0.02, 0.1])
@pytest.mark.parametrize("count", [1, 3])
def test_an_echo_over_tcp_is_found_beside_writes_that_are_returned(
    lan: Lan, scheme: str, telling: str, way: float, count: int
) -> None:
    frame = FRAMES[scheme]
    with unit_one(f"{scheme}+tcp://{TCP}") as (server, writes):
        end = Converter(lan, way)
        for _ in range(count):
            end.write(frame(WRITES[1]))
            lan.pass_time(way / 4)
        lan.pass_time(1)
        assert len(writes) > count
        assert server.statistics.echoes == 0
        end.write(frame(telling))
        lan.pass_time(1)
        assert server.statistics.echoes == 1
        writes.clear()
        for _ in range(3):
            end.write(frame(WRITES[1]))
            lan.pass_time(1)
        assert len(writes) == 3


@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("baudrate", [1200, 115200])
@pytest.mark.parametrize("late", [0.0, 0.016])
@pytest.mark.parametrize("stray", STRAYS)
def test_a_line_without_reads_executes_writes_once(
    lan: Lan, scheme, baudrate, late, stray, is_gateway, caplog
) -> None:
    """USB adapters keep bytes for up to 16 ms. Nothing was read, which would show the echo."""
    frame = FRAMES[scheme]
    url = f"{scheme}:///dev/line?baudrate={baudrate}"
    with unit_one(url, is_gateway=is_gateway) as (server, writes):
        Echoing(lan, lan.line("/dev/line"), stray, late)
        master = LineEnd(lan.line("/dev/line"))
        for count in (1, 2, 3):
            master.write(frame(WRITES[1]))
            lan.pass_time(2)
            assert len(writes) == count
        assert server.statistics.echoes == 1
        # One byte of another answer asked the line.
        answer = frame(WRITES[1])
        assert master.heard == answer + answer[:1] + answer * 2
        assert server.statistics.requests == 3
    assert len(warnings(caplog)) == 1


@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("request_", WRITES)
def test_an_equal_write_right_after_the_first_is_executed_again(
    lan: Lan, scheme: str, request_: str, is_gateway: bool
) -> None:
    frame = FRAMES[scheme]
    with unit_one(f"{scheme}://{LINE}", is_gateway=is_gateway) as (server, writes):
        master = LineEnd(lan.line("/dev/line"))
        for count in range(1, 6):
            master.write(frame(request_))
            while len(master.heard) < count * len(frame(request_)):
                lan.pass_time(0.001)
            lan.pass_time(0.004)
        assert master.heard == frame(request_) * 5
        assert len(writes) == 5 * (request_[3:5] != "08")
        assert server.statistics.echoes == 0
        assert server.statistics.requests == 5


@pytest.mark.parametrize("scheme", FRAMES)
def test_an_echo_that_comes_very_late_is_found_by_a_read(lan: Lan, scheme: str) -> None:
    frame = FRAMES[scheme]
    with unit_one(f"{scheme}://{LINE}") as (server, writes):
        Echoing(lan, lan.line("/dev/line"), late=0.2)
        master = LineEnd(lan.line("/dev/line"))
        master.write(frame(WRITES[1]))
        lan.pass_time(1)
        assert len(writes) > 1
        for _ in range(3):  # it may meet an answer on the line
            master.write(frame(READ))
            lan.pass_time(1)
        assert server.statistics.echoes == 1
        writes.clear()
        master.write(frame(WRITES[1]))
        lan.pass_time(1)
        assert len(writes) == 1


def test_noise_while_an_echo_is_searched_for_is_no_echo(lan: Lan) -> None:
    with unit_one(f"rtu://{LINE}") as (server, writes):
        master = LineEnd(lan.line("/dev/line"))
        write = rtu(WRITES[1])
        for data in (write, write):
            master.write(data)
            lan.pass_time(0.03)
        lan.pass_time(0.02)
        assert master.heard == write + write[:1]
        master.write(b"\xff")
        lan.pass_time(0.1)
        assert master.heard == write * 2
        assert len(writes) == 2
        assert server.statistics.echoes == 0


def test_a_server_can_be_closed_while_it_searches_for_an_echo(lan: Lan) -> None:
    with unit_one(f"rtu://{LINE}") as (_, writes):
        master = LineEnd(lan.line("/dev/line"))
        for _ in range(2):
            master.write(rtu(WRITES[1]))
            lan.pass_time(0.03)
        assert len(writes) == 1
    lan.pass_time(1)
    assert len(writes) == 1


@pytest.mark.parametrize("scheme", FRAMES)
def test_a_server_over_tcp_with_the_option_echo_ignores_its_answers(lan: Lan, scheme, caplog):
    frame = FRAMES[scheme]
    with unit_one(f"{scheme}+tcp://{TCP}?echo=1") as (server, writes):
        end = Converter(lan, 0.02)
        for _ in range(3):
            end.write(frame(WRITES[1]))
            lan.pass_time(1)
        assert len(writes) == 3
        assert server.statistics.echoes == 0
    assert not warnings(caplog)


def test_no_echo_is_searched_for_with_the_option_set_to_0(lan: Lan) -> None:
    for url in (f"rtu://{LINE}&echo=0", f"rtu+tcp://{TCP}?echo=0"):
        with unit_one(url) as (server, _):
            Echoing(lan, lan.line("/dev/line"))
            end = LineEnd(lan.line("/dev/line")) if "line" in url else Converter(lan, 0.01)
            for _ in range(3):
                end.write(rtu(READ))
                lan.pass_time(1)
            assert server.statistics.echoes == 0
            assert server.statistics.requests == 3


def test_connections_with_an_echo_are_all_counted_and_logged_once(lan: Lan, caplog) -> None:
    with unit_one(f"rtu+tcp://{TCP}") as (server, _):
        for count in (1, 2, 3):
            end = Converter(lan, 0.01)
            end.write(rtu(READ))
            lan.pass_time(1)
            assert server.statistics.echoes == count
            end.close()
    (message,) = warnings(caplog)
    assert message.startswith(f"rtu+tcp://{TCP}: what is sent comes back")


def test_an_echo_is_searched_for_again_after_a_port_was_unplugged(lan: Lan) -> None:
    with unit_one(f"rtu://{LINE}") as (server, writes):
        line = lan.line("/dev/line")
        master = LineEnd(line)
        master.write(rtu(READ))
        lan.pass_time(1)
        line.unplug()
        lan.pass_time(1)
        line.is_unplugged = False
        lan.pass_time(3)
        Echoing(lan, line)
        master = LineEnd(line)
        master.write(rtu(READ))
        lan.pass_time(1)
        assert server.statistics.echoes == 1
        master.write(rtu(WRITES[1]))
        lan.pass_time(1)
        assert len(writes) == 1


@pytest.mark.parametrize("scheme", FRAMES)
def test_an_echo_of_a_slow_answer_is_recognised(lan: Lan, scheme: str) -> None:
    faults = {1: [Fault("trickle", seconds=0.005)]}
    with unit_one(f"{scheme}://{LINE}&echo=1", faults=faults) as (_, writes):
        Echoing(lan, lan.line("/dev/line"))
        master = LineEnd(lan.line("/dev/line"))
        for count in (1, 2, 3):
            master.write(FRAMES[scheme](WRITES[1]))
            lan.pass_time(2)
            assert len(writes) == count


def test_a_request_that_begins_like_the_last_answer_is_answered_after_silence(lan: Lan) -> None:
    """Status 41h: the answer to function 7 is its request and a zero byte."""
    device = Device(Mapping(holding_registers=4), exception_status=0x41)
    for url in (f"rtu://{LINE}", f"rtu+tcp://{TCP}"):
        with Server({1: device}).background(url):
            for _ in range(3):
                if "line" in url:
                    end: Any = LineEnd(lan.line("/dev/line"))
                    end.write(rtu("01 07"))
                    lan.pass_time(0.1)
                    assert end.heard == rtu("01 07 41")
                else:
                    end = lan.client(url)
                    for _ in range(3):
                        end.sendall(rtu("01 07"))
                        assert end.receive(5) == rtu("01 07 41")
                    end.close()


@pytest.mark.parametrize("baudrate", [9600, 115200])
@pytest.mark.parametrize("is_read_first", [False, True])
def test_a_terminal_that_echoes_is_recognised(baudrate: int, is_read_first: bool) -> None:
    """On a real port, where bytes take no time."""

    def echo(data: bytes, write: Write) -> None:
        write(data)

    with (
        LinePeer(echo) as line,
        unit_one(f"rtu://{line.path}?baudrate={baudrate}") as (server, writes),
    ):
        if is_read_first:
            line.write(rtu(READ))
            until(lambda: server.statistics.echoes == 1)
        line.write(rtu(WRITES[1]))
        until(lambda: bool(writes) and server.statistics.echoes == 1)
        line.write(rtu(WRITES[0]))
        until(lambda: len(writes) == 2)
        time.sleep(0.1)
    assert len(writes) == 2


@pytest.mark.parametrize("face", [Client, context_at])
def test_a_repeated_write_of_a_client_on_a_terminal_is_executed(face: Any) -> None:
    with SerialWire() as wire, unit_one(f"rtu://{wire.server}?baudrate=9600") as (server, writes):
        with face(f"rtu://{wire.client}?baudrate=9600", unit=1, timeout=1.0) as asks:
            for _ in range(20):
                asks.write_register(1, 3)
        assert server.statistics.echoes == 0
    assert len(writes) == 20
