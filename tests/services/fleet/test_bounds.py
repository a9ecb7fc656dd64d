"""
Bounds of a fleet that are promised: exactly these values are taken, counted or listed.
"""

from __future__ import annotations

import pytest

from libmodbus_py import DeviceConfig, Point, RegisterMap
from libmodbus_py.services.fleet.buffer import Buffer
from libmodbus_py.services.fleet.statistics import LATENESS_BOUNDS, FleetStatistics
from libmodbus_py.tools.files.csv_text import CELLS


def test_polls_are_counted_by_how_late_they_began() -> None:
    statistics = FleetStatistics()
    for late in (0.0, 0.001, 0.0011, 0.005, 1.0, 5.0, 5.1):
        statistics.note_start(late)
    assert statistics.lateness == [2, 2, 0, 0, 0, 0, 0, 0, 1, 1, 1]
    assert statistics.late_seconds == pytest.approx(11.1071)
    assert statistics.within(0.001) == 2 / 7
    assert statistics.within(0.005) == 4 / 7
    assert statistics.within(0.5) == 4 / 7
    assert statistics.within(LATENESS_BOUNDS[-1]) == 6 / 7
    assert FleetStatistics().within(1.0) == 0.0


def test_the_worst_is_of_the_time_since_it_was_asked_for() -> None:
    statistics = FleetStatistics()
    for late in (0.1, 0.3, 0.2):
        statistics.note_start(late)
    assert statistics.take_worst() == 0.3
    assert statistics.take_worst() == 0.0


@pytest.mark.parametrize("most", [1, 10_000_000])
def test_a_buffer_takes_from_one_to_ten_million_readings(most: int) -> None:
    assert len(Buffer(most)) == 0


@pytest.mark.parametrize("most", [0, 10_000_001])
def test_a_buffer_of_another_size_is_refused(most: int) -> None:
    with pytest.raises(ValueError, match=r"buffer must be in 1\.\.10000000"):
        Buffer(most)


@pytest.mark.parametrize(
    ("points", "listed"),
    [
        (8, "p0, p1, p2, p3, p4, p5, p6, p7"),
        (9, "p0, p1, p2, p3, p4, p5, p6, p7, ..."),
    ],
)
def test_an_unknown_item_is_answered_with_eight_names(points: int, listed: str) -> None:
    many = RegisterMap([Point(f"p{at}", "holding_registers", at) for at in range(points)])
    with pytest.raises(ValueError, match="items") as refused:
        DeviceConfig("pump", "tcp://192.0.2.1", many, items=["level"])
    assert str(refused.value).endswith(f"the map has no 'level'; it has {listed}")


def test_whole_numbers_in_a_table_have_twenty_digits_at_most() -> None:
    assert CELLS["int"]("9" * 20) == 10**20 - 1
    for text in ("9" * 21, "-1", "1.5", "", "\u0661"):
        with pytest.raises(ValueError, match="must be a whole number"):
            CELLS["int"](text)
