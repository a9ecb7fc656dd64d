"""
What clients may not do in a simulated device, and what moves when they read.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable

from ...device.access import Access
from ...device.hooks import Hook
from ...protocol.errors import IllegalDataAddress
from ...protocol.tables import TABLES
from .clockwork import Clockwork
from .keys import ACCESS
from .ranges import Range
from .runs import Run

__all__ = ["AccessRules"]


class AccessRules:
    """
    The hooks of a device.

    Attributes:
        before_read, before_write: for the accesses that they are about, all others are answered
            without them; None if there are none.
    """

    def __init__(self, ranges: list[Range], clockwork: Clockwork) -> None:
        self._clockwork = clockwork
        unreadable = [each for each in ranges if not ACCESS[each.access][0]]
        unwritable = [each for each in ranges if not ACCESS[each.access][1]]
        moving = [each for each in ranges if each.behaviour]
        self._unreadable = _by_place(unreadable)
        self._unwritable = _by_place(unwritable)
        self.before_read: Hook | None = _hook(self._before_read, [*unreadable, *moving])
        self.before_write: Hook | None = _hook(self._before_write, unwritable)

    def _before_read(self, access: Access) -> None:
        _check(self._unreadable, access, "read")
        if access.table in TABLES:
            self._clockwork.refresh(access.table, access.address, access.count)

    def _before_write(self, access: Access) -> None:
        _check(self._unwritable, access, "written")


def _hook(call: Callable[[Access], None], ranges: Iterable[Range]) -> Hook | None:
    places: dict[str, list[range]] = {}
    for each in ranges:
        if each.file:
            places.setdefault("files", []).append(range(each.file, each.file + 1))
        else:
            places.setdefault(each.run.table, []).append(range(each.run.first, each.run.stop))
    return Hook(call, **places) if places else None


# (table, file) -> runs, in order.
_Runs = dict[tuple[str, int], list[Run]]


def _by_place(ranges: Iterable[Range]) -> _Runs:
    runs: _Runs = {}
    for each in sorted(ranges, key=lambda each: each.run.first):
        runs.setdefault(each.place, []).append(each.run)
    return runs


def _check(forbidden: _Runs, access: Access, what: str) -> None:
    runs = forbidden.get((access.table, access.file), [])
    stop = access.address + access.count
    at = bisect_left(runs, stop, key=lambda run: run.first) - 1  # the last that begins before
    if at >= 0 and access.address < runs[at].stop:
        span = f"{access.table} {access.address}..{stop - 1}"
        raise IllegalDataAddress(f"{span} cannot all be {what}")
