"""
The readings of a journal that memory keeps.
"""

from __future__ import annotations

from libmodbus_py.services.fleet.journal.tail import Tail
from tests.services.fleet.journal.journals import polls


def test_the_tail_keeps_the_newest_readings() -> None:
    tail = Tail(6, 9)
    assert tail.after(9, 100) == []
    every = polls(10, 5)
    for each in every:
        tail.add(each)
    assert (tail.before, tail.last) == (13, 19)
    assert tail.after(12, 100) is None
    assert tail.after(13, 100) == every[2:]
    assert tail.after(13, 3) == every[2:3]  # polls are whole
    assert tail.after(13, 1) == every[2:3]  # and there is one at least
    assert tail.after(17, 4) == every[4:]
    assert tail.after(19, 100) == []


def test_the_tail_forgets_what_it_dropped() -> None:
    tail = Tail(4, 0)
    for each in polls(1, 5000):
        tail.add(each)
    assert len(tail._polls) < 1100
    assert sum(len(each.readings) for each in tail._polls) == 4
    assert tail.after(tail.before, 100) == polls(9997, 2, time=5098.0)
