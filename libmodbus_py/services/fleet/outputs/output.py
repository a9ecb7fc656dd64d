"""
What takes readings away: the face that all outputs have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from ..commands import Commands
from ..readings import Reading

__all__ = ["Commanded", "Labelled", "Output", "OutputError"]


class OutputError(Exception):
    """An output is gone for good: there is nobody left to tell anything."""


class Output(Protocol):
    """
    Somewhere that readings go. One task calls it, one call at a time.

    OSError from `open` or `write` means that it takes nothing now: both are tried again, with
    pauses. OutputError means that it is over.
    """

    @property
    def name(self) -> str:
        """What it is called in statistics and messages."""
        ...

    async def open(self) -> None:
        """
        Get ready; also after a failure, and then anew.

        Raises:
            OSError, OutputError
        """
        ...

    async def write(self, readings: Sequence[Reading]) -> None:
        """
        Take readings; what was not taken when this fails is given again. From time to time
        there are none: only to say whether it is still there.

        Raises:
            OSError, OutputError
        """
        ...

    async def close(self) -> None:
        """For good, or until `open`. It must not raise, and be over in a second."""
        ...


@runtime_checkable
class Commanded(Protocol):
    """
    An output that takes commands as well.

    Attributes:
        takes_commands: whether it was told to.
    """

    takes_commands: bool

    def attach(self, commands: Commands) -> None:
        """Have these carry out what is asked; called before `Output.open`."""
        ...


@runtime_checkable
class Labelled(Protocol):
    """An output that wants to know the labels of devices as well."""

    def label(self, labels: Mapping[str, Mapping[str, str]]) -> None:
        """
        Set the labels of devices, by the names of the devices.

        It is called before `Output.open`, and when the devices of the fleet change.
        """
        ...
