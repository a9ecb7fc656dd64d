"""
The polls of one device, answer by answer: what is asked first, what it is taken for, how it rests.
"""

from __future__ import annotations

import weakref
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, ModbusTimeoutError, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.maps.point_plan import PointPlan
from libmodbus_py.services.fleet.poller import DeviceState, Poller

NAMES = ("a", "b", "c")
MAP = RegisterMap(
    Point(name, "holding_registers", 500 * at, units="V") for at, name in enumerate(NAMES)
)

SILENT = ModbusTimeoutError("no answer")
REFUSED = IllegalDataAddress()


def poller_of(**options: Any) -> Poller:
    config = DeviceConfig("meter", "tcp://192.0.2.1", MAP, **options)
    return Poller(config)


@pytest.fixture
def poller() -> Poller:
    return poller_of()


def poll(poller: Poller, *outcomes: Any, now: float = 0.0) -> list[int]:
    """Poll once; each outcome stands for one request. Return the addresses that were asked."""
    poller.begin(now)
    asked = []
    for outcome in outcomes:
        asked.append(poller.request.address)
        poller.take(outcome, now)
    assert poller.request is None
    return asked


def test_all_requests_are_asked_in_their_order(poller: Poller) -> None:
    assert poll(poller, [1], [2], [3]) == [0, 500, 1000]
    assert poller.state is DeviceState.UP
    assert poller.error is None
    assert [(each.name, each.value, each.unit) for each in poller.readings(9.0)] == [
        ("a", 1, "V"),
        ("b", 2, "V"),
        ("c", 3, "V"),
    ]


def test_a_device_that_is_silent_at_first_is_asked_nothing_else(poller: Poller) -> None:
    assert poll(poller, SILENT) == [0]
    assert poller.state is DeviceState.DOWN
    assert poller.error is SILENT
    assert not poller.is_refused
    told = [(each.name, each.quality, each.reason) for each in poller.readings(9.0)]
    assert told == [(name, "down", "ModbusTimeoutError") for name in NAMES]


def test_after_each_silence_another_request_comes_first(poller: Poller) -> None:
    assert [poll(poller, SILENT) for _ in range(4)] == [[0], [500], [1000], [0]]
    assert poller.misses == 4
    assert poll(poller, [2], [3], [1]) == [500, 1000, 0]
    assert poller.misses == 0
    assert [each.value for each in poller.readings(9.0)] == [1, 2, 3]
    assert poll(poller, [2], [3], [1]) == [500, 1000, 0]


def test_a_device_that_answered_and_fell_silent_is_up_and_asked_on(poller: Poller) -> None:
    assert poll(poller, [1], SILENT, [3]) == [0, 500, 1000]
    assert poller.state is DeviceState.UP
    assert (poller.error, poller.misses) == (SILENT, 0)
    told = [(each.value, each.quality) for each in poller.readings(9.0)]
    assert told == [(1, "good"), (None, "down"), (3, "good")]


def test_a_refusal_is_an_answer(poller: Poller) -> None:
    poller.begin()
    poller.take(REFUSED, 1.0)
    assert poller.request.address == 500
    for _ in range(2):
        poller.take(REFUSED, 1.0)
    while poller.request is not None:  # it looks for what exactly is refused
        poller.take(REFUSED, 1.0)
    assert poller.state is DeviceState.UP
    assert poller.is_refused
    assert poller.misses == 0
    assert [each.quality for each in poller.readings(9.0)] == ["bad"] * 3


def test_the_first_error_of_a_poll_is_told_and_the_next_poll_forgets_it(poller: Poller) -> None:
    later = ModbusTimeoutError("later")
    poll(poller, [1], SILENT, later)
    assert poller.error is SILENT
    poll(poller, [1], [2], [3])
    assert poller.error is None
    assert not poller.is_refused


def test_a_poll_begins_without_what_came_in_the_last_one(poller: Poller) -> None:
    poller.begin()
    poller.take([1], 0.0)
    poller.begin()
    assert poller.request.address == 0
    poller.take(SILENT, 0.0)
    assert poller.state is DeviceState.DOWN


def test_it_rests_by_its_interval_doubled_up_to_a_minute() -> None:
    poller = poller_of(interval=10.0)
    pauses = []
    for _ in range(5):
        poll(poller, SILENT)
        pauses.append(poller.pause)
    assert pauses == [10.0, 20.0, 40.0, 60.0, 60.0]
    poller = poller_of(interval=300.0)
    poll(poller, SILENT)
    poll(poller, SILENT)
    assert poller.pause == 300.0


def test_readings_are_taken_back_but_for_points_that_are_still_read(poller: Poller) -> None:
    poll(poller, [1], [2], [3])
    taken_back = poller.withdrawn(8.0, {"b"})
    assert [(each.time, each.name, each.value, each.quality) for each in taken_back] == [
        (8.0, "a", None, "offline"),
        (8.0, "c", None, "offline"),
    ]
    assert {each.unit for each in taken_back} == {"V"}


def test_a_device_that_is_forgotten_is_new_and_tells_all_again() -> None:
    poller = poller_of(on_change=True)
    for count in (3, 0):
        poll(poller, [1], [2], [3])
        assert len(poller.readings(9.0)) == count
    poller.since = 5.0
    poll(poller, [1], SILENT, [3])
    poller.forget()
    assert poller.state is DeviceState.NEW
    assert poller.since == 0.0
    assert poller.error is None
    assert poller.withdrawn(8.0) == []
    poll(poller, [1], [2], [3])
    assert len(poller.readings(9.0)) == 3


def test_ids_go_up_from_the_first(poller: Poller) -> None:
    poll(poller, [1], [2], [3])
    assert [each.id for each in poller.readings(9.0, 41)] == [41, 42, 43]
    poll(poller, [1], [2], [3])
    assert [each.id for each in poller.readings(9.0)] == [0, 0, 0]


def test_plans_for_sets_of_points_are_made_once_and_bounded() -> None:
    """Points with intervals of their own may be due together in thousands of sets."""
    points = RegisterMap(Point(f"p{at}", "holding_registers", at) for at in range(8))
    reads = DeviceConfig("meter", "tcp://192.0.2.1", points).reads
    known: list[weakref.ref[PointPlan]] = []
    for number in range(1, 256):
        due = tuple(at for at in range(8) if number >> at & 1)
        plan = reads.plan_of(due)
        assert list(plan.names) == [f"p{at}" for at in due]
        assert reads.plan_of(due) is plan
        known.append(weakref.ref(plan))
        if number == 64:
            assert all(each() is not None for each in known)
        assert sum(each() is not None for each in known) <= 64
