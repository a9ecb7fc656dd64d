"""
What was said last in a simulated world.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from .events import START, Events

__all__ = ["Exchange"]


class Sent(NamedTuple):
    """Bytes that were sent together."""

    at: float
    place: str
    connection: int
    is_client: bool
    data: bytes


class Exchange:
    """Keeps the last of what was sent."""

    def __init__(self, events: Events, most: int = 400) -> None:
        self._events = events
        self._sent: deque[Sent] = deque(maxlen=most)

    def tell(self, place: str, connection: int, is_client: bool, data: bytes) -> None:
        """See `Network.tap`."""
        self._sent.append(Sent(self._events.now - START, place, connection, is_client, data))

    def raw(self) -> Iterator[str]:
        """Return a line for each piece: the time, the place, who sent it, and its bytes."""
        for sent in self._sent:
            arrow = "->" if sent.is_client else "<-"
            where = f"{sent.place} {sent.connection}" if sent.connection else sent.place
            yield f"{sent.at:10.4f}  {where:24} {arrow} {sent.data.hex(' ')}"
