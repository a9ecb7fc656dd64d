"""
Hooks of a simulated device: they refuse accesses, and compute moving values when they are read.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable

from ...device.access import Access
from ...device.hooks import Hook
from ...device.rules import WRITABLE
from ...protocol.errors import IllegalDataAddress
from ...protocol.tables import TABLES
from .clockwork import Clockwork
from .simulated_point import SimulatedPoint

__all__ = ["AccessRules"]


class AccessRules:
    """
    The hooks of a device.

    Attributes:
        before_read, before_write: hooks for the accesses that need them; all others are answered
            without them. None if no access needs one.
    """

    def __init__(self, points: list[SimulatedPoint], clockwork: Clockwork) -> None:
        self._clockwork = clockwork
        unreadable = [each for each in points if each.access == "write"]
        unwritable = [each for each in points if each.access == "read" and each.table in WRITABLE]
        moving = [each for each in points if each.behaviour]
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


def _hook(call: Callable[[Access], None], points: Iterable[SimulatedPoint]) -> Hook | None:
    places: dict[str, list[range]] = {}
    for each in points:
        if each.file:
            places.setdefault("files", []).append(range(each.file, each.file + 1))
        else:
            places.setdefault(each.table, []).append(range(each.first, each.stop))
    return Hook(call, **places) if places else None


# (table, file) -> points, in order.
_ByPlace = dict[tuple[str, int], list[SimulatedPoint]]


def _by_place(points: Iterable[SimulatedPoint]) -> _ByPlace:
    found: _ByPlace = {}
    for each in sorted(points, key=lambda each: each.first):
        found.setdefault(each.place, []).append(each)
    return found


def _check(forbidden: _ByPlace, access: Access, what: str) -> None:
    points = forbidden.get((access.table, access.file), [])
    stop = access.address + access.count
    at = (
        bisect_left(points, stop, key=lambda each: each.first) - 1
    )  # the last that begins before `stop`
    if at >= 0 and access.address < points[at].stop:
        span = f"{access.table} {access.address}..{stop - 1}"
        raise IllegalDataAddress(f"{span} cannot all be {what}")
