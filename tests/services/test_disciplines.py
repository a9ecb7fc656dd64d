"""
In which order requests that wait are asked: disciplines, and queues that stand before others.
"""

from __future__ import annotations

from typing import NamedTuple

from libmodbus_py.services.waiting_room import FairByHost, FirstCome, Precedence, WaitingRoom
from tests.support.cases import each_case
from tests.support.talk import little_kept


class Asked(NamedTuple):
    host: str
    client: str
    number: int


A0, A1, A2 = (Asked("h", "a", number) for number in range(3))
B0, C0 = Asked("h", "b", 0), Asked("i", "c", 0)


def odd(each: Asked) -> bool:
    return each.number == 1


def test_who_came_first_is_asked_first_but_for_one_who_is_put_there() -> None:
    queue: FirstCome[Asked] = FirstCome()
    assert queue.put(A0)
    assert queue.put(A1)
    queue.put_first(B0)
    assert list(queue) == [B0, A0, A1]
    assert queue.has(A1)
    assert not queue.has(C0)
    assert queue.pick(odd) == A1
    assert queue.pick(odd) is None
    queue.remove(B0)
    assert (queue.pick(), queue.pick(), len(list(queue))) == (A0, None, 0)


def test_of_fair_queues_what_is_not_there_is_not_found() -> None:
    queue: FairByHost[Asked] = FairByHost(9, 99)
    assert not queue.has(A0)
    assert queue.pick() is None
    for each in (A0, A1, B0, C0):
        assert queue.put(each)
        assert queue.has(each)
    assert not queue.has(A2)
    assert len(list(queue)) == 4
    assert sorted(queue) == [A0, A1, B0, C0]
    assert queue.pick(odd) == A1
    assert len(list(queue)) == 3
    assert queue.pick(odd) is None
    # The host that was asked comes behind the other, and its client behind the other.
    assert [queue.pick(), queue.pick(), queue.pick()] == [C0, B0, A0]
    assert (list(queue), queue.has(A0)) == ([], False)


def test_as_many_wait_as_may_of_a_client_and_in_all() -> None:
    queue: FairByHost[Asked] = FairByHost(2, 3)
    assert [queue.put(each) for each in (A0, A1, A2, B0, C0)] == [True, True, False, True, False]
    queue.remove(A1)
    assert [queue.put(each) for each in (A2, C0)] == [True, False]
    assert [*queue] == [A0, A2, B0]


def test_nothing_is_kept_of_those_who_were_asked() -> None:
    queue: FairByHost[Asked] = FairByHost(9, 99)
    stays = Asked("h", "stays", 0)
    with little_kept():
        for at in range(2000):
            name = f"{at}"
            each, other = Asked(name, name, 0), Asked("h", name, 0)
            assert queue.put(each)
            assert queue.put(other)
            assert queue.put(stays)
            assert {queue.pick(), queue.pick(), queue.pick()} == {each, other, stays}


def test_a_queue_has_precedence_over_those_behind_it() -> None:
    before: FairByHost[Asked] = FairByHost(1, 1)
    behind: FirstCome[Asked] = FirstCome()
    queues: Precedence[Asked] = Precedence([before, behind], lambda each: int(each.host == "h"))
    assert [queues.put(each) for each in (A0, A1, C0)] == [True] * 3
    assert not queues.put(C0._replace(number=1))  # the first queue is full
    assert list(queues) == [C0, A0, A1]
    assert [queues.has(each) for each in (A0, C0, B0)] == [True, True, False]
    assert queues.pick(odd) == A1
    assert queues.pick() == C0
    queues.remove(A0)
    assert queues.pick() is None
    assert not queues.waiting


class Request:
    def __init__(self, unit: int = 1, *, is_trial: bool = False, since: float = 0.0) -> None:
        self.unit = unit
        self.is_trial = is_trial
        self.misses = 1
        self.waits_since = since
        self.asked_at = 0.0


Room = WaitingRoom[Request]


def room(limit: int, most_trials: int | None = None) -> Room:
    return WaitingRoom(lambda: limit, FirstCome(), lambda _: 1.0, None, most_trials)


def begun(made: Room, now: float) -> Request | None:
    if (each := made.pick(now)) is not None:
        each.asked_at = now
        made.start(each)
    return each


@each_case(("most", "expected"), [(None, 3), (2, 2), (1, 1)])
def test_as_many_trials_are_made_as_may_be(most: int | None, expected: int) -> None:
    made = room(9, most)
    trials = [Request(unit, is_trial=True) for unit in range(3)]
    assert all(made.put(each) for each in trials)
    found = [begun(made, 0.5) for _ in range(4)]
    assert found == trials[:expected] + [None] * (4 - expected)
    assert made.in_flight == expected
    made.end(trials[0])
    assert made.in_flight == expected - 1
    assert begun(made, 0.6) is (trials[expected] if expected < 3 else None)


def test_beside_another_trial_none_is_made_that_others_would_wait_for() -> None:
    made = room(9)
    trials = [Request(unit, is_trial=True) for unit in (8, 9)]
    others = [Request(), Request()]
    for each in (*trials, *others):
        made.put(each)
    assert made.others == others
    # The first trial has waited for a timeout; then another request is asked.
    assert [begun(made, 1.0) for _ in range(2)] == [trials[0], others[0]]
    assert begun(made, 2.0) is others[1]  # one trial is still in flight
    assert begun(made, 2.0) is trials[1]  # now nobody waits
    assert made.others == []


def test_a_trial_is_due_after_a_timeout_of_waiting() -> None:
    for now, is_due in ((4.9, False), (5.0, True)):
        made = room(1)
        trial, other = Request(9, is_trial=True, since=4.0), Request()
        made.put(trial)
        made.put(other)
        assert begun(made, now) is (trial if is_due else other)


def test_nobody_makes_way_where_there_is_room() -> None:
    made = room(2)
    trial = Request(9, is_trial=True)
    made.put(trial)
    assert begun(made, 0.0) is trial
    made.put(Request())
    assert made.overstayed(0.9) is None  # the other may be asked beside it
    assert begun(made, 0.9) is not None
    made.put(Request())
    assert made.overstayed(0.9) is trial
    made.end(trial)
    assert made.overstayed(0.9) is None


def test_a_trial_lasts_no_longer_than_its_timeout() -> None:
    made = room(1)
    slow = Request()
    made.put(slow)
    begun(made, 0.0)
    made.end(slow, took=7.0)
    trial = Request(9, is_trial=True)
    made.put(trial)
    begun(made, 10.0)
    made.put(Request())
    assert made.overstayed(10.9) is None
    assert made.alarm == 11.0
    assert made.overstayed(11.0) is trial


def test_all_that_wait_are_given_back() -> None:
    made = room(1)
    trial, others = Request(9, is_trial=True), [Request(), Request()]
    for each in (trial, *others):
        made.put(each)
    assert made.clear() == [*others, trial]
    assert begun(made, 9.0) is None
    assert made.in_flight == 0
