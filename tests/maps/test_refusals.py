"""Plans of devices that fail in other ways, or change: no item is left out without reason."""

import random
from typing import Any

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
from libmodbus_py.maps.plan import Plan
from tests.maps.refusing import H, Polls, Registers, leaving, lost, singles
from tests.support.cases import each_case


@each_case(
    "error",
    [
        ServerDeviceBusy(),
        GatewayTargetFailedToRespond(),
        ModbusTimeoutError("silence"),
        InvalidResponse("wrong length"),
    ],
)
def test_other_failures_are_not_taken_for_refusals(error: ModbusError) -> None:
    polls = Polls(singles(200), Registers(then=leaving(0, error)))
    assert polls.requests(20) == [2] * 20
    assert not polls.refusals


@each_case("error", [ServerDeviceBusy(), ModbusTimeoutError("silence")])
def test_a_search_that_fails_records_no_wrong_refusal(error: ModbusError) -> None:
    """The device leaves in the middle, at each possible request; the search ends there."""
    for working in range(1, 11):
        polls = Polls(singles(20), Registers([13], then=leaving(working, error)))
        count, _ = polls.poll(0)
        assert count <= working + 2
        assert set(polls.unreadable) <= {13}
        polls.device = Registers([13])
        assert lost(polls.poll(100)[1]) == [13]


def test_two_runs_at_the_same_time_record_the_same_refusals() -> None:
    polls = Polls(singles(20), Registers([5]))
    runs = [polls.steps(), polls.steps()]
    requests_of = {at: next(run) for at, run in enumerate(runs)}
    answers = []
    while requests_of:
        for at, requests in list(requests_of.items()):
            try:
                requests_of[at] = runs[at].send(polls.ask(requests))
            except StopIteration as done:
                answers.append(done.value)
                del requests_of[at]
    assert [lost(polls.plan.results(answer)) for answer in answers] == [[5], [5]]
    assert polls.unreadable == [5]
    assert len(polls.news) == 1


def test_a_run_that_is_closed_early_keeps_the_refusals_it_has_found() -> None:
    for steps in range(10):
        polls = Polls(singles(40), Registers([5, 31]))
        run = polls.steps()
        requests = next(run)
        for _ in range(steps):
            requests = run.send(polls.ask(requests))
        run.close()
        assert len(polls.news) == len(polls.unreadable)
        assert lost(polls.poll(1)[1]) == [5, 31]


def test_a_strict_read_names_the_refused_items() -> None:
    for address in range(20):
        polls = Polls(singles(40), Registers([address, 30]))
        for most in (1 + 12, 2):
            count, answers = polls.strictly()
            (error,) = [answer for answer in answers if isinstance(answer, ModbusError)]
            assert error.names == (address,)
            assert str(error).startswith(f"{address}: illegal data address")
            assert count <= most
        assert polls.unreadable == [address]
        polls.device.missing.clear()
        count, answers = polls.strictly()
        assert polls.plan.results(answers) == [[at] for at in range(40)]
        assert count == 1
        assert not polls.refusals


def test_a_refused_item_that_is_answered_again_is_not_named() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.strictly()
    polls.device.missing = {12}
    _, answers = polls.strictly()
    assert answers[0].names == (12,)
    assert polls.unreadable == [12]


def bordered(borders: set[int], then: Any = lambda device, answer: answer) -> Registers:
    """Return a device that answers every register, and refuses reads across some addresses."""

    def refuse(device: Registers, answer: Any) -> Any:
        first, count = device.asked[-1]
        crosses = any(first < border < first + count for border in borders)
        return then(device, IllegalDataAddress() if crosses else answer)

    return Registers(then=refuse)


# The device, and the requests of the first and of later readings of its registers 0..99.
BORDERS = [
    (Registers(most=60), 3, 2),
    (bordered({50}), 3, 2),
    (bordered({20}), 15, 2),
    (bordered({10, 30, 95}), 35, 4),
]


@each_case("is_strict", [False, True])
@each_case(("device", "first", "later"), BORDERS)
def test_items_beyond_requests_of_the_device_are_read(device, first, later, is_strict) -> None:
    polls = Polls(singles(100), device)
    for most in (first, later, later):
        count, answers = polls.answers(is_strict=is_strict)
        assert polls.plan.results(answers) == [[at] for at in range(100)]
        assert count <= most
    assert not polls.unreadable


def test_a_refused_register_after_a_border_is_named() -> None:
    polls = Polls(singles(100), bordered({50}))
    polls.device.missing = {70}
    for most in (20, 2):
        count, answers = polls.strictly()
        assert answers[-1].names == (70,)
        assert count <= most


def test_a_refused_block_of_one_item_is_requested_once() -> None:
    """The second request would be answered."""

    def change(device: Registers, answer: Any) -> Any:
        device.missing.clear()
        return answer

    polls = Polls(singles(1), Registers([0]))
    polls.poll()
    polls.device = Registers([0], then=change)
    count, answers = polls.strictly()
    assert (count, answers[0].names) == (1, (0,))


def test_a_failure_during_the_search_of_an_item_keeps_the_refusal() -> None:
    silence = leaving(2, ModbusTimeoutError("silence"))
    polls = Polls(singles(20), Registers([15], then=silence))
    count, answers = polls.strictly()
    assert count == 3
    assert isinstance(answers[0], IllegalDataAddress)
    assert answers[0].names == ()


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
def test_all_existing_registers_are_read_after_some_runs(seed: int, count: int) -> None:
    """However wrong the first search was: it ends early while nothing is answered."""
    missing = set(random.Random(seed).sample(range(200), count))
    polls = Polls(singles(200), Registers(missing))
    for now in range(201):  # the search, and then one refusal in each poll
        _, values = polls.poll(now)
        if lost(values) == sorted(missing):
            break
    assert lost(values) == sorted(missing)


def test_a_refused_register_is_found_although_its_exception_changes() -> None:
    """The exception changes between requests, and the device is busy in between."""
    chance = random.Random(1)
    moods = (IllegalDataAddress, ServerDeviceBusy, IllegalDataValue, ServerDeviceFailure)

    def change(device: Registers, answer: Any) -> Any:
        device.refusal = chance.choice(moods)
        return answer

    for address in range(20):
        polls = Polls(singles(20), Registers([address], then=change))
        losses = [lost(polls.poll(now)[1]) for now in range(50)]
        assert losses[-1] == polls.unreadable == [address]
        assert all(address in loss for loss in losses)


FAILURES = (ModbusTimeoutError, ServerDeviceBusy, InvalidResponse, IllegalDataAddress)


def whims(seed: int) -> Registers:
    """Return a device that fails some requests without a reason, and loses registers meanwhile."""
    chance = random.Random(seed)
    share = chance.choice([0.02, 0.3, 0.9])

    def change(device: Registers, answer: Any) -> Any:
        if chance.random() < 0.02:
            device.missing = {chance.randrange(100) for _ in range(20)}
        return chance.choice(FAILURES)() if chance.random() < share else answer

    return Registers(then=change)


@each_case("is_strict", [False, True])
def test_no_value_is_wrong_however_a_device_answers(is_strict: bool) -> None:
    for seed in range(60):
        polls = Polls(singles(100), whims(seed))
        for now in range(0, 2000, 100):
            count, answers = polls.answers(now, is_strict=is_strict)
            assert count <= 2 * 100 + 1
            for answer, request in zip(answers, polls.plan.requests, strict=False):
                cells = range(request.address, request.address + request.count)  # type: ignore[attr-defined]
                if not isinstance(answer, ModbusError):
                    assert all(value in (None, at) for value, at in zip(answer, cells, strict=True))
