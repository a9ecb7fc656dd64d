"""
When devices are polled: phases and skipping. No clock.
"""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.services.fleet.fleet import first_time, next_time


def test_phases_are_spread_evenly() -> None:
    """Ten thousand devices each 5 s: in no tenth of a second begin twice as many as should."""
    times = [first_time(f"device {number}", 5.0, 100.0, 1e9) for number in range(10_000)]
    assert all(100.0 <= each < 105.0 for each in times)
    counts = [0] * 50
    for each in times:
        counts[int((each - 100.0) * 10)] += 1
    assert 100 < min(counts) <= max(counts) < 300


def test_phases_are_those_of_another_machine() -> None:
    """Wherever its steady clock began, the moments of the day are the same."""
    wall = 1_800_000_000.25
    for now, passed in ((5.0, 0.0), (9e5, 3.0)):
        at = first_time("pump 7", 10.0, now, wall + passed) - now + passed
        assert at == pytest.approx(9.974544, abs=1e-5)


@pytest.mark.parametrize(
    ("planned", "now", "expected"),
    [
        (10.0, 10.0, (11.0, 0)),
        (10.0, 10.4, (11.0, 0)),
        (10.0, 10.999, (11.0, 0)),
        (10.0, 11.0, (12.0, 1)),  # 11 is now, and polled as 10 is
        (10.0, 13.5, (14.0, 3)),
        (10.0, 9.9, (11.0, 0)),  # a timer that rings too early
    ],
)
def test_times_that_have_passed_are_skipped(
    planned: float, now: float, expected: tuple[float, int]
) -> None:
    assert next_time(planned, 1.0, now) == expected


@given(st.floats(0, 1e6), st.floats(0.01, 86_400), st.floats(0, 1e6))
def test_the_next_time_is_later_and_in_phase(planned: float, interval: float, late: float) -> None:
    now = planned + late
    at, missed = next_time(planned, interval, now)
    assert at > now or at == pytest.approx(now)
    assert at == pytest.approx(planned + (missed + 1) * interval)
    assert missed >= 0
