"""
Things that only one output of a fleet may use: a file, the standard output, a topic.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from .output import Output

__all__ = ["Exclusive", "Overlap", "check_exclusive", "file_at", "shared"]


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


def check_exclusive(outputs: Sequence[Output], journal: Exclusive | None = None) -> None:
    """Raise ValueError if two outputs, or an output and the journal, would use the same thing."""
    found = shared(outputs)
    if found is not None:
        raise ValueError(f"two outputs use {found.what}")
    taken = journal.exclusive if journal is not None else ()
    for output in outputs:
        things = output.exclusive if isinstance(output, Exclusive) else ()
        both = [each for each in things if each in taken]
        if both:
            raise ValueError(f"the journal and {output.name} use {both[0]}")


def file_at(path: str) -> str:
    """Return the words for a file, the same for all paths that lead to it."""
    return f"the file {os.path.realpath(path)}"
