"""
Things that only one output of a fleet may use: a file, the standard output, a topic.

An output, or a journal, may have an attribute `exclusive`: a tuple of such things in words, such as
"the file /tmp/readings.csv"; and a method `shares(other)`, which returns what it would share with
another output, in words, or None.
"""

from __future__ import annotations

import os
from collections.abc import Container, Sequence
from itertools import combinations

from .output import Output

__all__ = ["check_exclusive", "file_at", "shared", "used"]


def shared(outputs: Sequence[Output]) -> tuple[int, int, str] | None:
    """
    Return the first thing that two outputs would use, or None if there is none.

    Returns:
        The positions of the outputs, and the thing in words.
    """
    for (at, first), (second_at, second) in combinations(enumerate(outputs), 2):
        # One task calls an output: an object that is there twice would be called by two.
        what = f"the same {first.name}" if first is second else used(second, _exclusive(first))
        what = what or getattr(first, "shares", _nothing)(second)
        if what is not None:
            return at, second_at, what
    return None


def check_exclusive(
    outputs: Sequence[Output], journal: object = None, sources: Container[str] = ()
) -> None:
    """
    Check that nothing is used twice.

    Args:
        journal: the journal of the fleet; None if it has none.
        sources: the files that the fleet is read from, as `file_at` calls them.

    Raises:
        ValueError: two outputs, an output and the journal, or an output and a source would use the
            same thing.
    """
    if (found := shared(outputs)) is not None:
        raise ValueError(f"two outputs use {found[2]}")
    for output in outputs:
        if (both := used(output, _exclusive(journal))) is not None:
            raise ValueError(f"the journal and {output.name} use {both}")
        if (both := used(output, sources)) is not None:
            raise ValueError(f"{output.name} uses {both}, which the fleet is read from")


def used(output: Output, others: Container[str]) -> str | None:
    """Return the first thing of an output that is among those of others, or None."""
    return next((each for each in _exclusive(output) if each in others), None)


def file_at(path: str) -> str:
    """Return the words for a file, the same for all paths that lead to it."""
    return f"the file {os.path.realpath(path)}"


def _exclusive(thing: object) -> tuple[str, ...]:
    return getattr(thing, "exclusive", ())


def _nothing(_: object) -> None:
    """An output shares nothing unless it has a method for this."""
