"""
The common part of scans and searches: an iterator that sends requests, and can be left.
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
    """The work of a `Walker`; it has no reference to it, so that a walker can be collected."""

    def __init__(self) -> None:
        self.is_closed: bool = False
        self._prober: Prober | None = None
        self._asked_before = 0

    @property
    def requests(self) -> int:
        """The number of requests sent."""
        return self._asked_before + (self._prober.requests if self._prober else 0)

    @abstractmethod
    def steps(self) -> Generator[Item, None, None]:
        """Send requests, and yield what they find."""

    @contextlib.contextmanager
    def _asking(self, place: Place) -> Iterator[Prober]:
        """
        Connect while the block runs; then close the port and restore its settings.

        Raises:
            ModbusConnectionError: the connection cannot be made.
        """
        prober = self._prober = Prober(place)
        try:
            if self.is_closed:  # before this one could be closed
                prober.context.close()
            prober.context.connect()
            yield prober
        finally:
            prober.context.close()
            self._asked_before += prober.requests
            self._prober = None

    def close(self) -> None:
        """Let the request that is under way fail at once."""
        self.is_closed = True
        if (prober := self._prober) is not None:
            prober.context.close()


class Walker(Generic[Item]):
    """
    An iterator that sends requests while it is iterated, by one thread, and only reads.

    `close` may be called from any thread; `close`, the end, an exception, Ctrl-C and garbage
    collection close the connection and restore the settings of a serial port.
    """

    def __init__(self, walk: Walk[Item]) -> None:
        self.__walk: Walk[Item] = walk
        self.__steps: Generator[Item, None, None] = walk.steps()

    @property
    def requests(self) -> int:
        """The number of requests sent."""
        return self.__walk.requests

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        return next(self.__steps)

    def close(self) -> None:
        """Stop; any number of times, from any thread and from signal handlers."""
        self.__walk.close()
        with contextlib.suppress(ValueError):  # it is under way, and fails at once
            self.__steps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
