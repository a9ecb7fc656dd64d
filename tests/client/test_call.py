"""
What a call and a batch promise: one outcome each, and when several are over.
"""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from libmodbus_py import ModbusTimeoutError, pdu
from libmodbus_py.client.call import NOT_ASKED, Batch, Call, Timeouts, raised
from tests.support.cases import each_case

LATE = ModbusTimeoutError("late")
SILENT = pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0")


def batch(count: int, **options: Any) -> Batch:
    requests: list[pdu.Request[Any]] = [pdu.ReadCoils(number, 1) for number in range(count)]
    return Batch(1, requests, Timeouts(1, 0, 0), **options)


def settle(made: Batch, *outcomes: tuple[int, Any]) -> None:
    for index, outcome in outcomes:
        made.calls[index].settle(outcome)


# --- calls ----------------------------------------------------------------------------------


def test_the_outcome_of_a_call_is_told_once_and_stays() -> None:
    told: list[Call] = []
    call = Call(1, None, b"", Timeouts(1, 0, 0))
    call.on_done = told.append
    assert (call.is_done, call.outcome) == (False, NOT_ASKED)
    call.settle(None)
    call.settle(LATE)
    assert (call.is_done, call.outcome, told) == (True, None, [call])


def test_a_call_that_nobody_waits_for_tells_nobody() -> None:
    told: list[Call] = []
    call = Call(1, None, b"", Timeouts(1, 0, 0))
    call.on_done = told.append
    call.forget()
    call.settle(1)
    assert (call.is_done, call.outcome, told) == (True, NOT_ASKED, [])


def test_a_changed_timeout_holds_for_a_call_under_way() -> None:
    timeouts = Timeouts(1, 0, 0)
    call = Call(1, pdu.ReadCoils(0, 1), b"\x01", timeouts)
    call.since = 5.0
    assert call.deadline == 6.0
    timeouts.timeout = 3
    assert call.deadline == 8.0


@each_case(
    ("request", "is_broadcast", "changes", "is_silent"),
    [
        (None, False, False, False),
        (pdu.ReadCoils(0, 1), False, False, False),
        (pdu.WriteRegister(0, 1), False, True, False),
        (pdu.WriteRegister(0, 1), True, True, True),
        (SILENT, False, True, True),
    ],
)
def test_what_a_call_knows_of_its_request(
    request: Any, is_broadcast: bool, changes: bool, is_silent: bool
) -> None:
    call = Call(1, request, b"", Timeouts(1, 0, 0), is_broadcast=is_broadcast)
    assert (call.changes, call.is_silent) == (changes, is_silent)


# --- batches --------------------------------------------------------------------------------


@each_case("order", list(itertools.permutations(range(3))))
def test_all_results_decide_it_in_any_order(order: tuple[int, ...]) -> None:
    made = batch(3)
    for number in order:
        assert not made.is_done
        settle(made, (number, number))
    assert made.is_done
    assert made.outcomes == [0, 1, 2]


@each_case("order", list(itertools.permutations(range(4))))
def test_the_first_failure_decides_it_when_all_before_it_is_known(order: tuple[int, ...]) -> None:
    """The third one fails: the fourth does not matter."""
    made = batch(4)
    known = set()
    for number in order:
        settle(made, (number, LATE if number == 2 else number))
        known.add(number)
        assert made.is_done == ({0, 1, 2} <= known)
    assert made.outcomes[:3] == [0, 1, LATE]
    with pytest.raises(ModbusTimeoutError):
        raised(made.outcomes)


def test_they_start_in_their_order_and_no_more_than_the_limit() -> None:
    made = batch(3, limit=2)
    assert [made.next(), made.next(), made.next()] == [*made.calls[:2], None]
    made.under_way -= 1
    assert [made.next(), made.next()] == [made.calls[2], None]


def test_after_a_failure_nothing_more_starts() -> None:
    made = batch(4, limit=2)
    made.next(), made.next()
    settle(made, (1, LATE))
    assert not made.is_done
    made.under_way -= 1
    assert made.next() is None
    settle(made, (0, 0))
    assert made.is_done
    assert made.outcomes == [0, LATE, NOT_ASKED, NOT_ASKED]


def test_an_earlier_failure_takes_the_place_of_a_later_one() -> None:
    made = batch(4)
    settle(made, (2, LATE), (1, LATE))
    assert not made.is_done
    settle(made, (0, LATE))
    assert made.is_done


def test_with_go_on_failures_stand_in_their_places() -> None:
    made = batch(3, go_on=True)
    for number in (2, 0, 1):
        assert not made.is_done
        settle(made, (number, LATE))
    assert made.outcomes == [LATE] * 3
    raised(made.outcomes, (ModbusTimeoutError,))


def test_a_mistake_is_tolerated_by_nobody() -> None:
    made = batch(3, go_on=True)
    settle(made, (0, ZeroDivisionError()))
    assert made.is_done


def test_the_end_is_told_once() -> None:
    told: list[Batch] = []
    made = batch(1)
    made.on_done = told.append
    settle(made, (0, "first"), (0, "second"))
    made.settle(LATE)
    assert (told, made.outcomes) == ([made], ["first"])


def test_a_batch_that_fails_keeps_the_outcomes_it_has() -> None:
    made = batch(3)
    settle(made, (1, 1))
    made.settle(LATE)
    assert made.is_done
    assert made.outcomes[0] is LATE


def test_a_request_without_an_answer_makes_them_go_one_by_one() -> None:
    made = Batch(1, [pdu.ReadCoils(0, 1), SILENT], Timeouts(1, 0, 0), limit=16)
    assert made.limit == 1
    assert batch(2, limit=16).limit == 16


@pytest.mark.parametrize(
    ("request_", "options", "kind", "reason"),
    [
        (3, {}, TypeError, "request must be a request object of pdu, not int"),
        (pdu.ReadCoils, {"name": "requests[{}]"}, TypeError, r"requests\[1\] must be a request"),
        (pdu.ReadCoils(0, 1), {"is_broadcast": True}, ValueError, "unit 0 is a broadcast"),
    ],
)
def test_what_cannot_be_sent_is_refused_by_its_name(
    request_: Any, options: Any, kind: type[Exception], reason: str
) -> None:
    with pytest.raises(kind, match=reason):
        Batch(1, [pdu.WriteCoil(0, True), request_], Timeouts(1, 0, 0), **options)
