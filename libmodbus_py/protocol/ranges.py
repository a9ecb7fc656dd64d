"""
Ranges of addresses: as an argument, joined, and searched.

Ranges are "joined" if they are in ascending order, none is empty, and none touches the next one.
"""

from __future__ import annotations

import reprlib
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any

from .tables import TABLE_SIZE

__all__ = ["checked_ranges", "contains", "joined", "touches", "without"]

START = attrgetter("start")


def checked_ranges(
    name: str, given: Any, expected: str = "a range of addresses or a list of ranges"
) -> list[range]:
    """
    Return an argument that is a range, or several, as a list of ranges in ascending order.

    Args:
        name: the name of the argument, for errors.
        expected: what the argument may be, for errors.

    Raises:
        TypeError: the argument is neither a range nor an iterable of ranges.
        ValueError: a range has steps, or is not within 0..65535.
    """
    is_one = isinstance(given, range) or not isinstance(given, Iterable)
    items: list[Any] = [given] if is_one else list(given)
    found = [each for each in items if isinstance(each, range)]
    if len(found) < len(items):
        raise TypeError(f"{name} must be {expected}, not {reprlib.repr(given)}")
    for each in found:
        if each.step != 1 or each.start < 0 or (each and each[-1] >= TABLE_SIZE):
            raise ValueError(f"{name} must be within 0..{TABLE_SIZE - 1}, step 1, not {each}")
    return sorted(found, key=START)


def joined(ranges: Iterable[range]) -> tuple[range, ...]:
    """
    Return ranges in ascending order, without empty ones; those that overlap or touch become one.

    Args:
        ranges: of step 1, in any order.
    """
    found: list[range] = []
    for each in sorted(filter(None, ranges), key=START):
        if found and each.start <= found[-1].stop:
            found[-1] = range(found[-1].start, max(found[-1].stop, each.stop))
        else:
            found.append(each)
    return tuple(found)


def contains(ranges: Sequence[range], address: int, count: int = 1) -> bool:
    """Return True if joined ranges contain `count` addresses from `address` on."""
    at = bisect_right(ranges, address, key=START) - 1
    return at >= 0 and address + count <= ranges[at].stop


def touches(ranges: Sequence[range], address: int, count: int = 1) -> bool:
    """Return True if joined ranges contain any of `count` addresses from `address` on."""
    at = bisect_left(ranges, address + count, key=START) - 1
    return at >= 0 and address < ranges[at].stop


def without(ranges: Iterable[range], others: Sequence[range]) -> tuple[range, ...]:
    """Return the parts of joined ranges that are in none of other joined ranges."""
    found: list[range] = []
    for each in ranges:
        start = each.start
        at = max(bisect_right(others, start, key=START) - 1, 0)
        while at < len(others) and others[at].start < each.stop:
            found.append(range(start, others[at].start))
            start = max(start, others[at].stop)
            at += 1
        found.append(range(start, each.stop))
    return tuple(filter(None, found))
