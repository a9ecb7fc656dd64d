"""
Good frames with a function that no request has, 0 or 80h and more: of others, or of nobody.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from libmodbus_py import Device, Gateway, Mapping, Route, Server
from libmodbus_py.server.limits import ServerStatistics
from tests.simulation.stage import LineEnd, Stage
from tests.support.talk import ascii_frame, rtu

# Behind the unit: the function, and data of any length.
BODIES = [
    "80", "80 01", "83 02", "FF 0B", "80 01 02", "83 02 00", "81 00 00 00 00", "AB 0E 01",
    "FF" + "00" * 20, "90" + "A5" * 120, "83" + "11" * 252,
]  # fmt: skip

# One behind each of them, to three units.
READS = 3 * len(BODIES)

MADE = {"rtu": rtu, "ascii": ascii_frame}


@contextmanager
def listener(stage: Stage, who: str, url: str) -> Iterator[ServerStatistics]:
    """Serve unit 1 at a line, as a device or a gateway."""
    device = Device(Mapping(holding_registers=4))
    if who == "device":
        server = Server({1: device})
        with server.background(url):
            yield server.statistics
        return
    gateway = Gateway([Route("rtu:///dev/back?baudrate=115200", units="1")])
    with Server({1: device}).background("rtu:///dev/back?baudrate=115200"):
        with gateway.background(url):
            yield gateway.statistics
        assert (
            sum(
                unit.requests
                for line in gateway.traffic.lines.values()
                for unit in line.units.values()
            )
            == len(BODIES) * 3
        )


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
@pytest.mark.parametrize("who", ["device", "gateway"])
@pytest.mark.parametrize("pieces", [1, 3])
def test_it_is_neither_answered_nor_damage(
    stage: Stage, scheme: str, who: str, pieces: int
) -> None:
    made = MADE[scheme]
    line = f"{scheme}:///dev/line?baudrate=115200"
    with listener(stage, who, line) as statistics:
        master = LineEnd(stage.line("/dev/line"))
        for body in BODIES:
            for unit in (0, 1, 2):
                frame = made(f"{unit:02X} {body}")
                size = -(-len(frame) // pieces)
                for at in range(0, len(frame), size):
                    master.write(frame[at : at + size])
                    stage.pass_time(0.001)
                stage.pass_time(0.2)
                assert master.heard == b"", body
                master.write(made("01 03 0001 0001"))
                stage.pass_time(0.2)
                assert master.heard == made("01 03 02 0000"), body
                master.heard = b""
                assert statistics.bad_frames == 0, (unit, body)
