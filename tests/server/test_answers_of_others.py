"""
Servers on a line with other units: what these ask and answer is neither carried out nor damage.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py import Context, Device, Gateway, Mapping, Route, Server
from tests.simulation.stage import LineEnd, Stage
from tests.support.talk import ascii_frame, rtu

WRITE = rtu("01 06 0001 0003")
READ = rtu("01 03 0001 0001")
LINE = "rtu:///dev/line?baudrate=115200"

# What unit 2 is asked, and what it answers; a whole write to unit 1 is in each of the two first.
TRAFFIC = [
    (rtu("02 03 0000 0004"), rtu("02 03 08" + WRITE.hex())),
    (rtu("02 08 0000" + WRITE.hex()), rtu("02 08 0000" + WRITE.hex())),
    (rtu("02 06 0000 0001"), rtu("02 06 0000 0001")),
    (rtu("02 10 0000 0001 02 0007"), rtu("02 10 0000 0001")),
    (rtu("02 11"), rtu("02 11 02 07 FF")),
    (rtu("02 03 0000 0001"), rtu("02 83 02")),
    (rtu("02 00"), rtu("02 80 01")),
]


@contextmanager
def served(stage: Stage, *urls: str) -> Iterator[tuple[Server, Mapping, list[Any]]]:
    mapping = Mapping(holding_registers=4)
    writes: list[Any] = []
    device = Device(mapping, before_write=writes.append)
    server = Server({1: device})
    with server.background(*urls or (LINE,)):
        yield server, mapping, writes


@pytest.mark.parametrize("pause", [0.0, 0.002, 0.03])
def test_a_clean_line_with_other_units_counts_no_error(stage: Stage, pause: float) -> None:
    with served(stage) as (server, _mapping, writes):
        master, other = LineEnd(stage.line("/dev/line")), LineEnd(stage.line("/dev/line"))
        for request, answer in TRAFFIC:
            master.heard = b""
            for end, data in ((master, request), (other, answer), (master, READ)):
                end.write(data)
                stage.pass_time(max(pause, len(data) * 11 / 115200))
            stage.pass_time(0.1)
            assert master.heard == answer + rtu("01 03 02 0000"), request.hex()
        assert writes == []
        assert server.statistics.bad_frames == 0
        assert server.statistics.requests == 2 * len(TRAFFIC)
        # Of unit 1: frames on the line and damage (application protocol, 6.8).
        for counter, count in ((0x0B, 3 * len(TRAFFIC) + 1), (0x0C, 0)):
            master.heard = b""
            master.write(rtu(f"01 08 00{counter:02X} 0000"))
            stage.pass_time(0.1)
            assert master.heard == rtu(f"01 08 00{counter:02X} {count:04X}")


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
@pytest.mark.parametrize("unit", [0, 1, 2])
@pytest.mark.parametrize("body", ["80", "80 01", "83 02", "FF", "FF 0B"])
def test_a_good_frame_that_is_no_request_is_no_damage(
    stage: Stage, scheme: str, unit: int, body: str
) -> None:
    """A function of 80h or more, with a right CRC, is of another unit or of nobody's."""
    made = ascii_frame if scheme == "ascii" else rtu
    with served(stage, LINE.replace("rtu:", f"{scheme}:")) as (server, _mapping, writes):
        master = LineEnd(stage.line("/dev/line"))
        for _ in range(3):
            master.write(made(f"{unit:02X} {body}"))
            stage.pass_time(0.1)
            assert master.heard == b""
            master.write(made("01 03 0001 0001"))
            stage.pass_time(0.1)
            assert master.heard == made("01 03 02 0000")
            master.heard = b""
        assert server.statistics.bad_frames == 0
        assert writes == []
        master.write(made("01 08 000C 0000"))
        stage.pass_time(0.1)
        assert master.heard == made("01 08 000C 0000")


@pytest.mark.parametrize("unit", [1, 2])
def test_damage_with_such_a_function_is_counted(stage: Stage, unit: int) -> None:
    """A function of 80h or more and a wrong CRC."""
    with served(stage) as (server, _mapping, _writes):
        master = LineEnd(stage.line("/dev/line"))
        master.write(rtu(f"{unit:02X} 80")[:-1] + b"\x00")
        stage.pass_time(0.1)
        master.write(READ)
        stage.pass_time(0.1)
        assert master.heard == rtu("01 03 02 0000")
        assert server.statistics.bad_frames == 1


