"""
Readings of points that say what their registers mean.
"""

from __future__ import annotations

import math
from typing import Any

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.poller import Poller
from libmodbus_py.services.fleet.readings import classified
from tests.support.cases import each_case

H = "holding_registers"


def point(name: str, address: int, **keys: Any) -> Point:
    return Point(name, H, address, **keys)


POINTS = RegisterMap(
    [
        point("v", 0, type="int16", scale_from="v_sf", plausible_maximum=500),
        point("state", 1, states={0: "off", 1: "on"}, missing=255),
        point("flags", 2, bits={0: "door", "4..7": "mode"}),
        point("total", 3, never_falls=True),
        point("v_sf", 4, type="int16"),
        point("current", 5, type="float32"),
    ]
)

DEVICE = DeviceConfig(
    "meter", "tcp://192.0.2.10", POINTS, items=("v", "state", "flags", "total", "current")
)


class Polls:
    """A device that is polled, one answer after the other."""

    def __init__(self) -> None:
        self._poller = Poller(DEVICE)

    def readings(self, *cells: int) -> list[Reading]:
        self._poller.begin()
        while self._poller.request is not None:
            self._poller.take(list(cells), 0.0)
        return self._poller.readings(0.0)


def values(*cells: int) -> dict[str, tuple[Any, str, str]]:
    return {each.name: (each.value, *each[5:7]) for each in Polls().readings(*cells)}


def test_readings_have_values_by_what_they_mean() -> None:
    assert values(2305, 1, 0x51, 7, 0xFFFF, 0x3F80, 0) == {
        "v": (230.5, "good", ""),
        "state": ("on", "good", ""),
        "flags": ({"door": True, "mode": 5}, "good", ""),
        "total": (7, "good", ""),
        "current": (1.0, "good", ""),
    }


def test_a_reading_without_a_value_is_bad_and_has_a_reason() -> None:
    found = values(5001, 255, 0, 0, 0xFFFF, 0x7FC0, 0)
    assert found["v"] == (None, "bad", "Implausible")
    assert found["state"] == (None, "bad", "Missing")
    assert found["current"] == (None, "bad", "Missing")
    assert values(5001, 0, 0, 0, 300, 0x7F80, 0)["v"] == (None, "bad", "BadScale")
    assert values(5001, 0, 0, 0, 300, 0x7F80, 0)["current"] == (None, "bad", "Infinite")


def test_a_total_that_falls_is_told_when_it_was_read_again() -> None:
    polls = Polls()

    def total(value: int) -> list[tuple[Any, str, str]]:
        found = polls.readings(1, 0, 0, value, 0, 0, 0)
        return [(each.value, *each[5:7]) for each in found if each.name == "total"]

    assert total(10) == [(10, "good", "")]
    assert total(3) == []
    assert total(4) == [(4, "good", "Fell")]
    assert total(5) == [(5, "good", "")]
    assert total(0) == []
    assert total(6) == [(6, "good", "")]


@each_case(
    ("items", "reading"),
    [
        ([1.5, 2.5], ([1.5, 2.5], "good", "")),
        ([1.5, None], ([1.5, None], "good", "Missing")),
        ([math.inf, 2.5, None], ([None, 2.5, None], "good", "Infinite")),
        ([math.nan, None], (None, "bad", "Missing")),
        ([True, False], ([True, False], "good", "")),
    ],
)
def test_each_null_of_a_list_has_a_reason(items: list[Any], reading: tuple[Any, str, str]) -> None:
    assert classified(items) == reading
