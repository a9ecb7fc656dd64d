"""
Bounds of a fleet that are promised: exactly these values are taken, counted or listed.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.readings import Buffer
from libmodbus_py.tools.files.csv_text import CELLS
from tests.support.cases import each_case


@pytest.mark.parametrize("most", [1, 10_000_000])
def test_a_buffer_takes_from_one_to_ten_million_readings(most: int) -> None:
    assert len(Buffer(most)) == 0


def test_a_buffer_holds_a_hundred_thousand_readings_unless_it_is_told_otherwise() -> None:
    buffer, one = Buffer(), [Reading(0.0, "meter", "power", 1, "W", "good")]
    buffer.put(one * 100_000)
    assert (len(buffer), buffer.dropped) == (100_000, 0)
    buffer.put(one)
    assert (len(buffer), buffer.dropped) == (100_000, 1)


@each_case(("key", "low", "high"), [("gap", 0, 2000), ("max_registers", 1, 125)])
def test_the_ends_of_the_range_of_a_key_are_within(key: str, low: int, high: int) -> None:
    points = RegisterMap([Point("power", "holding_registers", 0)])
    for value in (low, high):
        options: dict[str, Any] = {key: value}
        device = DeviceConfig("meter", "tcp://192.0.2.1", points, **options)
        assert getattr(device, key) == value
    for value in (low - 1, high + 1):
        options = {key: value}
        with pytest.raises(ValueError, match=rf"{key} must be in {low}\.\.{high}"):
            DeviceConfig("meter", "tcp://192.0.2.1", points, **options)


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
        DeviceConfig("pump", "tcp://192.0.2.1", many, items=("level",))
    assert str(refused.value).endswith(f"the map has no 'level'; it has {listed}")


def test_whole_numbers_in_a_table_have_twenty_digits_at_most() -> None:
    assert CELLS["int"]("9" * 20) == 10**20 - 1
    for text in ("9" * 21, "-1", "1.5", "", "\u0661"):
        with pytest.raises(ValueError, match="must be a whole number"):
            CELLS["int"](text)
