"""The polls of one device, answer by answer."""

import weakref
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, ModbusTimeoutError, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.maps.point_plan import PointPlan
from libmodbus_py.services.fleet.poller import DeviceState, Poller
from tests.support.cases import each_case

NAMES = ("a", "b", "c")
MAP = RegisterMap(
    Point(name, "holding_registers", 500 * at, units="V") for at, name in enumerate(NAMES)
)

SILENT = ModbusTimeoutError("no answer")
LATER = ModbusTimeoutError("later")
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
        poller.take_outcome(outcome, now)
    assert poller.request is None
    return asked


@each_case(
    ("outcomes", "state", "error", "values"),
    [
        ([[1], [2], [3]], DeviceState.UP, None, [1, 2, 3]),
        # One that is silent at first is asked nothing else; one that answered is asked on.
        ([SILENT], DeviceState.DOWN, SILENT, [None, None, None]),
        ([[1], SILENT, [3]], DeviceState.UP, SILENT, [1, None, 3]),
        # The first error is told.
        ([[1], SILENT, LATER], DeviceState.UP, SILENT, [1, None, None]),
    ],
)
def test_a_poll_gives_a_reading_of_each_point(
    outcomes: list[Any], state: DeviceState, error: Any, values: list[Any]
) -> None:
    poller = poller_of()
    assert poll(poller, *outcomes) == [0, 500, 1000][: len(outcomes)]
    assert (poller.state, poller.error) == (state, error)
    told = [(each.name, each.value, each.quality) for each in poller.readings(9.0, 0)]
    qualities = ["good" if value else "down" for value in values]
    assert told == [*zip(NAMES, values, qualities, strict=True)]
    poll(poller, *([[1], [2], [3]] if state is DeviceState.UP else [SILENT]))
    assert poller.error is (None if state is DeviceState.UP else SILENT)


def test_a_device_rests_by_its_interval_if_that_is_longer_than_a_minute() -> None:
    poller = poller_of(interval=300.0)
    poll(poller, SILENT)
    poll(poller, SILENT)
    assert poller.pause == 300.0


def test_after_each_silence_another_request_comes_first(poller: Poller) -> None:
    assert [poll(poller, SILENT) for _ in range(4)] == [[0], [500], [1000], [0]]
    assert poller.misses == 4
    assert poll(poller, [2], [3], [1]) == [500, 1000, 0]
    assert poller.misses == 0
    assert [each.value for each in poller.readings(9.0, 0)] == [1, 2, 3]
    assert poll(poller, [2], [3], [1]) == [500, 1000, 0]


def test_a_refusal_is_an_answer(poller: Poller) -> None:
    poller.begin()
    poller.take_outcome(REFUSED, 1.0)
    assert poller.request.address == 500
    for _ in range(2):
        poller.take_outcome(REFUSED, 1.0)
    while poller.request is not None:  # it looks for what exactly is refused
        poller.take_outcome(REFUSED, 1.0)
    assert poller.state is DeviceState.UP
    assert poller.is_refused
    assert poller.misses == 0
    assert [each.quality for each in poller.readings(9.0, 0)] == ["bad"] * 3


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
