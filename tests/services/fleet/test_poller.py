"""The polls of one device, answer by answer."""

import weakref
from typing import Any

import pytest

from libmodbus_py import ModbusTimeoutError, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.maps.point_plan import PointPlan
from libmodbus_py.services.fleet.poller import Poller

NAMES = ("a", "b", "c")
MAP = RegisterMap(
    Point(name, "holding_registers", 500 * at, units="V") for at, name in enumerate(NAMES)
)

SILENT = ModbusTimeoutError("no answer")


def poller_of(**options: Any) -> Poller:
    config = DeviceConfig("meter", "tcp://192.0.2.1", MAP, **options)
    return Poller(config)


@pytest.fixture
def poller() -> Poller:
    return poller_of()


def poll(poller: Poller, *outcomes: Any, now: float = 0.0) -> list[int]:
    """Poll once; each outcome stands for one request. Return the addresses that were asked."""
    poller.begin(now)
    requests = []
    for outcome in outcomes:
        requests.append(poller.request.address)
        poller.take_outcome(outcome, now)
    assert poller.request is None
    return requests


def test_after_each_silence_a_poll_begins_with_another_request(poller: Poller) -> None:
    assert [poll(poller, SILENT) for _ in range(4)] == [[0], [500], [1000], [0]]
    assert poller.misses == 4
    assert poll(poller, [2], [3], [1]) == [500, 1000, 0]
    assert poller.misses == 0
    assert [reading.value for reading in poller.readings(9.0, 0)] == [1, 2, 3]
    assert poll(poller, [2], [3], [1]) == [500, 1000, 0]


def test_plans_for_sets_of_points_are_made_once_and_bounded() -> None:
    """Points with intervals of their own may be due together in thousands of sets."""
    points = RegisterMap(Point(f"p{at}", "holding_registers", at) for at in range(8))
    reads = DeviceConfig("meter", "tcp://192.0.2.1", points).reads
    plans: list[weakref.ref[PointPlan]] = []
    for number in range(1, 256):
        due = tuple(at for at in range(8) if number >> at & 1)
        plan = reads.plan_of(due)
        assert list(plan.names) == [f"p{at}" for at in due]
        assert reads.plan_of(due) is plan
        plans.append(weakref.ref(plan))
        if number == 64:
            assert all(plan() is not None for plan in plans)
        assert sum(plan() is not None for plan in plans) <= 64
