"""
The holes of a device: ranges that it refuses, and when they are tried again. No I/O, no clock.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..protocol.errors import (
    FrameError,
    IllegalDataAddress,
    IllegalDataValue,
    InvalidResponse,
    ModbusError,
    ServerDeviceFailure,
    alike,
)
from ..protocol.tables import TABLES

__all__ = [
    "DAMAGE",
    "REFUSALS",
    "Hole",
    "Holes",
    "HolesByDevice",
    "Span",
    "Unreadable",
    "is_refusal",
]

RETRY = 600.0
"""Seconds between two trials of what a device refused."""

RETRY_SOONER = 60.0
"""Seconds until the first such trial, and between those because of new connections."""

REPEATEDLY = 3
"""Invalid responses to the same request, in a row, that count as a refusal."""

MOST_SEARCHED = 256
"""Requests of searches at one device, at most, before they are rationed."""

SEARCHED_AGAIN = 32 / RETRY_SOONER
"""Requests of searches a second, from then on: a device may change all the time."""

SEARCHED_FOR_ONE = 8
"""Requests of searches that are not rationed for a hole that is found for the first time, and that
one found again counts as."""

MOST_CLIENTS = 16
"""Clients of one device that are remembered."""

MOST_DEVICES = 10_000
"""Devices of one plan whose holes are kept."""

# The others do not depend on what is read: the function, a busy device, a gateway.
REFUSALS = (IllegalDataAddress, IllegalDataValue, ServerDeviceFailure)

DAMAGE = (FrameError, InvalidResponse)


def is_refusal(outcome: object) -> bool:
    """True if an outcome is exception 2, 3 or 4, which can depend on the cells that are read."""
    return isinstance(outcome, REFUSALS)


class Span(NamedTuple):
    """Cells of a table that are read in one request."""

    table: str
    start: int
    stop: int

    def __str__(self) -> str:
        count = self.stop - self.start
        cell = "coil or input" if TABLES[self.table].is_bits else "register"
        what = f"{self.start}" if count == 1 else f"{self.start}..{self.stop - 1}"
        return f"{self.table} {what} ({count} {cell}{'s' * (count > 1)})"


@dataclass(frozen=True, slots=True)
class Hole:
    """
    A span that a device refused.

    Attributes:
        error: the last refusal.
        tried_at: the time of the last refusal, in seconds of any steady clock.
        refusals: how many trials were refused.
    """

    error: ModbusError
    tried_at: float
    refusals: int = 1

    @property
    def copied_error(self) -> ModbusError:
        """A copy of the error, which may be raised."""
        return alike(self.error)

    def again(self, error: ModbusError, now: float) -> Hole:
        """Return the same hole after another refusal."""
        return Hole(error, now, self.refusals + 1)

    def is_due(self, now: float) -> bool:
        """True if it is time for another trial."""
        return now - self.tried_at >= (RETRY_SOONER if self.refusals == 1 else RETRY)


@dataclass(frozen=True, slots=True)
class Unreadable:
    """
    An item of a plan that a device refuses, and that is left out for a time.

    Attributes:
        device: the device, such as "tcp://192.0.2.10:502, unit 17".
        name: the item: the name of a point, the key of a mapping, or the index in a list.
        table: the table of its cells.
        cells: the addresses of its cells.
        error: the error with which the device refused it last.
    """

    device: str
    name: Any
    table: str
    cells: range
    error: ModbusError

    def __str__(self) -> str:
        cells = Span(self.table, self.cells.start, self.cells.stop)
        return f"{self.name}, {cells}: {reason_of(self.error)}"


def reason_of(error: ModbusError) -> str:
    """Return the reason of an error without the request that it is about."""
    return str(error.args[0]) if error.args else str(error)


class Holes:
    """
    The facts that are known of one device. Each is complete at any time.

    Args:
        device: its name in messages.

    Attributes:
        refused: the holes. Those of a single item are found by halving; one that covers a whole
            request of a plan means that no read within it was answered.
        cuts: (table, address) of cells with which a request must begin, because the cells before
            them can be read, but not in the same request.
        most: the number of cells, by table, that one request may ask for, if fewer than the
            plan allows.
        seen: spans that were answered, in places where most are refused.
        search_after: the time before which nothing is searched for, because a search found nothing.
    """

    def __init__(self, device: str = "") -> None:
        self.device: str = device
        self.refused: dict[Span, Hole] = {}
        self.cuts: set[tuple[str, int]] = set()
        self.most: dict[str, int] = {}
        self.seen: set[Span] = set()
        self.search_after: float = -math.inf
        self._damaged: dict[Span, int] = {}
        self._connections: dict[Hashable, int] = {}
        self._learnt_at = 0.0
        # Requests of searches that the device has not yet got over, and at which time.
        self._searched = 0.0
        self._searched_at = 0.0
        self._ever: set[Span] = set()

    def __bool__(self) -> bool:
        return bool(self.refused or self.cuts or self.most or self._damaged)

    def note_connection(self, client: Hashable, connects: int, now: float) -> None:
        """
        Note the connection that is used. With another client all holes are due, because the device
        may be another one at the same place; after another connection of the same client those
        that were tried longer than `RETRY_SOONER` ago.
        """
        known = self._connections.get(client)
        if known == connects:
            return
        is_first = not self._connections
        if known is None and len(self._connections) >= MOST_CLIENTS:
            self._connections.clear()
        self._connections[client] = connects
        if is_first:
            return
        self.expire(now, 0.0 if known is None else RETRY_SOONER)
        if known is None or now - self._learnt_at >= RETRY:
            self.cuts.clear()
            self.most.clear()

    def expire(self, now: float, age: float = 0.0) -> None:
        """Make holes due that were tried so many seconds ago, or earlier."""
        for span, hole in list(self.refused.items()):
            if now - hole.tried_at >= age:
                self.refused[span] = Hole(hole.error, now - RETRY, hole.refusals)

    def add(self, span: Span, error: ModbusError, now: float) -> bool:
        """Add a hole, or note that it was refused again; return True if it is new."""
        known = self.refused.get(span)
        self.refused[span] = known.again(error, now) if known else Hole(error, now)
        if span not in self._ever:
            self._ever.add(span)
            self._searched -= SEARCHED_FOR_ONE
        elif known is None:  # it comes and goes, and each hole makes two requests of one
            self._searched += SEARCHED_FOR_ONE
        return known is None

    def fill(self, span: Span) -> bool:
        """Remove a hole; return True if it was there."""
        return self.refused.pop(span, None) is not None

    def cut(self, table: str, address: int, now: float) -> None:
        """Note that a request must begin at an address."""
        self.cuts.add((table, address))
        self._learnt_at = now

    def shorten(self, table: str, most: int, now: float) -> None:
        """Note how many cells of a table one request may ask for."""
        self.most[table] = min(most, self.most.get(table, most))
        self._learnt_at = now

    def may_search(self, now: float) -> int:
        """Return how many requests may be sent now to search for what cannot be read."""
        over = SEARCHED_AGAIN * max(0.0, now - self._searched_at)
        self._searched, self._searched_at = max(0.0, self._searched - over), now
        return int(MOST_SEARCHED - self._searched)

    def note_searched(self, requests: int) -> None:
        """Note requests of a search."""
        self._searched += requests

    def is_damaged(self, span: Span, outcome: object) -> bool:
        """True if this is the third invalid response in a row to the request for these cells."""
        if not isinstance(outcome, DAMAGE):
            self._damaged.pop(span, None)
            return False
        count = self._damaged[span] = self._damaged.get(span, 0) + 1
        return count >= REPEATEDLY

    def error_of(self, span: Span) -> ModbusError | None:
        """Return why a span cannot be read; None if no hole is known in it."""
        hole = self.refused.get(span)
        return None if hole is None else hole.copied_error


class HolesByDevice:
    """The `Holes` of each device at which a plan, or another plan of the same map, was run."""

    def __init__(self) -> None:
        self._known: dict[Hashable, Holes] = {}

    def __reduce__(self) -> tuple[type[HolesByDevice], tuple[()]]:
        # A copy of a map, in another process for one, learns for itself.
        return HolesByDevice, ()

    def __iter__(self) -> Iterator[Holes]:
        return iter(list(self._known.values()))

    def get(self, device: Hashable) -> Holes | None:
        """Return what is known of a device; None if nothing was refused yet."""
        return self._known.get(device)

    def made(self, device: Hashable, name: str) -> Holes:
        """Return what is known of a device, kept from now on."""
        if len(self._known) >= MOST_DEVICES and device not in self._known:
            self._known.pop(next(iter(self._known)), None)
        return self._known.setdefault(device, Holes(name))
