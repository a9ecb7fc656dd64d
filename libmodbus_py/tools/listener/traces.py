"""
Transactions from the trace of a server or a client: `Traced` in, `Transaction` out.
"""

from __future__ import annotations

from typing import NamedTuple

from ...ports.schemes import framing_of
from ...ports.trace import Traced
from ...protocol.framing import Frame
from .pairing import TIMEOUT, Pairing
from .transaction import Transaction, damage_alone, misused

__all__ = ["Exchange", "TracePairing"]

# The most connections that are followed at once.
MOST_CONNECTIONS = 1000


class Exchange(NamedTuple):
    """
    A transaction of one connection.

    Attributes:
        peer: as in `Traced`: for a server, the client; None for clients.
    """

    peer: str | None
    transaction: Transaction


class TracePairing:
    """
    Pairs the requests and responses of all connections in one trace.

    Args:
        is_server: True for the trace of a server, False for that of a client.
        timeout: seconds after which a request counts as unanswered.

    Attributes:
        done: exchanges that have ended, in order; the caller empties it.
    """

    def __init__(self, *, is_server: bool = True, timeout: float = TIMEOUT) -> None:
        self.done: list[Exchange] = []
        self._request: str = "received" if is_server else "sent"
        self._is_server = is_server
        self._timeout = timeout
        self._connections: dict[tuple[str, str | None], Pairing] = {}

    def take(self, traced: Traced, at: float | None = None) -> None:
        """
        Take an ADU of the trace.

        Args:
            at: the time on another clock than that of `Traced.time`, in seconds.
        """
        at = traced.time if at is None else at
        pairing = self._pairing(traced)
        pairing.tick(at)
        unit, pdu = traced.unit, traced.pdu
        frame = None if unit is None else Frame(unit, pdu, traced.transaction or 0)
        if traced.direction != self._request:
            if frame is None:
                pairing.damage(at, at, traced.adu)
            else:
                pairing.answer(at, at, frame)
        elif frame is None:
            pairing.done.append(damage_alone(at, traced.adu))
        elif not 0 < pdu[0] < 0x80:  # application protocol, 4.1
            pairing.done.append(misused(at, frame))
        else:
            pairing.ask(at, at, frame)
        self._collect(traced.peer, pairing)

    def tick(self, at: float) -> None:
        """End the requests that have been open for too long at this time."""
        for key, pairing in list(self._connections.items()):
            pairing.tick(at)
            self._collect(key[1], pairing)
            if pairing.is_idle(at):
                del self._connections[key]

    def end(self) -> None:
        """End all open requests, because nothing more will be received."""
        for (_, peer), pairing in self._connections.items():
            pairing.end()
            self._collect(peer, pairing)

    def _pairing(self, traced: Traced) -> Pairing:
        key = traced.endpoint, traced.peer
        found = self._connections.pop(key, None) or self._made(traced.endpoint)
        while len(self._connections) >= MOST_CONNECTIONS:
            oldest = next(iter(self._connections))
            self._connections[oldest].end()
            self._collect(oldest[1], self._connections.pop(oldest))
        self._connections[key] = found  # the latest is the last
        return found

    def _made(self, endpoint: str) -> Pairing:
        is_line = framing_of(endpoint) in ("rtu", "ascii")
        return Pairing(is_line=is_line, is_server=self._is_server, timeout=self._timeout)

    def _collect(self, peer: str | None, pairing: Pairing) -> None:
        if pairing.done:
            self.done += [Exchange(peer, each) for each in pairing.done]
            pairing.done.clear()
