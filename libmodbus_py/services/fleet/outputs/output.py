"""
Outputs: the protocol that they implement, and what only one may use: a file, the standard output,
a topic.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Container, Sequence
from itertools import combinations
from typing import Protocol

from ..readings import Reading

__all__ = [
    "Output", "OutputError", "ReadingsRefused", "check_exclusive", "file_at", "shared", "used",
]  # fmt: skip


class OutputError(Exception):
    """An output failed permanently: it will not accept readings again."""


class ReadingsRefused(ValueError):
    """The other side will never accept these readings, or one of them."""


class Output(Protocol):
    """
    A destination of readings. One task calls its methods, one call at a time.

    OSError from `open` or `write` is temporary: both are tried again, after pauses. ConnectionError
    from `write` may be due to the readings: a poll with which it is raised three times, each time
    after another poll was written, is dropped. OutputError is permanent, and ends the fleet. After
    any other exception from `write` the readings are passed again, one poll at a time; a poll for
    which the exception is raised again is dropped.

    With a journal, readings are passed again in the next run of the program unless `write` has
    returned. An output may also have these attributes::

        is_live            True to get the readings of this run only
        identity           the name of its place in the journal, if it is not that of the output
        buffer             the most readings that wait without a journal
        exclusive          a tuple of things that only one output may use, in words
        shares(other)      returns what it would share with another output, in words, or None
        describe(devices)  sets the devices by their names, before `open` and when they change;
                           raises ValueError, and changes nothing, if one lacks a label
        takes_commands     True if the output receives commands
        attach(commands)   sets the `Commands` that carry them out, before `open`
    """

    @property
    def name(self) -> str:
        """The name of the output in statistics and messages."""
        ...

    async def open(self) -> None:
        """Connect; called again after each failure, once `close` was called."""
        ...

    async def write(self, readings: Sequence[Reading]) -> None:
        """
        Write readings, all of a poll in one call. From time to time the list is empty, so that a
        lost connection is noticed. ReadingsRefused means that one of them can never be written.
        """
        ...

    async def close(self) -> None:
        """Disconnect, until `open` is called again; raise nothing, take two seconds at most."""
        ...


def shared(outputs: Sequence[Output]) -> tuple[int, int, str] | None:
    """Return the positions of two outputs that would use one thing, and the thing in words."""
    for (at, first), (second_at, second) in combinations(enumerate(outputs), 2):
        # One task calls an output: an object that is there twice would be called by two.
        what = f"the same {first.name}" if first is second else used(second, _exclusive(first))
        shares: Callable[[Output], str | None] | None = getattr(first, "shares", None)
        if what is None and shares is not None:
            what = shares(second)
        if what is not None:
            return at, second_at, what
    return None


def check_exclusive(
    outputs: Sequence[Output], journal: object = None, sources: Container[str] = ()
) -> None:
    """
    Raise ValueError if outputs, journal and the files the fleet is read from use a thing twice.
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


def _exclusive(thing: object) -> tuple[str, ...]:
    return getattr(thing, "exclusive", ())


def file_at(path: str) -> str:
    """Return the words for a file, the same for all paths that lead to it."""
    return f"the file {os.path.realpath(path)}"
