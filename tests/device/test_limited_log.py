"""Warnings that clients cause: one at once, then a line a minute, whatever the clients do."""

import asyncio
import logging

import pytest

from libmodbus_py.device.limited_log import MAX_REASONS, LimitedLog, in_time
from libmodbus_py.protocol.logs import HarmlessLogger
from tests.simulation.stage import Stage


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def log(clock: Clock) -> LimitedLog:
    return LimitedLog(HarmlessLogger(__name__), clock)


def test_a_flood_is_a_line_and_then_a_line_a_minute(log: LimitedLog, clock: Clock, caplog) -> None:
    for second in range(130):
        clock.now = 1000.0 + second
        for port in range(10):
            log.warning("%s: too fast", port)
    assert caplog.messages == [
        "0: too fast",
        "0: too fast; 600 since the last line like this",
        "0: too fast; 600 since the last line like this",
    ]
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


def test_a_rare_warning_is_a_line_each_time(log: LimitedLog, clock: Clock, caplog) -> None:
    for port in range(3):
        clock.now += 61
        log.warning("%s: too fast", port)
    assert caplog.messages == ["0: too fast", "1: too fast", "2: too fast"]


def test_each_reason_has_its_own_lines_but_not_any_number(log: LimitedLog, clock: Clock, caplog):
    for number in range(10 * MAX_REASONS):
        log.warning("refused: %s", number, reason=f"reason {number}")
    assert len(caplog.messages) == MAX_REASONS + 1
    clock.now += 60
    log.warning("refused: %s", "again", reason="another one")
    # What was counted for all others, then the new one, for which there is room.
    assert caplog.messages[MAX_REASONS + 1 :] == [
        f"refused: {10 * MAX_REASONS - 1}; {9 * MAX_REASONS - 1} since the last line like this",
        "refused: again",
    ]


def test_the_number_comes_at_the_end_of_the_minute_within_a_loop(
    stage: Stage, log: LimitedLog, caplog: pytest.LogCaptureFixture
) -> None:
    async def flood() -> None:
        with in_time():
            for port in range(10):
                log.warning("%s: too fast", port)
                log.warning("%s: too many", port)
            await asyncio.sleep(59)
            assert len(caplog.messages) == 2
            await asyncio.sleep(2)
            log.warning("%s: too fast", "later")

    stage.wait(flood())
    assert caplog.messages[2:] == [
        "9: too fast; 9 since the last line like this",
        "9: too many; 9 since the last line like this",
    ]
