"""
Things that only one output of a fleet may use: a file, the standard output, a topic.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from .output import Output

__all__ = ["Exclusive", "Overlap", "check_exclusive", "shared"]


@runtime_checkable
class Exclusive(Protocol):
    """
    An output that cannot share with others.

    Attributes:
        exclusive: what no other output of the fleet may use, such as "the file /tmp/readings.csv".
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


def check_exclusive(outputs: Sequence[Output]) -> None:
    """Raise ValueError if two outputs would use the same thing."""
    found = shared(outputs)
    if found is not None:
        raise ValueError(f"two outputs use {found.what}")
