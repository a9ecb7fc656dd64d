"""
Servers on a port that returns all that is sent: their answers are not carried out as requests.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py import Context, Device, Gateway, Mapping, Route, Server
from tests.simulation.lines import SerialLine
from tests.simulation.stage import LineEnd, Stage
from tests.support.talk import ascii_frame, rtu

FRAMES = {"rtu": rtu, "ascii": ascii_frame}
WRITES = ["01 05 0001 FF00", "01 06 0001 0003", "01 16 0001 00FF 0000", "01 08 0000 A537"]
READ = "01 03 0001 0001"


class Echoing:
    """Returns to each party of a line what it writes, when the line has carried it."""

    def __init__(self, stage: Stage, line: SerialLine) -> None:
        self.is_on = True
        self._stage = stage
        self._line = line
        self._write = line.write
        line.write = self.write  # type: ignore[method-assign]

    def write(self, sender: Any, data: bytes) -> None:
        self._write(sender, data)
        if self.is_on and not isinstance(sender, LineEnd):
            later = len(data) * self._line.character
            self._stage.events.at(self._stage.events.now + later, sender.hear, data)


@contextmanager
def served(stage: Stage, scheme: str, is_gateway: bool) -> Iterator[tuple[Any, list[Any]]]:
    writes: list[Any] = []
    device = Device(Mapping(holding_registers=4, coils=4), before_write=writes.append)
    line = f"{scheme}:///dev/line?baudrate=9600"
    server = Server({1: device})
    if not is_gateway:
        with server.background(line):
            yield server, writes
        return
    gateway = Gateway([Route("tcp://10.0.0.2:502", units="1")])
    with server.background("tcp://10.0.0.2:502"), gateway.background(line):
        yield gateway, writes


@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("request_", WRITES)
def test_an_echo_is_not_carried_out(
    stage: Stage,
    scheme: str,
    is_gateway: bool,
    request_: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    frame = FRAMES[scheme]
    with served(stage, scheme, is_gateway) as (server, writes):
        Echoing(stage, stage.line("/dev/line"))
        master = LineEnd(stage.line("/dev/line"))
        for count in (1, 2, 3):
            master.heard = b""
            master.write(frame(request_))
            stage.pass_time(1)
            assert master.heard == frame(request_)
            assert len(writes) == count * (request_[3:5] != "08")
        master.heard = b""
        master.write(frame(READ))
        stage.pass_time(1)
        assert len(master.heard) == len(frame("01 03 02 0000"))
        assert server.statistics.echoes == 1
        assert server.statistics.bad_frames == 0
    told = [each for each in caplog.records if each.levelno == logging.WARNING]
    assert len(told) == 1
    assert "echo" in told[0].getMessage()


def test_an_answer_that_is_no_request_shows_the_echo(stage: Stage) -> None:
    with served(stage, "rtu", False) as (server, writes):
        Echoing(stage, stage.line("/dev/line"))
        master = LineEnd(stage.line("/dev/line"))
        for request in (READ, WRITES[1], READ, WRITES[1]):
            master.write(rtu(request))
            stage.pass_time(1)
        assert len(writes) == 2
        assert server.statistics.requests == 4
        assert server.statistics.echoes == 1


@pytest.mark.parametrize("pause", [0.0, 0.05])
def test_a_client_that_repeats_a_write_is_no_echo(stage: Stage, pause: float) -> None:
    line = "rtu:///dev/line?baudrate=9600"
    with served(stage, "rtu", False) as (server, writes):
        with Context.from_url(line, unit=1, timeout=1) as plc:
            for _ in range(60):
                plc.write_register(1, 3)
                stage.pass_time(pause)
        assert len(writes) == 60
        assert server.statistics.echoes == 0


def test_an_echo_that_is_late_is_found_out_in_the_end(stage: Stage) -> None:
    """An adapter keeps bytes for 16 ms, so that an echo may as well be a request."""
    with served(stage, "rtu", False) as (server, writes):
        line = stage.line("/dev/line")
        line.character = 11 / 115200
        echoing = Echoing(stage, line)
        echoing.is_on = False
        carried = line.write

        def late(sender: Any, data: bytes) -> None:
            carried(sender, data)
            if not isinstance(sender, LineEnd):
                stage.events.at(stage.events.now + 0.02, sender.hear, data)

        line.write = late  # type: ignore[method-assign]
        LineEnd(line).write(rtu(WRITES[1]))
        stage.pass_time(60)
        assert len(writes) <= 66
        assert server.statistics.echoes == 1


def test_a_terminal_that_echoes(tmp_path: object) -> None:
    """As above, on a real port, where bytes take no time."""
    from libmodbus_py.tools.testing.line_ends import open_line, write_all
    from tests.support.peers import until

    far, near, path = open_line()
    writes: list[Any] = []
    heard = bytearray()

    def echo() -> bool:
        try:
            data = os.read(far, 4096)
        except BlockingIOError:
            return len(heard) >= len(READ_BACK)
        heard.extend(data)
        write_all(far, data)
        return len(heard) >= len(READ_BACK)

    device = Device(Mapping(holding_registers=4), before_write=writes.append)
    server = Server({1: device})
    try:
        with server.background(f"rtu://{path}?baudrate=9600"):
            write_all(far, rtu("01 03 0000 0001"))
            until(echo)
            until(lambda: server.statistics.echoes == 1)
            heard.clear()
            write_all(far, rtu(WRITES[1]))
            until(echo)
            until(lambda: len(writes) == 1)
    finally:
        os.close(far)
        os.close(near)
    assert len(writes) == 1


READ_BACK = rtu("01 03 02 0000")
