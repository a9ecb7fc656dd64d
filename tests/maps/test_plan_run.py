"""
Runs of plans at devices that cannot read everything, without sockets and clocks: what is found,
what it costs, and that no value is wrong.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.errors import (
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    IllegalDataValue,
    InvalidResponse,
    ModbusError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    ServerDeviceFailure,
)
from libmodbus_py.maps.holes import Holes, HolesByDevice, Span
from libmodbus_py.maps.plan import Plan
from libmodbus_py.maps.plan_run import PlanRun
from libmodbus_py.maps.strict_run import StrictRun
from tests.support.cases import each_case

H = "holding_registers"
HIGHEST = 50
"""More requests than one run may ever take beyond those of its plan and of its holes."""


class Registers:
    """
    A device whose registers hold their own addresses.

    Args:
        missing: addresses that it refuses.
        most: the most registers of a request.
        refusal: the class of its refusals.

    Attributes:
        asked: first address and count of each request.
    """

    def __init__(
        self,
        missing: Iterable[int] = (),
        most: int = 125,
        refusal: type[ModbusError] = IllegalDataAddress,
    ) -> None:
        self.missing = set(missing)
        self.most = most
        self.refusal = refusal
        self.asked: list[tuple[int, int]] = []

    def __call__(self, request: Any) -> Any:
        self.asked.append((request.address, request.count))
        cells = range(request.address, request.address + request.count)
        if request.count > self.most or not self.missing.isdisjoint(cells):
            return self.refusal()
        return list(cells)


class Polls:
    """Runs of one plan at one device."""

    def __init__(self, plan: Plan, device: Any) -> None:
        self.plan = plan
        self.device = device
        self.holes = Holes("device")
        self.news: list[str] = []
        self.connection = 1

    def poll(self, now: float = 0.0) -> tuple[int, Any]:
        """Run the plan; return the number of requests, and the values."""
        before = len(self.device.asked)
        run = PlanRun(self.plan, self.holes, now, 1, self.connection)
        while run.requests:
            run.take([self.device(each) for each in run.requests])
        self.news += run.news
        return len(self.device.asked) - before, self.plan.results(run.answers)

    def requests(self, count: int) -> list[int]:
        """Return the requests of so many polls, a second apart."""
        return [self.poll(now)[0] for now in range(count)]

    @property
    def unreadable(self) -> list[Any]:
        return [each.name for each in self.plan.unreadable_of(self.holes)]


def singles(count: int) -> Plan:
    return Plan([("holding_registers", address) for address in range(count)])


def lost(values: Iterable[Any]) -> list[int]:
    return [at for at, value in enumerate(values) if isinstance(value, ModbusError)]


# --- one hole ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "refusal",
    [IllegalDataAddress, IllegalDataValue, ServerDeviceFailure],
    ids=lambda each: each.code,
)
def test_a_hole_costs_one_point_and_six_requests_once(refusal: type[ModbusError]) -> None:
    for hole in range(20):
        polls = Polls(singles(20), Registers([hole], refusal=refusal))
        first, values = polls.poll()
        assert first <= 1 + 6
        assert lost(values) == [hole]
        assert isinstance(values[hole], refusal)
        assert [values[at] for at in range(20) if at != hole] == [
            [at] for at in range(20) if at != hole
        ]
        later = 1 if hole in (0, 19) else 2
        assert polls.requests(10) == [later] * 10
        assert polls.unreadable == [hole]
        assert len(polls.news) == 1


def test_a_plan_without_holes_costs_nothing_more() -> None:
    polls = Polls(singles(300), Registers())
    assert polls.requests(3) == [3, 3, 3]
    assert not polls.holes


def test_values_of_several_registers_are_never_cut() -> None:
    plan = Plan({f"v{at}": (H, 2 * at, 1, "uint32") for at in range(20)})
    polls = Polls(plan, Registers([11]))
    _, values = polls.poll()
    assert [name for name, value in values.items() if isinstance(value, ModbusError)] == ["v5"]
    assert values["v6"] == [12 << 16 | 13]
    assert all(address % 2 == 0 and count % 2 == 0 for address, count in polls.device.asked)
    assert [str(each) for each in plan.unreadable_of(polls.holes)] == [
        "v5, holding_registers 10..11 (2 registers): illegal data address (exception 2)"
    ]


def test_an_item_longer_than_a_request_is_lost_as_a_whole() -> None:
    plan = Plan({"long": (H, 0, 200), "next": (H, 200, 3)})
    polls = Polls(plan, Registers([150]))
    values = [polls.poll(now)[1] for now in range(3)][-1]
    assert isinstance(values["long"], IllegalDataAddress)
    assert values["next"] == [200, 201, 202]


def test_a_hole_between_items_costs_no_item() -> None:
    """With a gap, cells are read that are in no item."""
    plan = Plan([(H, address) for address in range(0, 60, 3)], gap=2)
    polls = Polls(plan, Registers([28]))
    for now in range(5):
        _, values = polls.poll(now)
    assert lost(values) == []
    assert max(polls.requests(2)) <= 3


# --- many holes, or nothing else -----------------------------------------------------------------


@each_case(
    "missing",
    [
        random.Random(1).sample(range(500), 40),
        [*range(100, 120), *range(300, 320)],
        range(60, 100),
        range(0, 500, 2),
    ],
)
def test_many_holes_are_found_in_some_runs_of_few_requests(missing: Iterable[int]) -> None:
    polls = Polls(singles(500), Registers(missing))
    counts = []
    for now in range(59):
        usual = 4 + len(polls.holes.refused)
        count, values = polls.poll(now)
        assert count <= usual + HIGHEST
        counts.append(count)
    assert lost(values) == sorted(missing)
    assert counts[-1] <= len(set(missing)) + 4


@each_case("count", [1, 2, 7, 20, 500, 2000])
def test_a_device_that_refuses_everything_is_asked_once_a_run(count: int) -> None:
    polls = Polls(singles(count), Registers(range(65536)))
    first, values = polls.poll(0)
    blocks = -(-count // 125)
    assert first <= blocks + HIGHEST
    assert lost(values) == list(range(count))
    assert [polls.poll(now)[0] for now in range(1, 50)] == [1] * 49
    assert len(polls.holes.refused) == blocks
    # Every ten minutes it is tried whether something can be read now.
    an_hour = sum(polls.poll(now)[0] for now in range(50, 3650, 10))
    assert an_hour <= 360 + 7 * (2 * blocks + 32)
    polls.device.missing = set()
    polls.poll(4000)
    for now in (4001, 4002):
        _, values = polls.poll(now)
    assert lost(values) == []
    assert not polls.holes.refused


def test_a_block_that_is_not_there_is_left_out_as_a_whole() -> None:
    plan = Plan([(H, address) for address in (*range(100), *range(1000, 1100))])
    polls = Polls(plan, Registers(range(1000, 1100)))
    first, values = polls.poll()
    assert first <= 2 + 32
    assert lost(values) == list(range(100, 200))
    assert polls.requests(5) == [1] * 5
    assert len(polls.holes.refused) == 1
    assert polls.news == [
        "100, 101, 102, ..., holding_registers 1000..1099 (100 registers): "
        "illegal data address (exception 2)"
    ]


def test_one_readable_register_among_many_is_found_in_time() -> None:
    polls = Polls(singles(125), Registers(set(range(125)) - {77}))
    for now in range(0, 7 * 3600, 60):
        _, values = polls.poll(now)
        if lost(values) != list(range(125)):
            break
    for more in range(60):
        _, values = polls.poll(now + more)
    assert lost(values) == [at for at in range(125) if at != 77]


@each_case("most", [1, 10, 50, 64, 124])
def test_short_requests_only_cost_no_point(most: int) -> None:
    """A device that takes fewer registers in a request refuses as if one were missing."""
    polls = Polls(singles(300), Registers([7], most=most))
    for now in range(10):
        count, values = polls.poll(now)
    assert lost(values) == [7]
    assert count <= 2 * (300 // most + 2)


# --- again ---------------------------------------------------------------------------------------


def test_a_hole_is_tried_again_after_a_minute_and_every_ten() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    tried = [now for now in range(1, 2000) if polls.poll(now)[0] > 2]
    assert tried == [60, 660, 1260, 1860]
    assert len(polls.news) == 1


def test_what_can_be_read_again_is_read_again() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    polls.device.missing.clear()
    _, values = polls.poll(60)
    assert lost(values) == []
    assert polls.poll(61) == (1, [[at] for at in range(20)])
    assert polls.unreadable == []


def test_a_new_connection_brings_another_trial_once_a_minute() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    polls.poll(60)
    counts = []
    for now in range(100, 220, 10):
        polls.connection += 1
        counts.append(polls.poll(now)[0])
    assert counts == [2, 2, 3, 2, 2, 2, 2, 2, 3, 2, 2, 2]


def test_another_client_tries_everything_again() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    counts = []
    for client in (2, 2, 3, 2, 3, 2):
        polls.holes.note_connection(client, 1, 10)
        counts.append(len(PlanRun(polls.plan, polls.holes, 10, client, 1).requests))
        polls.poll(10)
    assert counts == [3, 2, 3, 2, 2, 2]


@each_case(
    "moves",
    [
        lambda now: {now * 7 % 100},
        lambda now: {now // 10 * 7 % 100},
        lambda now: set(random.Random(now).sample(range(100), 10)),
        lambda now: set(range(100)) if now % 2 else set(),
        lambda now: set(range(now % 3, 100, 3)),
    ],
)
def test_holes_that_move_cost_few_requests(moves: Callable[[int], set[int]]) -> None:
    """A device changes what it can read at each poll, or at some, for an hour."""
    device = Registers()
    polls = Polls(singles(100), device)
    most = total = 0
    for number in range(900):
        device.missing = moves(number)
        count, values = polls.poll(4.0 * number)
        assert all(isinstance(each, ModbusError) or each == [at] for at, each in enumerate(values))
        most, total = max(most, count), total + count
    assert most <= 50 + HIGHEST
    assert total <= 900 * 10
    device.missing = set()
    for number in range(900, 1100):
        _, values = polls.poll(4.0 * number)
    assert lost(values) == []


# --- what is not a hole -----------------------------------------------------------------


@each_case(
    "error", [ServerDeviceBusy(), GatewayTargetFailedToRespond(), ModbusTimeoutError("silence")]
)
def test_other_failures_are_no_holes(error: ModbusError) -> None:
    class Failing(Registers):
        def __call__(self, request: Any) -> Any:
            super().__call__(request)
            return error

    polls = Polls(singles(200), Failing())
    assert polls.requests(20) == [2] * 20
    assert not polls.holes


@each_case("error", [ServerDeviceBusy(), ModbusTimeoutError("silence")])
def test_a_search_that_fails_learns_nothing_false(error: ModbusError) -> None:
    """The device leaves in the middle, at each possible request."""
    for working in range(1, 8):

        class Leaving(Registers):
            def __call__(self, request: Any) -> Any:
                answer = super().__call__(request)
                return answer if len(self.asked) <= working else error  # noqa: B023

        polls = Polls(singles(20), Leaving([13]))
        polls.poll(0)
        assert set(polls.unreadable) <= {13}
        polls.device = Registers([13])
        polls.poll(100)
        assert lost(polls.poll(101)[1]) == [13]


def test_a_disturbance_is_no_hole_and_garbage_is_one() -> None:
    class Garbling(Registers):
        garbled: ClassVar[set[int]] = set()

        def __call__(self, request: Any) -> Any:
            answer = super().__call__(request)
            if self.garbled & set(range(request.address, request.address + request.count)):
                return InvalidResponse("wrong length")
            return answer

    device = Garbling()
    polls = Polls(singles(20), device)
    for now in range(10):
        device.garbled = {3} if now % 3 else set()
        assert polls.poll(now)[0] == 1
    assert polls.unreadable == []
    device.garbled = {3}
    counts = [polls.poll(now)[0] for now in range(10, 16)]
    assert counts[:2] == [1, 1]
    assert counts[2] <= 1 + 12
    assert counts[3:] == [2, 2, 2]
    assert polls.unreadable == [3]


def test_two_runs_at_once_learn_the_same() -> None:
    plan, device, holes = singles(20), Registers([5]), Holes()
    runs = [PlanRun(plan, holes, 0.0) for _ in range(2)]
    while any(run.requests for run in runs):
        for run in runs:
            if run.requests:
                run.take([device(each) for each in run.requests])
    for run in runs:
        assert lost(plan.results(run.answers)) == [5]
    assert [each.name for each in plan.unreadable_of(holes)] == [5]
    assert len(device.asked) <= 2 * 7


def test_a_run_that_is_left_leaves_what_was_learnt_whole() -> None:
    for steps in range(8):
        plan, device, holes = singles(40), Registers([5, 31]), Holes()
        run = PlanRun(plan, holes, 0.0)
        for _ in range(steps):
            if run.requests:
                run.take([device(each) for each in run.requests])
        del run
        polls = Polls(plan, device)
        polls.holes = holes
        polls.poll(1)
        assert lost(polls.poll(2)[1]) == [5, 31]


# --- the first failure ---------------------------------------------------------------------------


def test_a_strict_run_names_what_was_refused() -> None:
    for hole in range(20):
        plan, device, holes = singles(40), Registers([hole, 30]), Holes()
        for most in (1 + 7, 2):
            device.asked.clear()
            run = StrictRun(plan, holes, 0.0)
            while run.requests:
                run.take([device(each) for each in run.requests])
            (error,) = [each for each in run.answers if isinstance(each, ModbusError)]
            assert error.names == (hole,)
            assert str(error).startswith(f"{hole}: illegal data address")
            assert len(device.asked) <= most
        device.missing.clear()
        run = StrictRun(plan, holes, 0.0)
        run.take([device(each) for each in run.requests])
        assert plan.results(run.answers) == [[at] for at in range(40)]


def test_an_item_that_is_answered_and_then_refused() -> None:
    """The second refusal says nothing about the first value."""

    class Wavering(Registers):
        def __call__(self, request: Any) -> Any:
            is_first = (request.address, request.count) == (2, 1) and (2, 1) not in self.asked
            answer = super().__call__(request)
            return [2] if is_first else answer

    plan, holes = singles(20), Holes()
    holes.add(Span(H, 2, 3), IllegalDataAddress(), 0.0)
    device = Wavering([2])
    run = StrictRun(plan, holes, 1.0)
    while run.requests:
        run.take([device(each) for each in run.requests])
    assert [type(each) for each in run.answers] == [IllegalDataAddress]
    assert device.asked.count((2, 1)) == 2


# --- any device ----------------------------------------------------------------------------------


@given(st.data())
def test_each_item_has_its_value_or_is_refused_in_the_end(data: st.DataObject) -> None:
    items = data.draw(
        st.lists(
            st.tuples(
                st.just(H), st.integers(0, 60), st.integers(1, 3), st.sampled_from([None, "uint32"])
            ),
            min_size=1,
            max_size=25,
        )
    )
    missing = data.draw(st.sets(st.integers(0, 70), max_size=30))
    gap = data.draw(st.integers(0, 3))
    plan = Plan(items, gap=gap)
    polls = Polls(plan, Registers(missing))
    for now in range(0, 4000, 61):
        count, values = polls.poll(now)
        assert count <= 3 * len(items) + HIGHEST
    for read, value in zip(plan._reads.values(), values, strict=True):
        if isinstance(value, ModbusError):
            assert missing & set(read.cells)
        else:
            assert not missing & set(read.cells)
            assert value == read.decode(list(read.cells))


FAILURES = (ModbusTimeoutError, ServerDeviceBusy, InvalidResponse, IllegalDataAddress)


class Whims(Registers):
    """A device that fails some requests without a reason, and loses other registers meanwhile."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._random = random.Random(seed)
        self._share = self._random.choice([0.02, 0.3, 0.9])

    def __call__(self, request: Any) -> Any:
        answer = super().__call__(request)
        if self._random.random() < 0.02:
            self.missing = {self._random.randrange(100) for _ in range(20)}
        return self._random.choice(FAILURES)() if self._random.random() < self._share else answer


@each_case("kind", [PlanRun, StrictRun])
def test_no_value_is_wrong_whatever_a_device_answers(kind: type[PlanRun]) -> None:
    for seed in range(60):
        device, plan, holes = Whims(seed), singles(100), Holes()
        for now in range(0, 2000, 100):
            run = kind(plan, holes, now)
            before = len(device.asked) + len(run.requests)
            while run.requests:
                run.take([device(each) for each in run.requests])
            assert len(device.asked) - before <= HIGHEST
            for answer, request in zip(run.answers, plan.requests, strict=False):
                cells = range(request.address, request.address + request.count)  # type: ignore[attr-defined]
                if not isinstance(answer, ModbusError):
                    assert all(got in (None, at) for got, at in zip(answer, cells, strict=True))


def test_what_is_known_of_devices_is_bounded() -> None:
    known = HolesByDevice()
    for unit in range(20_000):
        known.made(unit, str(unit))
    assert len(list(known)) == 10_000
