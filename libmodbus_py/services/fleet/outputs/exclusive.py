"""
Things that only one output of a fleet may use: a file, the standard output, a topic.
"""

from __future__ import annotations

import os
from collections.abc import Container, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from .output import Output

__all__ = ["Exclusive", "Overlap", "check_exclusive", "file_at", "shared", "used"]


@runtime_checkable
class Exclusive(Protocol):
    """
    An output, or a journal, that cannot share with others.

    Attributes:
        exclusive: what nothing else of the fleet may use, such as "the file /tmp/readings.csv".
    """

    exclusive: tuple[str, ...]


class Overlap(NamedTuple):
    """
    Something that two outputs would use.

    Attributes:
        first, second: the positions of the outputs.
        what: the thing in words.
    """

    first: int
    second: int
    what: str


def shared(outputs: Sequence[Output]) -> Overlap | None:
    """Return the first thing that two outputs would use, or None if there is none."""
    found: dict[object, int] = {}
    for at, output in enumerate(outputs):
        things = output.exclusive if isinstance(output, Exclusive) else ()
        # One task calls an output: an object that is there twice would be called by two.
        for key, what in (
            (id(output), f"the same {output.name}"),
            *((each, each) for each in things),
        ):
            if found.get(key, at) != at:
                return Overlap(found[key], at, what)
            found[key] = at
    return None


def check_exclusive(
    outputs: Sequence[Output], journal: Exclusive | None = None, sources: Container[str] = ()
) -> None:
    """
    Check that nothing is used twice.

    Args:
        sources: the files that the fleet is read from, as `file_at` calls them.

    Raises:
        ValueError: two outputs, an output and the journal, or an output and a source would use the
            same thing.
    """
    found = shared(outputs)
    if found is not None:
        raise ValueError(f"two outputs use {found.what}")
    taken = journal.exclusive if journal is not None else ()
    for output in outputs:
        if (both := used(output, taken)) is not None:
            raise ValueError(f"the journal and {output.name} use {both}")
        if (both := used(output, sources)) is not None:
            raise ValueError(f"{output.name} uses {both}, which the fleet is read from")


def used(output: Output, taken: Container[str]) -> str | None:
    """Return the first thing of an output that is taken, or None."""
    things = output.exclusive if isinstance(output, Exclusive) else ()
    return next((each for each in things if each in taken), None)


def file_at(path: str) -> str:
    """Return the words for a file, the same for all paths that lead to it."""
    return f"the file {os.path.realpath(path)}"
