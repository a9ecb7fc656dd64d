"""
The readings of a journal that memory keeps: for the file, and for outputs that keep up.
"""

from __future__ import annotations

import pytest

from libmodbus_py.services.fleet.journal import place as recent
from libmodbus_py.services.fleet.journal.place import RecentPolls
from tests.services.fleet.journal.journals import polls


def filled(first: int, count: int) -> RecentPolls:
    made = RecentPolls(first - 1)
    for each in polls(first, count):
        made.add(each)
    return made


def test_polls_are_taken_whole_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 6)
    made, every = filled(10, 5), polls(10, 5)
    assert (made.before, made.last) == (9, 19)  # the file lacks them all
    assert made.after(9, 100) == every
    assert made.take(3) == every[:1]
    assert made.take(1) == every[1:2]  # one at least
    made.add(polls(20, 1)[0])
    assert (made.before, made.taken, made.dropped) == (13, 13, 0)
    assert made.after(12, 100) is None
    assert made.after(17, 3) == every[4:]
    assert made.after(21, 100) == []


def test_what_no_disk_takes_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 4)
    monkeypatch.setattr(recent, "MOST_WAITING", 8)
    made = filled(1, 3)
    assert made.take(4) == polls(1, 2)
    for each in polls(7, 100):
        made.add(each)
    # Those that were taken before are on their way to the disk, and not lost.
    assert (made.last, made.dropped) == (206, 206 - 8 - 4)
    assert made.take(1000) == made.after(198, 1000) == polls(199, 4, time=196.0)
    assert made.take(1) == []
