"""Warnings that clients cause: one at once, then a line a minute, whatever the clients do."""

import pytest

from libmodbus_py.device.authorization import MAX_REASONS, LimitedLog
from libmodbus_py.protocol.logs import HarmlessLogger


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


def test_each_reason_is_logged_up_to_a_limit_of_lines(log: LimitedLog, clock: Clock, caplog):
    for number in range(10 * MAX_REASONS):
        log.warning("refused: %s", number, reason=f"reason {number}")
    assert len(caplog.messages) == MAX_REASONS + 1
    clock.now += 60
    log.warning("refused: %s", "again", reason="another one")
    # The count of all other reasons, then the new one, for which there is room.
    assert caplog.messages[MAX_REASONS + 1 :] == [
        f"refused: {10 * MAX_REASONS - 1}; {9 * MAX_REASONS - 1} since the last line like this",
        "refused: again",
    ]
