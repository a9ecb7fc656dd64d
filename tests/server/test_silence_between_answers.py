"""
Answers that a serial server sends one after the other: a silence of 3.5 characters is between them
(serial line, 2.5.1.1), in simulated time.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.serial import SerialServer
from libmodbus_py.server.service import SessionState
from tests.simulation.stage import LineEnd, Stage
from tests.support.talk import rtu

ANSWERS = [rtu(f"01 03 04 {number:04X} 0000") for number in range(4)]


class Service:
    """Makes one session, which answers when it is told to."""

    state = SessionState.READING

    def sessions(self, endpoint: Any, statistics: Any, later: Any = None) -> Any:
        def made(channel: Any) -> Service:
            self.channel = channel
            return self

        return made

    def receive(self, data: bytes) -> int:
        return 0

    def end(self) -> None: ...

    def close(self) -> None: ...


class TimedEnd(LineEnd):
    """Notes when it hears what."""

    def __init__(self, stage: Stage, line: Any) -> None:
        super().__init__(line)
        self.pieces: list[tuple[float, bytes]] = []
        self._stage = stage

    def hear(self, data: bytes) -> None:
        self.pieces.append((self._stage.now, data))


@pytest.mark.parametrize("baudrate", [1200, 9600, 115200])
@pytest.mark.parametrize("rest", ["", "&rs485=rts-up"])
def test_a_silence_is_between_two_answers(stage: Stage, baudrate: int, rest: str) -> None:
    service = Service()

    async def begun() -> SerialServer:
        endpoint = parse(f"rtu:///dev/line?baudrate={baudrate}{rest}")
        server = SerialServer(endpoint, service, ServerStatistics())
        await server.open()
        return server

    other = TimedEnd(stage, stage.line("/dev/line"))
    server = stage.wait(begun())
    try:
        for answer in ANSWERS:
            service.channel.write(answer)
        stage.pass_time(2.0)
    finally:
        stage.wait(closed(server))
    assert [data for _, data in other.pieces] == ANSWERS
    times = [at for at, _ in other.pieces]
    character = 11 / baudrate
    pause = 3.5 * character if baudrate <= 19200 else 0.00175
    for before, after in pairwise(times):
        assert after - before >= len(ANSWERS[0]) * character + pause - 1e-6


async def closed(server: SerialServer) -> None:
    server.close()
