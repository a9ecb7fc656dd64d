"""
Plans of devices that cannot read everything, without sockets and clocks: which holes are found,
what it costs, and that no value is wrong.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import Any

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
from libmodbus_py.maps.holes import Holes, carried_out, reading
from libmodbus_py.maps.plan import Plan, unreadable_of
from tests.support.cases import each_case

H = "holding_registers"


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
    """Reads one plan of one device again and again, as one client does."""

    def __init__(self, plan: Plan, device: Any) -> None:
        self.plan = plan
        self.device = device
        self.holes = Holes()
        self.news: list[str] = []
        self.connects = 1

    def ask(self, requests: list[Any]) -> list[Any]:
        return [self.device(each) for each in requests]

    def steps(self, now: float = 0.0, *, is_strict: bool = False) -> Any:
        tell = self.news.append
        blocks, connects = self.plan.blocks, self.connects
        return reading(blocks, self.holes, now, connects, is_strict=is_strict, tell=tell)

    def poll(self, now: float = 0.0) -> tuple[int, Any]:
        """Read the plan; return the number of requests, and the values."""
        before = len(self.device.asked)
        answers = carried_out(self.steps(now), self.ask)
        return len(self.device.asked) - before, self.plan.results(answers)

    def strictly(self) -> tuple[int, list[Any]]:
        """Read until the first failure; return the number of requests, and the answers."""
        before = len(self.device.asked)
        answers = carried_out(self.steps(is_strict=True), self.ask)
        return len(self.device.asked) - before, answers

    def requests(self, count: int) -> list[int]:
        """Return the requests of so many polls, a second apart."""
        return [self.poll(now)[0] for now in range(count)]

    @property
    def unreadable(self) -> list[Any]:
        return [each.name for each in unreadable_of(self.plan, self.holes, "device")]


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
def test_a_hole_costs_one_point_and_ten_requests_once(refusal: type[ModbusError]) -> None:
    for hole in range(20):
        polls = Polls(singles(20), Registers([hole], refusal=refusal))
        first, values = polls.poll()
        assert 1 + 8 <= first <= 1 + 10
        assert lost(values) == [hole]
        assert isinstance(values[hole], refusal)
        assert [values[at] for at in range(20) if at != hole] == [
            [at] for at in range(20) if at != hole
        ]
        later = 1 if hole in (0, 19) else 2
        assert polls.requests(10) == [later] * 10
        assert polls.unreadable == [hole]
        assert len(polls.news) == 1


def test_both_halves_are_read_until_single_registers_are_known() -> None:
    polls = Polls(singles(8), Registers([2]))
    polls.poll()
    assert polls.device.asked == [(0, 8), (0, 4), (4, 4), (0, 2), (2, 2), (2, 1), (3, 1)]
    polls.device.asked.clear()
    polls.poll()
    assert polls.device.asked == [(0, 2), (3, 5)]


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
    assert [str(each) for each in unreadable_of(plan, polls.holes, "device")] == [
        "v5, holding_registers 10..11 (2 registers): illegal data address (exception 2)"
    ]


def test_an_item_longer_than_a_request_is_lost_as_a_whole() -> None:
    plan = Plan({"long": (H, 0, 200), "next": (H, 200, 3)})
    polls = Polls(plan, Registers([150]))
    _, values = polls.poll()
    assert isinstance(values["long"], IllegalDataAddress)
    assert values["next"] == [200, 201, 202]


def test_a_value_that_overlaps_a_refused_one_is_read() -> None:
    polls = Polls(Plan({"both": (H, 4, 1, "uint32"), "first": (H, 4), "next": (H, 6)}), None)
    polls.device = Registers([5])
    for _ in range(3):
        _, values = polls.poll()
        assert (values["first"], values["next"]) == ([4], [6])
        assert polls.unreadable == ["both"]


def test_a_hole_between_items_costs_no_item() -> None:
    """With a gap, cells are read that are in no item."""
    plan = Plan([(H, address) for address in range(0, 60, 3)], gap=2)
    polls = Polls(plan, Registers([28]))
    for now in range(2):
        _, values = polls.poll(now)
        assert lost(values) == []
    assert polls.requests(2) == [2, 2]
    assert polls.unreadable == []


def test_plans_of_one_unit_share_what_is_known() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll()
    polls.plan = Plan([(H, at) for at in (4, 5, 6)])
    count, values = polls.poll()
    assert (count, lost(values)) == (2, [1])


def test_clients_of_one_plan_know_the_holes_of_their_own_device() -> None:
    plan = singles(20)
    first, second = Polls(plan, Registers([5])), Polls(plan, Registers([9]))
    for now in range(3):
        assert lost(first.poll(now)[1]) == [5]
        assert lost(second.poll(now)[1]) == [9]
    assert (first.unreadable, second.unreadable) == ([5], [9])


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
def test_many_holes_are_found_at_once(missing: Iterable[int]) -> None:
    polls = Polls(singles(500), Registers(missing))
    first, values = polls.poll()
    assert lost(values) == sorted(missing)
    assert first <= 2 * 500
    assert polls.poll()[0] <= len(set(missing)) + 4
    assert lost(polls.poll()[1]) == sorted(missing)


@pytest.mark.slow
@each_case("count", [1, 2, 7, 20, 300])
def test_a_device_that_refuses_everything_is_asked_once_a_run(count: int) -> None:
    polls = Polls(singles(count), Registers(range(65536)))
    first, values = polls.poll(0)
    # It is not searched for long while nothing is answered.
    assert first <= -(-count // 125) + 17
    assert lost(values) == polls.unreadable == list(range(count))
    assert [polls.poll(now)[0] for now in range(1, 700)] == [1] * 699
    polls.device.missing = set()
    _, values = polls.poll(700)
    assert lost(values) == []
    assert polls.unreadable == []
    assert polls.poll(701) == (-(-count // 125), [[at] for at in range(count)])


def test_a_device_that_only_refuses_is_not_searched_further_at_the_next_run() -> None:
    """Of 2000 coils two are found, by two requests for each of 11 halvings; then all are holes."""
    polls = Polls(Plan([("coils", at) for at in range(2000)]), Registers(range(65536)))
    assert polls.requests(20) == [1 + 22] + [1] * 19


def test_a_block_that_is_not_there_costs_two_requests_a_register_once() -> None:
    plan = Plan([(H, address) for address in (*range(100), *range(1000, 1100))])
    polls = Polls(plan, Registers(range(1000, 1100)))
    first, values = polls.poll()
    assert first == 1 + 2 * 100 - 1
    assert lost(values) == list(range(100, 200))
    assert polls.requests(5) == [1] * 5
    assert polls.news == [
        "100, 101, 102, ..., holding_registers 1000..1099 (100 registers): "
        "illegal data address (exception 2)"
    ]


def test_one_readable_register_among_many_is_found_in_time() -> None:
    polls = Polls(singles(125), Registers(set(range(125)) - {77}))
    lost_then = [len(lost(polls.poll(now)[1])) for now in range(200)]
    assert lost_then[:78] == [125] * 78
    assert lost_then[78:] == [124] * (200 - 78)


@each_case("most", [1, 10, 50, 64, 124])
def test_short_requests_only_cost_no_point(most: int) -> None:
    """A device that takes fewer registers in a request refuses as if one were missing."""
    polls = Polls(singles(300), Registers([7], most=most))
    for now in range(10):
        count, values = polls.poll(now)
        assert lost(values) == [7]
    assert count <= 2 * (300 // most + 2)


def test_holes_side_by_side_are_told_together() -> None:
    polls = Polls(singles(20), Registers([3, 4, 9]))
    polls.poll()
    assert [each.split(" (")[0] for each in polls.news] == [
        "3, 4, holding_registers 3..4",
        "9, holding_registers 9",
    ]


# --- again ---------------------------------------------------------------------------------------


def test_a_hole_is_tried_again_every_ten_minutes() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    tried = [now for now in range(1, 2000) if polls.poll(now)[0] > 2]
    assert tried == [600, 1200, 1800]
    assert len(polls.news) == 1


def test_each_run_tries_one_hole_again() -> None:
    polls = Polls(singles(20), Registers([5, 9, 13]))
    polls.poll(0)
    polls.device.asked.clear()
    counts = [polls.poll(now)[0] for now in range(598, 605)]
    assert counts == [4, 4, 5, 5, 5, 4, 4]
    for hole in (5, 9, 13):
        assert polls.device.asked.count((hole, 1)) == 1


def test_what_can_be_read_again_is_read_at_once() -> None:
    polls = Polls(singles(20), Registers([5, 9, 13]))
    polls.poll(0)
    polls.device.missing = {13}
    count, values = polls.poll(600)
    # Three portions and a trial; as that is answered, the other two holes.
    assert count == 4 + 1 + 2
    assert lost(values) == [13]
    assert polls.poll(601)[0] == 2
    assert polls.unreadable == [13]


def test_another_connection_brings_another_trial() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    counts = []
    for now in range(1, 7):
        polls.connects = 1 + now // 3
        counts.append(polls.poll(now)[0])
    assert counts == [2, 2, 3, 2, 2, 3]


def test_the_first_connection_is_not_another_one() -> None:
    """It is made by the first request."""
    polls = Polls(singles(20), Registers([5]))
    polls.connects = 0
    polls.poll(0)
    polls.connects = 1
    assert polls.poll(1)[0] == 2


def test_a_trial_that_fails_is_a_trial() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    silent = Registers([5], refusal=ModbusTimeoutError)
    polls.device = silent
    assert [polls.poll(now)[0] for now in (600, 601)] == [3, 2]
    assert isinstance(unreadable_of(polls.plan, polls.holes, "")[0].error, IllegalDataAddress)


def test_a_shorter_request_is_tried_again_too() -> None:
    polls = Polls(singles(100), Registers(most=60))
    assert polls.requests(3) == [3, 2, 2]
    polls.device.most = 125
    assert [polls.poll(now)[0] for now in (599, 600, 601)] == [2, 1, 1]


@pytest.mark.slow
@each_case(
    ("moves", "average"),
    [
        (lambda now: {now * 7 % 100}, 10),
        (lambda now: {now // 10 * 7 % 100}, 10),
        (lambda now: set(random.Random(now).sample(range(100), 10)), 20),
        (lambda now: set(range(100)) if now % 2 else set(), 20),
        (lambda now: set(range(now % 3, 100, 3)), 2 * 100),
    ],
)
def test_holes_that_move_cost_few_requests(
    moves: Callable[[int], set[int]], average: float
) -> None:
    """A device changes what it can read at each poll, or at some, for an hour."""
    device = Registers()
    polls = Polls(singles(100), device)
    total = 0
    for number in range(900):
        device.missing = moves(number)
        count, values = polls.poll(4.0 * number)
        assert all(isinstance(each, ModbusError) or each == [at] for at, each in enumerate(values))
        assert count <= 2 * 100 + 1
        total += count
    assert total <= 900 * average
    device.missing = set()
    for number in range(900, 1100):
        _, values = polls.poll(4.0 * number)
    assert lost(values) == []


# --- what is not a hole -----------------------------------------------------------------


@each_case(
    "error",
    [
        ServerDeviceBusy(),
        GatewayTargetFailedToRespond(),
        ModbusTimeoutError("silence"),
        InvalidResponse("wrong length"),
    ],
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
    """The device leaves in the middle, at each possible request; the search ends there."""
    for working in range(1, 11):

        class Leaving(Registers):
            def __call__(self, request: Any) -> Any:
                answer = super().__call__(request)
                return answer if len(self.asked) <= working else error  # noqa: B023

        polls = Polls(singles(20), Leaving([13]))
        count, _ = polls.poll(0)
        assert count <= working + 2
        assert set(polls.unreadable) <= {13}
        polls.device = Registers([13])
        assert lost(polls.poll(100)[1]) == [13]


def test_two_runs_at_once_learn_the_same() -> None:
    polls = Polls(singles(20), Registers([5]))
    runs = [polls.steps(), polls.steps()]
    asked = {at: next(run) for at, run in enumerate(runs)}
    answers = []
    while asked:
        for at, requests in list(asked.items()):
            try:
                asked[at] = runs[at].send(polls.ask(requests))
            except StopIteration as done:
                answers.append(done.value)
                del asked[at]
    assert [lost(polls.plan.results(each)) for each in answers] == [[5], [5]]
    assert polls.unreadable == [5]
    assert len(polls.news) == 1


def test_a_run_that_is_left_leaves_what_was_learnt_whole() -> None:
    for steps in range(10):
        polls = Polls(singles(40), Registers([5, 31]))
        run = polls.steps()
        requests = next(run)
        for _ in range(steps):
            requests = run.send(polls.ask(requests))
        run.close()
        assert len(polls.news) == len(polls.unreadable)
        assert lost(polls.poll(1)[1]) == [5, 31]


# --- the first failure ---------------------------------------------------------------------------


def test_a_strict_reading_names_what_was_refused() -> None:
    for hole in range(20):
        polls = Polls(singles(40), Registers([hole, 30]))
        for most in (1 + 7, 2):
            count, answers = polls.strictly()
            (error,) = [each for each in answers if isinstance(each, ModbusError)]
            assert error.names == (hole,)
            assert str(error).startswith(f"{hole}: illegal data address")
            assert count <= most
        assert polls.unreadable == [hole]
        polls.device.missing.clear()
        count, answers = polls.strictly()
        assert polls.plan.results(answers) == [[at] for at in range(40)]
        assert count == 1
        assert not polls.holes


def test_a_known_hole_that_is_answered_is_not_named() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.strictly()
    polls.device.missing = {12}
    _, answers = polls.strictly()
    assert answers[0].names == (12,)
    assert polls.unreadable == [12]


def test_no_item_is_named_if_each_is_answered_alone() -> None:
    polls = Polls(singles(100), Registers(most=60))
    _, answers = polls.strictly()
    assert isinstance(answers[0], IllegalDataAddress)
    assert answers[0].names == ()
    assert not polls.holes


def test_a_refused_block_of_one_item_is_asked_for_once() -> None:
    """It would be answered the second time."""

    class Changing(Registers):
        def __call__(self, request: Any) -> Any:
            answer = super().__call__(request)
            self.missing.clear()
            return answer

    polls = Polls(singles(1), Registers([0]))
    polls.poll()
    polls.device = Changing([0])
    count, answers = polls.strictly()
    assert (count, answers[0].names) == (1, (0,))


def test_a_failure_while_the_item_is_searched_leaves_the_refusal() -> None:
    class Leaving(Registers):
        def __call__(self, request: Any) -> Any:
            answer = super().__call__(request)
            return answer if len(self.asked) < 3 else ModbusTimeoutError("silence")

    polls = Polls(singles(20), Leaving([15]))
    count, answers = polls.strictly()
    assert count == 3
    assert isinstance(answers[0], IllegalDataAddress)
    assert answers[0].names == ()


# --- any device ----------------------------------------------------------------------------------


@given(st.data())
def test_each_item_has_its_value_or_is_refused(data: st.DataObject) -> None:
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
    for now in range(30):
        count, values = polls.poll(now)
        assert count <= 3 * len(items) + 2
    for read, value in zip(plan._reads.values(), values, strict=True):
        if isinstance(value, ModbusError):
            assert missing & set(read.cells)
        else:
            assert not missing & set(read.cells)
            assert value == read.decode(list(read.cells))


@given(st.integers(0, 1 << 32), st.integers(0, 200))
def test_what_can_be_read_is_read_at_last(seed: int, count: int) -> None:
    """However wrong the first search was: it ends early while nothing is answered."""
    missing = set(random.Random(seed).sample(range(200), count))
    polls = Polls(singles(200), Registers(missing))
    for now in range(200):
        _, values = polls.poll(now)
        if lost(values) == sorted(missing):
            break
    assert lost(values) == sorted(missing)


class OfMoods(Registers):
    """A device that refuses its holes now in this way, now in that; and is busy in between."""

    chance = random.Random(1)

    def __call__(self, request: Any) -> Any:
        moods = (IllegalDataAddress, ServerDeviceBusy, IllegalDataValue, ServerDeviceFailure)
        self.refusal = self.chance.choice(moods)
        return super().__call__(request)


def test_a_hole_is_found_although_its_refusal_changes() -> None:
    for hole in range(20):
        polls = Polls(singles(20), OfMoods([hole]))
        found = [lost(polls.poll(now)[1]) for now in range(50)]
        assert found[-1] == polls.unreadable == [hole]
        assert all(hole in each for each in found)


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


@each_case("is_strict", [False, True])
def test_no_value_is_wrong_whatever_a_device_answers(is_strict: bool) -> None:
    for seed in range(60):
        polls = Polls(singles(100), Whims(seed))
        for now in range(0, 2000, 100):
            before = len(polls.device.asked)
            answers = carried_out(polls.steps(now, is_strict=is_strict), polls.ask)
            assert len(polls.device.asked) - before <= 2 * 100 + 1
            for answer, request in zip(answers, polls.plan.requests, strict=False):
                cells = range(request.address, request.address + request.count)  # type: ignore[attr-defined]
                if not isinstance(answer, ModbusError):
                    assert all(got in (None, at) for got, at in zip(answer, cells, strict=True))
