"""
Decides which response belongs to which request of one connection or line, and how each ended.

All tools that show or record traffic use these rules: the page and the pytest plugin for the trace
of a server, scans for the trace of a client, and listeners for the frames of a line (`separator`
first decides which of these are requests).

* A response belongs to the first open request with the same unit, function code and transaction
  id (0 on lines) to which it can be decoded as a response.
* A request ends earlier requests with the same transaction id: on a line all of them, because the
  client has stopped waiting. A response that arrives afterwards is late.
* Bytes that are not a frame belong to the last open request, unless its response follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from ...ports.schemes import framing_of
from ...ports.trace import TracedFrame
from ...protocol.errors import InvalidResponse
from ...protocol.framing import Frame
from ...protocol.pdu import RawRequest, Request
from .transaction import (
    Ending,
    Transaction,
    damage_transaction,
    decoded,
    ending_of,
    misuse_transaction,
    unasked_response,
)

# Seconds after which a request counts as unanswered, even if no other request was sent.
TIMEOUT = 5.0

LATEST = 60.0  # a response belongs to no request sent more seconds before it
MOST = 256  # the most open requests, and the most requests with late responses, that are remembered
MOST_CONNECTIONS = 1000  # the most connections of a trace that are followed at once


class SpoiledRequest(NamedTuple):
    """The outcome of a request after other bytes than its response, which may still follow."""

    ended: float
    outcome: Ending
    alone: Transaction  # of these bytes, if the response does follow


@dataclass(eq=False, slots=True)
class OpenRequest:
    """A request that may still be answered, and how often it had been sent before without one."""

    began: float
    ended: float
    frame: Frame
    request: Request[Any]
    repeats: int
    spoiled: SpoiledRequest | None = None

    def is_for(self, frame: Frame) -> bool:
        """Return True if unit, function code and transaction id are those of a response."""
        mine = self.frame
        is_same = mine.unit == frame.unit and mine.transaction == frame.transaction
        return is_same and mine.pdu[0] == frame.pdu[0] & 0x7F

    def outcome(self, frame: Frame) -> Ending:
        """Decode a response to this request; it is "unasked" if it belongs to another one."""
        return ending_of(self.request, frame.pdu) if self.is_for(frame) else Ending("unasked")

    def fits(self, frame: Frame) -> bool:
        """Return True for a valid response to this request."""
        return self.outcome(frame).kind in ("answered", "exception")


class Pairing:
    """The open requests of one connection or line; the caller empties `done`."""

    def __init__(
        self, *, is_line: bool = True, is_server: bool = False, timeout: float = TIMEOUT
    ) -> None:
        self.done: list[Transaction] = []
        self._is_line = is_line
        self._is_server = is_server  # no frame is missing: every one that was sent answers one
        self._timeout = timeout
        self._open: list[OpenRequest] = []
        self._late: dict[tuple[int, int], OpenRequest] = {}  # by unit and transaction id

    @property
    def due(self) -> OpenRequest | None:
        """The last open request; on a line there is only one, because clients wait."""
        return self._open[-1] if self._open else None

    def unanswered_request(self, unit: int) -> OpenRequest | None:
        """Return the last request to a unit of a line whose response may still arrive."""
        return self._late.get((unit, 0))

    def ask(self, began: float, ended: float, frame: Frame) -> None:
        """Take a request; its function code is in 1..127."""
        repeats = 0
        for earlier in self._open.copy():
            if earlier.frame.transaction == frame.transaction or earlier.spoiled is not None:
                repeats = earlier.repeats + 1 if earlier.frame == frame else repeats
                self._give_up(earlier)
        request = decoded(frame.pdu) or RawRequest.decode(frame.pdu)
        new = OpenRequest(began, ended, frame, request, repeats)
        if (self._is_line and frame.unit == 0) or not request.expects_response:
            self._end(new, Ending("broadcast"))
            return
        if len(self._open) >= MOST:
            self._give_up(self._open[0])
        self._open.append(new)

    def answer(self, began: float, ended: float, frame: Frame) -> Ending | None:
        """Take a response; return how it ended an open request, or None if it ended no request."""
        if not frame.pdu[0] & 0x7F:
            self.misuse(began, ended, frame)
            return None
        outcomes = [(open_request, open_request.outcome(frame)) for open_request in self._open]
        invalid = [pair for pair in outcomes if pair[1].kind == "invalid"]
        valid = [pair for pair in outcomes if pair[1].kind in ("answered", "exception")]
        request, outcome = [*valid, *invalid, (None, Ending("unasked"))][0]
        if (request is None or outcome.kind == "invalid") and self._end_late(began, ended, frame):
            return None
        if request is None:
            which = "" if self._is_line else f", transaction {frame.transaction}"
            text = f"sent as unit {frame.unit}, function {frame.pdu[0] & 0x7F}{which}"
            wrong = Ending("invalid", None, InvalidResponse(text, received=frame.pdu))
            due = self.due if self._is_server else None
            self._set_aside(ended, unasked_response(began, frame), due, wrong)
            return None
        for earlier in self._open[: self._open.index(request)]:
            if earlier.frame.transaction == frame.transaction:  # a later one was answered
                self._give_up(earlier)
        self._open.remove(request)
        if request.spoiled is not None:
            self.done.append(request.spoiled.alone)
        if outcome.kind != "invalid":
            self._late.pop(_key(frame), None)
        self._end(request, outcome, ended)
        return outcome

    def damage(self, began: float, ended: float, data: bytes) -> None:
        """Record bytes that form no frame, which arrived instead of a response or with one."""
        self._set_aside(ended, damage_transaction(began, data), self.due)

    def misuse(self, began: float, ended: float, frame: Frame) -> None:
        """Take a frame whose function code is not allowed, instead of a response or alone."""
        due = self.due
        is_of_unit = due is not None and due.frame.unit == frame.unit
        self._set_aside(ended, misuse_transaction(began, frame), due if is_of_unit else None)

    def withdraw(self, request: OpenRequest) -> None:
        """Turn an open request into a response that belongs to no request."""
        self._open.remove(request)
        self.done.append(unasked_response(request.began, request.frame))

    def tick(self, at: float) -> None:
        """End the requests that have been open for too long at this time, all at infinity."""
        for request in self._open.copy():
            if at - request.ended > self._timeout or at == math.inf:
                self._give_up(request)

    def is_idle(self, at: float) -> bool:
        """Return True if no earlier request can be answered any more."""
        return not self._open and all(at - late.ended > LATEST for late in self._late.values())

    def _end_late(self, began: float, ended: float, frame: Frame) -> bool:
        """Return True if a response belongs to a request that was given up."""
        late = self._late.get(_key(frame))
        if late is None or began - late.ended >= LATEST:
            return False
        outcome = late.outcome(frame)
        if outcome.kind not in ("answered", "exception"):
            return False
        del self._late[_key(frame)]
        self._end(late, outcome._replace(kind="late"), ended)
        return True

    def _set_aside(
        self,
        ended: float,
        alone: Transaction,
        request: OpenRequest | None,
        outcome: Ending | None = None,
    ) -> None:
        """Keep what may be the spoiled response to a request; without a request, report it."""
        if request is None:
            self.done.append(alone)
            return
        if request.spoiled is not None:
            self.done.append(request.spoiled.alone)
        request.spoiled = SpoiledRequest(
            ended, outcome or Ending(alone.kind, None, alone.error), alone
        )

    def _give_up(self, request: OpenRequest) -> None:
        self._open.remove(request)
        self._late.pop(_key(request.frame), None)
        if len(self._late) >= MOST:
            del self._late[next(iter(self._late))]
        self._late[_key(request.frame)] = request
        if request.spoiled is None:
            self._end(request, Ending("unanswered"))
        else:
            self._end(request, request.spoiled.outcome, request.spoiled.ended)

    def _end(self, request: OpenRequest, outcome: Ending, ended: float | None = None) -> None:
        duration = None if ended is None else max(ended - request.ended, 0.0)
        unit, pdu, _ = request.frame
        head = request.began, outcome.kind, unit, pdu[0], request.request
        self.done.append(
            Transaction(*head, outcome.response, outcome.error, duration, request.repeats)
        )


def _key(frame: Frame) -> tuple[int, int]:
    return frame.unit, frame.transaction


# --- traces of servers and clients ----------------------------------------------------------------


class Exchange(NamedTuple):
    """A transaction of one connection; `peer` is as in `TracedFrame`."""

    peer: str | None
    transaction: Transaction


class TracePairing:
    """Pairs the frames of all connections in the trace of a server or a client, as `Pairing`."""

    def __init__(self, *, is_server: bool = True, timeout: float = TIMEOUT) -> None:
        self.done: list[Exchange] = []
        self._is_server = is_server
        self._timeout = timeout
        self._connections: dict[tuple[str, str | None], Pairing] = {}

    def take(self, traced_frame: TracedFrame, at: float | None = None) -> None:
        """Take an ADU of the trace; `at` is the time on another clock than that of the trace."""
        at = traced_frame.time if at is None else at
        pairing = self._pairing(traced_frame)
        pairing.tick(at)
        unit, pdu = traced_frame.unit, traced_frame.pdu
        frame = None if unit is None else Frame(unit, pdu, traced_frame.transaction or 0)
        if (traced_frame.direction == "received") is not self._is_server:
            if frame is None:
                pairing.damage(at, at, traced_frame.adu)
            else:
                pairing.answer(at, at, frame)
        elif frame is None:
            pairing.done.append(damage_transaction(at, traced_frame.adu))
        elif not 0 < pdu[0] < 0x80:  # application protocol, 4.1
            pairing.done.append(misuse_transaction(at, frame))
        else:
            pairing.ask(at, at, frame)
        self._collect(traced_frame.peer, pairing)

    def tick(self, at: float) -> None:
        """End the requests that have been open for too long at this time."""
        for (endpoint, peer), pairing in list(self._connections.items()):
            pairing.tick(at)
            self._collect(peer, pairing)
            if pairing.is_idle(at):
                del self._connections[endpoint, peer]

    def end(self) -> None:
        """End all open requests, because nothing more will be received."""
        self.tick(math.inf)

    def _pairing(self, frame: TracedFrame) -> Pairing:
        key = frame.endpoint, frame.peer
        pairing = self._connections.pop(key, None)
        if pairing is None:
            is_line = framing_of(frame.endpoint) in ("rtu", "ascii")
            pairing = Pairing(is_line=is_line, is_server=self._is_server, timeout=self._timeout)
        while len(self._connections) >= MOST_CONNECTIONS:
            oldest = next(iter(self._connections))
            self._connections[oldest].tick(math.inf)
            self._collect(oldest[1], self._connections.pop(oldest))
        self._connections[key] = pairing  # the oldest comes first
        return pairing

    def _collect(self, peer: str | None, pairing: Pairing) -> None:
        self.done += [Exchange(peer, pair) for pair in pairing.done]
        pairing.done.clear()