def test_a_gateway_hears_others_too(stage: Stage) -> None:
    """It is a unit on a line here, and another line is behind it."""
    mapping = Mapping(holding_registers=4)
    gateway = Gateway([Route("rtu:///dev/back?baudrate=115200", units="1")])
    with (
        Server({1: Device(mapping)}).background("rtu:///dev/back?baudrate=115200"),
        gateway.background(LINE),
    ):
        master, other = LineEnd(stage.line("/dev/line")), LineEnd(stage.line("/dev/line"))
        for request, answer in TRAFFIC:
            for end, data in ((master, request), (other, answer)):
                end.write(data)
                stage.pass_time(0.03)
        assert gateway.statistics.bad_frames == 0
        assert list(mapping.holding_registers) == [0] * 4
        master.heard = b""
        master.write(READ)
        stage.pass_time(0.5)
        assert master.heard == rtu("01 03 02 0000")


@pytest.mark.parametrize("head", ["08 0000", "2B 0D", "41"])
def test_a_frame_in_a_request_is_not_written_through_a_gateway(stage: Stage, head: str) -> None:
    """Nothing but reads and loopbacks may pass; the units behind are on one line."""
    mapping = Mapping(holding_registers=4)
    route = Route("rtu:///dev/line?baudrate=115200&timeout=0.1", read_only=True)
    with (
        served(stage) as (server, _, writes),
        Gateway([route]).background("tcp://10.0.0.1:0") as running,
        Context.from_url(running.urls[0], unit=2, timeout=5) as context,
    ):
        for unit in (1, 2):
            # Where the CRC fits for the first time, a write begins.
            body = rtu(f"{unit:02X}{head}")[1:] + WRITE * 5
            with stage.talk(running.urls[0]) as client:
                client.sendall(bytes([0, 1, 0, 0, 0, len(body) + 1, unit]) + body)
                assert len(client.receive(9)) == 9
        assert context.for_unit(1).read_holding_registers(1, 1) == [0]
        assert writes == []
        assert server.statistics.bad_frames == 0
        assert list(mapping.holding_registers) == [0] * 4


@pytest.mark.parametrize("scheme", ["rtu+tcp", "rtu+udp"])
def test_a_loopback_that_holds_a_write_comes_back_whole(stage: Stage, scheme: str) -> None:
    with served(stage, f"{scheme}://10.0.0.1:1502") as (server, _, writes):
        for data in (b"\1\2", WRITE, WRITE * 20):
            frame = rtu("01 08 0000" + data.hex())
            with stage.talk(f"{scheme}://10.0.0.1:1502") as client:
                client.sendall(frame)
                received = b""
                while len(received) < len(frame):
                    received += client.recv(300)
                assert received == frame
        assert writes == []
        assert server.statistics.bad_frames == 0


@pytest.mark.parametrize("scheme", ["rtu", "ascii", "rtu+tcp", "ascii+tcp"])
@pytest.mark.parametrize("is_gateway", [False, True])
def test_only_the_last_of_the_requests_that_wait_is_answered(
    stage: Stage, scheme: str, is_gateway: bool
) -> None:
    """All came before the server could look: whoever sent another one has given up the first."""
    frame = rtu if scheme.startswith("rtu") else ascii_frame
    requests = [frame(f"01 06 0001 {number:04X}") for number in (5, 6, 7)]
    answer = frame("01 06 0001 0007")
    serial = "+" not in scheme
    url = f"{scheme}:///dev/line?baudrate=115200" if serial else f"{scheme}://10.0.0.1:1502"
    behind = ("tcp://10.0.0.2:502",) if is_gateway else (url,)
    with served(stage, *behind) as (_, mapping, _writes):
        gateway = Gateway([Route("tcp://10.0.0.2:502", units="1")])
        if is_gateway:
            with gateway.background(url):
                assert answers(stage, url, b"".join(requests)) == answer
        else:
            assert answers(stage, url, b"".join(requests)) == answer
        assert mapping.holding_registers[1] == 7


def answers(stage: Stage, url: str, data: bytes) -> bytes:
    if "+" not in url:
        master = LineEnd(stage.line("/dev/line"))
        master.write(data)
        stage.pass_time(2)
        return master.heard
    with stage.talk(url, timeout=2) as client:
        client.sendall(data)
        stage.pass_time(2)
        return client.recv(300)


def test_a_request_to_another_unit_takes_back_the_answer_that_waits(stage: Stage) -> None:
    with served(stage):
        assert answers(stage, LINE, READ + rtu("02 03 0000 0001")) == b""
        assert answers(stage, LINE, READ + rtu("02 03 0000 0001") + READ) == rtu("01 03 02 0000")
