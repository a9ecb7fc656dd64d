"""
What scans and searches have in common: an iterator that asks, and that can be left.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from typing import Generic, Self, TypeVar

from .places import Place
from .probe import Prober

__all__ = ["Walk", "Walker"]

Item = TypeVar("Item")


class Walk(ABC, Generic[Item]):
    """The work; it knows nothing of its `Walker`, which whoever leaves it may just drop."""

    def __init__(self) -> None:
        self.is_closed: bool = False
        self._prober: Prober | None = None
        self._asked_before = 0

    @property
    def requests(self) -> int:
        """How many were sent."""
        return self._asked_before + (self._prober.requests if self._prober else 0)

    @abstractmethod
    def steps(self) -> Generator[Item, None, None]:
        """Ask, and give what was found."""

    @contextlib.contextmanager
    def _asking(self, place: Place) -> Iterator[Prober]:
        """
        Connect; the port is closed, and its settings restored, however this ends.

        Raises:
            ModbusConnectionError: there is no connection.
        """
        prober = self._prober = Prober(place)
        try:
            if self.is_closed:  # before anybody could close this one
                prober.context.close()
            prober.context.connect()
            yield prober
        finally:
            prober.context.close()
            self._asked_before += prober.requests
            self._prober = None

    def close(self) -> None:
        """Have whoever asks fail at once."""
        self.is_closed = True
        if (prober := self._prober) is not None:
            prober.context.close()


class Walker(Generic[Item]):
    """
    An iterator that asks while it is iterated, by one thread, and only reads.

    `close` may be called from anywhere; it, the end, an exception, Ctrl-C, and dropping it all
    close the connection, and restore the settings of a serial port.
    """

    def __init__(self, walk: Walk[Item]) -> None:
        self.__walk: Walk[Item] = walk
        self.__steps: Generator[Item, None, None] = walk.steps()

    @property
    def requests(self) -> int:
        """How many were sent."""
        return self.__walk.requests

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        return next(self.__steps)

    def close(self) -> None:
        """Stop; any number of times, from any thread and from signal handlers."""
        self.__walk.close()
        with contextlib.suppress(ValueError):  # it runs, and fails at once
            self.__steps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
