"""
Ranges of addresses, joined.
"""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["joined"]


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
