"""
When a batch is decided, and by what.
"""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from libmodbus_py import ModbusTimeoutError, pdu
from libmodbus_py.client.batch import NOT_ASKED, Batch, raised
from libmodbus_py.client.timeouts import Timeouts

LATE = ModbusTimeoutError("late")


def batch(count: int, **options: Any) -> Batch:
    requests: list[pdu.Request[Any]] = [pdu.ReadCoils(number, 1) for number in range(count)]
    return Batch(1, requests, Timeouts(1, 0, 0), **options)


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_all_results_decide_it_in_any_order(order: tuple[int, ...]) -> None:
    made = batch(3)
    for number in order:
        assert not made.is_done
        made.settle(number, number)
    assert made.is_done
    assert made.outcomes == [0, 1, 2]


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_the_first_failure_decides_it_when_all_before_it_is_known(order: tuple[int, ...]) -> None:
    """The third one fails: the fourth does not matter."""
    made = batch(4)
    known = set()
    for number in order:
        made.settle(number, LATE if number == 2 else number)
        known.add(number)
        assert made.is_done == ({0, 1, 2} <= known)
    assert made.outcomes[:3] == [0, 1, LATE]
    with pytest.raises(ModbusTimeoutError):
        raised(made.outcomes)


def test_after_a_failure_nothing_more_starts() -> None:
    made = batch(4)
    made.started = 2
    assert made.started < made.end
    made.settle(1, LATE)
    assert made.started == made.end
    made.settle(0, 0)
    assert made.is_done
    assert made.outcomes == [0, LATE, NOT_ASKED, NOT_ASKED]


def test_an_earlier_failure_takes_the_place_of_a_later_one() -> None:
    made = batch(4)
    made.settle(2, LATE)
    made.settle(1, LATE)
    assert not made.is_done
    made.settle(0, LATE)
    assert made.is_done


def test_with_go_on_failures_stand_in_their_places() -> None:
    made = batch(3, go_on=True)
    for number in (2, 0, 1):
        assert not made.is_done
        made.settle(number, LATE)
    assert made.outcomes == [LATE] * 3
    raised(made.outcomes, (ModbusTimeoutError,))


def test_a_mistake_is_tolerated_by_nobody() -> None:
    made = batch(3, go_on=True)
    made.settle(0, ZeroDivisionError())
    assert made.is_done


def test_what_is_decided_is_told_once_and_changes_no_more() -> None:
    told: list[int] = []
    made = batch(1)
    made.on_done = lambda batch: told.append(1)
    made.settle(0, "first")
    made.settle(0, "second")
    made.finish()
    assert (told, made.outcomes) == ([1], ["first"])


def test_a_request_without_an_answer_makes_them_go_one_by_one() -> None:
    silent = pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0")
    made = Batch(1, [pdu.ReadCoils(0, 1), silent], Timeouts(1, 0, 0), limit=16)
    assert made.limit == 1
    assert made.silent == [False, True]
    assert batch(2, limit=16).silent is None


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
