"""
The protocols that outputs implement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from ..commands import Commands
from ..config import DeviceConfig
from ..readings import Reading

__all__ = ["Commanded", "Described", "Output", "OutputError", "ReadingsRefused"]


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
    any other exception from `write` the readings are passed
    again, one poll at a time; a poll for which the exception is raised again is dropped.

    With a journal, readings are passed again in the next run of the program unless `write` has
    returned. An output with an attribute `is_live` that is True gets those of this run only. The
    name of its place in the journal is its attribute `identity`, or else its name.
    """

    @property
    def name(self) -> str:
        """The name of the output in statistics and messages."""
        ...

    async def open(self) -> None:
        """
        Connect; called again after each failure, once `close` was called.

        Raises:
            OSError: the output cannot be reached now.
            OutputError: the output failed permanently.
        """
        ...

    async def write(self, readings: Sequence[Reading]) -> None:
        """
        Write readings, all of a poll in one call; they are passed again if this fails. From time
        to time the list is empty, so that a lost connection is noticed.

        Raises:
            ConnectionError: the other side did not accept the readings; it may be away.
            OSError: the readings cannot be written now.
            ReadingsRefused: these readings, or one of them, can never be written.
            OutputError: the output failed permanently.
        """
        ...

    async def close(self) -> None:
        """Disconnect, until `open` is called again; raise nothing, take two seconds at most."""
        ...


@runtime_checkable
class Commanded(Protocol):
    """
    An output that also receives commands.

    Attributes:
        takes_commands: True if commands are enabled.
    """

    takes_commands: bool

    def attach(self, commands: Commands) -> None:
        """Set the object that carries out commands; called before `Output.open`."""
        ...


@runtime_checkable
class Described(Protocol):
    """An output that also uses the maps or the labels of devices."""

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """
        Set the devices of the readings, by their names.

        It is called before `Output.open`, and when the devices of the fleet change.

        Raises:
            ValueError: a device lacks a label that this output needs; nothing changes then.
        """
        ...
