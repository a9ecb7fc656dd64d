"""
What was said in a simulated world, as ``libmodbus-py listen`` prints it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from libmodbus_py.cli.find.listen import line_of
from libmodbus_py.protocol.framing import Frame, make_framer
from libmodbus_py.tools.listener.separator import Candidate, Separator
from libmodbus_py.tools.listener.transaction import Transaction

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

    def transactions(self) -> Iterator[str]:
        """Return a line for each request and its answer."""
        found: list[tuple[float, str]] = []
        for place, connection in dict.fromkeys(
            (sent.place, sent.connection) for sent in self._sent
        ):
            of_this = [
                sent for sent in self._sent if (sent.place, sent.connection) == (place, connection)
            ]
            for transaction in _paired(place, of_this):
                found.append((transaction.time, f"{place:24} {line_of(transaction)}"))
        return (text for _, text in sorted(found, key=lambda each: each[0]))


def _paired(place: str, pieces: list[Sent]) -> Iterator[Transaction]:
    separator = Separator("rtu")
    for sent in pieces:
        if place.startswith("tcp:"):
            framer = make_framer("tcp", "server" if sent.is_client else "client")
            for frame in framer.scan(sent.data):
                if isinstance(frame, Frame):
                    candidate = Candidate(
                        sent.at, sent.at, frame, sent.is_client, not sent.is_client
                    )
                    yield from separator.take(candidate)
        else:
            yield from separator.feed(sent.data, sent.at, "client" if sent.is_client else "server")
    yield from separator.end()
