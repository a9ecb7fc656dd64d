"""
Clients that write the same again and again, as watchdogs do: no echo, and no exception.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Context, Device, Mapping, Server
from tests.simulation.stage import LineEnd, Stage
from tests.support.talk import ascii_frame, rtu

FRAMES = {"rtu": rtu, "ascii": ascii_frame}
WRITES = ["01 05 0001 FF00", "01 06 0001 0003", "01 16 0001 00FF 0000"]
TCP, LINE = "10.0.0.1:502", "/dev/line?baudrate=115200"
URLS = [f"rtu+tcp://{TCP}", f"ascii+tcp://{TCP}", f"rtu://{LINE}", f"ascii://{LINE}"]


def serving(written: list[Any]) -> Server:
    device = Device(Mapping(holding_registers=4, coils=4), before_write=written.append)
    return Server({1: device})


@pytest.mark.parametrize("url", URLS)
@pytest.mark.parametrize("every", [0.0, 0.001, 0.03])
def test_each_of_many_equal_writes_is_answered_in_time(
    stage: Stage, url: str, every: float
) -> None:
    """As soon as the line allows; nothing else is asked on the connection."""
    written: list[Any] = []
    count = 10_000 if url.startswith("rtu") and every == 0.001 else 700
    server = serving(written)
    with (
        server.background(url),
        Context.from_url(url, unit=1, timeout=0.3, retries=0, busy_retries=0) as plc,
    ):
        for _ in range(count):
            plc.write_register(1, 3)
            stage.pass_time(every)
        assert len(written) == count
        assert server.statistics.echoes == 0
        assert server.statistics.bad_frames == 0
        assert plc.statistics.requests == plc.statistics.responses == count


def test_a_watchdog_meets_no_pause(stage: Stage) -> None:
    """Five times a second, over TCP: its answers come at once."""
    written: list[Any] = []
    url = URLS[0]
    with (
        serving(written).background(url),
        Context.from_url(url, unit=1, timeout=0.04, retries=0) as plc,
    ):
        for _ in range(1000):
            plc.write_register(1, 3)
            stage.pass_time(0.195)
        assert len(written) == 1000


@pytest.mark.parametrize("scheme", ["rtu+tcp", "ascii+tcp"])
@pytest.mark.parametrize("request_", WRITES)
def test_a_client_that_does_not_wait_for_answers_is_no_echo(
    stage: Stage, scheme: str, request_: str
) -> None:
    written: list[Any] = []
    frame = FRAMES[scheme[:-4]](request_)
    server = serving(written)
    with server.background(f"{scheme}://{TCP}"):
        end, _ = stage.connect("10.0.0.1", 502)
        assert end is not None
        stage.pass_time(0.1)
        got = b""
        for _ in range(200):
            end.send(frame)
            stage.pass_time(0.01)
            got += end.recv(4096) if end.is_readable else b""
        stage.pass_time(1)
        got += end.recv(4096) if end.is_readable else b""
        assert len(written) == 200
        # Of requests that wait together only the last one is answered.
        assert got == len(got) // len(frame) * frame
        assert len(got) > 190 * len(frame)
        assert server.statistics.echoes == 0


@pytest.mark.parametrize("way", [0.0005, 0.02, 0.1])
def test_an_echo_ends_beside_a_watchdog(stage: Stage, way: float) -> None:
    """Whose writes come back with all that the converter sends."""
    written: list[Any] = []
    server, frame = serving(written), rtu(WRITES[1])
    with server.background(f"rtu+tcp://{TCP}"):
        end, _ = stage.connect("10.0.0.1", 502)
        assert end is not None
        stage.pass_time(0.1)

        def come_back() -> None:
            while end.is_readable and (data := end.recv(4096)):
                stage.events.after(way, end.send, data)

        end.on_input = come_back
        for _ in range(100):
            end.send(frame)
            stage.pass_time(0.2)
        assert server.statistics.echoes == 1
        written.clear()
        for _ in range(20):
            end.send(frame)
            stage.pass_time(0.2)
        assert len(written) == 20


def test_a_connection_that_ends_during_a_trial(stage: Stage) -> None:
    written: list[Any] = []
    server, frame = serving(written), rtu(WRITES[1])
    with server.background(URLS[0]):
        end, _ = stage.connect("10.0.0.1", 502)
        assert end is not None
        stage.pass_time(0.1)
        got = b""
        while len(written) < 66:
            end.send(frame)
            stage.pass_time(0.003)
            got = end.recv(4096) if end.is_readable else b""
        assert len(got) == len(frame) - 1
        end.close()
        stage.pass_time(1)
        assert server.statistics.connections == 0


def test_a_line_that_is_unplugged_during_a_trial(stage: Stage) -> None:
    written: list[Any] = []
    server, frame = serving(written), rtu(WRITES[1])
    with server.background(URLS[2]):
        line = stage.line("/dev/line")
        master = LineEnd(line)
        heard = b""
        while not heard.endswith(frame[:-1]):
            master.heard = b""
            master.write(frame)
            stage.pass_time(0.006)
            heard = master.heard
        line.unplug()
        stage.pass_time(1)
        line.is_unplugged = False
        stage.pass_time(3)
        master = LineEnd(line)
        master.write(frame)
        stage.pass_time(0.1)
        assert master.heard == frame
