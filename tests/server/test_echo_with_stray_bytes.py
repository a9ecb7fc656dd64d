"""
A server's own answers that come back with stray bytes around them, or over TCP.
"""

from __future__ import annotations

import logging
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.protocol.returned import AwaitedEcho
from libmodbus_py.server.echo import EchoWatch
from tests.simulation.stage import LineEnd, Stage
from tests.support.talk import ascii_frame, rtu

FRAMES = {"rtu": rtu, "ascii": ascii_frame}
WRITES = ["01 05 0001 FF00", "01 06 0001 0003", "01 16 0001 00FF 0000", "01 08 0000 A537"]


@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("around", [(b"\x00", b""), (b"", b"\x00"), (b"\xff\x00", b"\xff")])
@pytest.mark.parametrize("request_", WRITES)
def test_stray_bytes_around_an_echo_fool_no_server(
    stage: Stage, scheme: str, around: tuple[bytes, bytes], request_: str
) -> None:
    frame = FRAMES[scheme](request_)
    writes: list[Any] = []
    device = Device(Mapping(holding_registers=4, coils=4), before_write=writes.append)
    server = Server({1: device})
    with server.background(f"{scheme}:///dev/line?baudrate=9600"):
        line = stage.line("/dev/line")
        carried = line.write

        def write(sender: Any, data: bytes) -> None:
            carried(sender, data)
            if not isinstance(sender, LineEnd):
                later = stage.events.now + len(data) * line.character
                stage.events.at(later, sender.hear, around[0] + data + around[1])

        line.write = write  # type: ignore[method-assign]
        master = LineEnd(line)
        for count in (1, 2, 3):
            master.heard = b""
            master.write(frame)
            stage.pass_time(1)
            assert master.heard == frame
            assert len(writes) == count * (request_[3:5] != "08")
        assert server.statistics.echoes == 1


@pytest.mark.parametrize("data", [b"\x01\x07\x41\xe2", b"\x01\x11\xc0\x2c"])
def test_a_short_request_is_never_held_back(data: bytes) -> None:
    awaited = AwaitedEcho(rtu("01 03 02 0001"))
    assert awaited.without(data) == data


def test_an_echo_behind_stray_bytes_that_come_alone() -> None:
    sent = rtu("01 03 02 0001")
    awaited = AwaitedEcho(sent)
    got = b"".join(awaited.without(bytes([each])) for each in b"\x00\xff" + sent + b"\x09")
    assert got == b"\x00\xff\x09"
    assert awaited.came


def test_more_stray_bytes_than_a_transceiver_makes_are_no_echo() -> None:
    sent = rtu("01 06 0001 0003")
    watch = EchoWatch("rtu", 0.0, 0.001)
    watch.sent(sent, 0.0)
    assert watch.without_echo(b"\x09" * 5 + sent, 0.01) == b"\x09" * 5 + sent
    assert watch.has_echo is False


@pytest.mark.parametrize("scheme", ["rtu+tcp", "ascii+tcp"])
@pytest.mark.parametrize("request_", WRITES)
@pytest.mark.parametrize("way", [0.0005, 0.1])
def test_an_echo_over_tcp_ends(
    stage: Stage, scheme: str, request_: str, way: float, caplog: pytest.LogCaptureFixture
) -> None:
    writes: list[Any] = []
    device = Device(Mapping(holding_registers=4, coils=4), before_write=writes.append)
    server = Server({1: device})
    frame = FRAMES[scheme[:-4]](request_)
    with server.background(f"{scheme}://10.0.0.1:502"):
        end = Returning(stage, way)
        end.write(frame)
        stage.pass_time(60)
        assert len(writes) <= 70
        assert server.statistics.echoes == 1
        writes.clear()
        for _ in range(3):
            end.write(frame)
            stage.pass_time(1)
        assert len(writes) == 3 * (request_[3:5] != "08")
    told = [each for each in caplog.records if each.levelno == logging.WARNING]
    assert len(told) == 1


class Returning:
    """A connection whose other end returns all that it receives, after a time."""

    def __init__(self, stage: Stage, way: float) -> None:
        end, _ = stage.connect("10.0.0.1", 502)
        assert end is not None
        self._end = end
        self._stage = stage
        self._way = way
        stage.pass_time(0.1)
        end.on_input = self._return

    def write(self, data: bytes) -> None:
        self._end.send(data)

    def _return(self) -> None:
        while self._end.is_readable and (data := self._end.recv(4096)):
            self._stage.events.after(self._way, self._end.send, data)
