"""
Ranges of addresses, joined.
"""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["joined", "without"]


def joined(ranges: Iterable[range]) -> list[range]:
    """
    Return the ranges in their order, without empty ones; those that overlap or touch are one.

    Args:
        ranges: of step 1, in any order.
    """
    found: list[range] = []
    for each in sorted(filter(None, ranges), key=lambda each: each.start):
        if found and each.start <= found[-1].stop:
            found[-1] = range(found[-1].start, max(found[-1].stop, each.stop))
        else:
            found.append(each)
    return found


def without(ranges: Iterable[range], others: Iterable[range]) -> list[range]:
    """
    Return the parts of ranges that are in no other one.

    Args:
        ranges, others: both as `joined` returns them.
    """
    found: list[range] = []
    taken = list(others)
    at = 0
    for each in ranges:
        start = each.start
        while at < len(taken) and taken[at].stop <= start:
            at += 1
        within = at
        while within < len(taken) and taken[within].start < each.stop:
            found.append(range(start, taken[within].start))
            start = taken[within].stop
            within += 1
        found.append(range(start, each.stop))
    return [each for each in found if each]
