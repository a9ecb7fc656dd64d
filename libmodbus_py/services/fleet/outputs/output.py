"""
Outputs: their base class, and what only one may use: a file, the standard output,
a topic.
"""

from __future__ import annotations

import os
from collections.abc import Container, Mapping, Sequence
from itertools import combinations

from ..commands import Commands
from ..config import DeviceConfig
from ..readings import MOST_KEPT, Reading


class OutputError(Exception):
    """An output failed permanently: it will not accept readings again."""


class ReadingsRefused(ValueError):
    """The other side will never accept these readings, or one of them."""


class Output:
    """
    A destination of readings: the base of all outputs, also of those of a program.

    One task calls its methods, one call at a time. OSError from `open_output` or `write_readings`
    is temporary: both are tried again, after pauses. ConnectionError from `write_readings` may be
    due to the readings: a poll with which it is raised three times, each time after another poll
    was written, is dropped. OutputError is permanent, and ends the fleet. After any other exception
    from `write_readings` the readings are passed again, one poll at a time; a poll for which the
    exception is raised again is dropped.

    With a journal, readings are passed again in the next run of the program unless
    `write_readings` has returned.

    Attributes:
        name: the name of the output in statistics and messages.
        is_live: True to get the readings of this run only.
        buffer: the most readings that wait without a journal.
        exclusive: things that only one output may use, in words.
        takes_commands: True if the output receives commands.
    """

    name: str = "output"
    is_live: bool = False
    buffer: int = MOST_KEPT
    exclusive: tuple[str, ...] = ()
    takes_commands: bool = False

    @property
    def identity(self) -> str:
        """The name of its place in a journal."""
        return self.name

    def shares(self, other: Output) -> str | None:
        """Return what it would share with another output, in words; None if there is nothing."""
        return None

    def describe_devices(self, devices: Mapping[str, DeviceConfig]) -> None:
        """
        Set the devices by their names, before `open_output` and when they change.

        Raises:
            ValueError: a device lacks a label that the output needs; then nothing changes.
        """

    def attach_commands(self, commands: Commands) -> None:
        """Set the object that carries out commands, before `open_output`; see `takes_commands`."""

    async def open_output(self) -> None:
        """Connect; called again after each failure, once `close_output` was called."""

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        """
        Write readings, all of a poll in one call. From time to time the list is empty, so that a
        lost connection is noticed. ReadingsRefused means that one of them can never be written.
        """
        raise NotImplementedError

    async def close_output(self) -> None:
        """Disconnect, until it is opened again; raise nothing, take two seconds at most."""


def shared_thing(outputs: Sequence[Output]) -> tuple[int, int, str] | None:
    """Return the positions of two outputs that would use one thing, and the thing in words."""
    for (at, first), (second_at, second) in combinations(enumerate(outputs), 2):
        # One task calls an output: an object that is there twice would be called by two.
        what = f"the same {first.name}" if first is second else used_thing(second, first.exclusive)
        what = what or first.shares(second)
        if what is not None:
            return at, second_at, what
    return None


def check_exclusive(
    outputs: Sequence[Output], of_journal: Container[str] = (), sources: Container[str] = ()
) -> None:
    """
    Raise ValueError if outputs, a journal and source files share something, such as a file.
    """
    if (pair := shared_thing(outputs)) is not None:
        raise ValueError(f"two outputs use {pair[2]}")
    for output in outputs:
        if (both := used_thing(output, of_journal)) is not None:
            raise ValueError(f"the journal and {output.name} use {both}")
        if (both := used_thing(output, sources)) is not None:
            raise ValueError(f"{output.name} uses {both}, which the fleet is read from")


def used_thing(output: Output, others: Container[str]) -> str | None:
    """Return the first thing, such as a file, that an output shares with others, or None."""
    return next((thing for thing in output.exclusive if thing in others), None)


def file_at(path: str) -> str:
    """Return the words for a file, the same for all paths that lead to it."""
    return f"the file {os.path.realpath(path)}"
