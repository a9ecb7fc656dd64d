"""
Requests that need not wait for a connection.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from libmodbus_py.services.waiting_room import FairByHost, FirstCome, Precedence, WaitingRoom


@dataclass(eq=False)
class Request:
    unit: int = 1
    is_trial: bool = False
    misses: int = 1
    waits_since: float = 0.0
    asked_at: float = 0.0
    host: str = "h"
    client: str = "c"


Room = WaitingRoom[Request]


def room(limit: int = 1, owing: dict[int, float] | None = None) -> Room:
    ready_at = None if owing is None else lambda each: owing.get(each.unit, 0.0)
    return WaitingRoom(lambda: limit, FirstCome(), lambda _: 1.0, ready_at)


def test_as_many_begin_as_may_be_in_flight() -> None:
    made, each = room(limit=2), Request()
    assert made.begin(each, 0.0)
    assert made.begin(Request(), 0.0)
    assert not made.begin(Request(), 0.0)
    assert made.in_flight == 2
    made.end(each)
    assert made.begin(Request(), 0.0)


def test_none_begins_before_those_that_wait() -> None:
    made = room(limit=2)
    waiting = Request()
    made.put(waiting)
    assert not made.begin(Request(), 0.0)
    assert made.pick(0.0) is waiting
    made.start(waiting)
    assert made.begin(Request(), 0.0)


def test_none_begins_beside_a_trial_that_waits_which_may_be_due() -> None:
    made = room()
    trial = Request(9, is_trial=True)
    made.put(trial)
    assert not made.begin(Request(), 5.0)
    assert made.in_flight == 0
    assert made.pick(5.0) is trial


def test_a_unit_that_owes_an_answer_is_not_asked() -> None:
    made = room(owing={3: 2.0})
    assert not made.begin(Request(3), 1.9)
    assert made.in_flight == 0
    assert made.begin(Request(3), 2.0)


def test_a_trial_may_follow_a_request_that_began_at_once() -> None:
    made = room(limit=3)
    first, second = Request(9, is_trial=True), Request(8, is_trial=True)
    made.put(first)
    assert made.pick(0.0) is first
    made.start(first)
    made.end(first)
    each = Request()
    assert made.begin(each, 0.0)
    made.end(each)
    made.put(second)
    made.put(Request())
    assert made.pick(1.0) is second


def test_the_time_that_it_took_counts_for_trials() -> None:
    made, each = room(), Request()
    assert made.begin(each, 0.0)
    made.end(each, 0.4)
    trial = Request(9, is_trial=True, asked_at=1.0)
    made.put(trial)
    assert made.pick(1.0) is trial
    made.start(trial)
    assert not made.begin(Request(), 1.0)
    made.put(Request())
    assert made.overstayed(1.39) is None
    assert made.overstayed(1.4) is trial


@pytest.mark.parametrize("host", ["h", "i"])
def test_each_queue_says_whether_someone_waits(host: str) -> None:
    fair: FairByHost[Request] = FairByHost(9, 9)
    queues = Precedence([fair, FirstCome()], lambda each: int(each.host == "i"))
    assert not queues.waiting
    each = Request(host=host)
    queues.put(each)
    assert queues.waiting
    assert bool(fair.waiting) == (host == "h")
    queues.remove(each)
    assert not queues.waiting
    assert not fair.waiting
