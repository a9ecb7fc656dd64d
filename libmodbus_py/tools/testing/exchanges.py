"""
What a server received and sent, as transactions.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ...ports.endpoint import parse
from ...ports.trace import Traced
from ...protocol.errors import InvalidResponse
from ...protocol.framing import Frame, Framing, Role, make_framer
from ...protocol.pdu import RawRequest, Request
from ..listener.outcome import Outcome, answered, damaged, decoded
from ..listener.transaction import Transaction

__all__ = ["MOST", "Exchanges"]

# Of a server that is never forgotten: what a test looks at, and no memory without bound.
MOST = 20_000


class Exchanges:
    """
    Notes the last `MOST` ADUs of one server; from any thread.

    Pairing waits until somebody wants to see it: it costs the server nothing.
    """

    def __init__(self) -> None:
        self._traced: deque[Traced] = deque(maxlen=MOST)

    def note(self, traced: Traced) -> None:
        """Take what a trace was told."""
        self._traced.append(traced)

    def transactions(self) -> list[Transaction]:
        """Give what passed, in the order of the requests."""
        pairing = _Pairing()
        for traced in self._traced.copy():
            pairing.take(traced)
        return [each.transaction() for each in pairing.exchanges]


@dataclass
class _Exchange:
    """One request, or bytes that are none, and what the server sent for it."""

    asked: Traced
    frame: Frame | None
    is_line: bool
    outcome: Outcome | None = None
    ended: float | None = None

    @property
    def request(self) -> Request[Any] | None:
        if self.frame is None:
            return None
        return decoded(self.frame.pdu) or RawRequest.decode(self.frame.pdu)

    def answer(self, traced: Traced, frame: Frame | None) -> None:
        self.ended = traced.time
        request = self.request
        if frame is None or request is None:
            self.outcome = damaged(traced.adu)
        elif not self.fits(frame):
            self.outcome = Outcome("invalid", None, self._not_mine(frame))
        else:
            self.outcome = answered(request, frame.pdu)

    def fits(self, frame: Frame) -> bool:
        mine = self.frame
        return mine is not None and (mine.unit, mine.transaction, mine.pdu[0]) == (
            frame.unit,
            frame.transaction,
            frame.pdu[0] & 0x7F,
        )

    def _not_mine(self, frame: Frame) -> InvalidResponse:
        which = "" if self.is_line else f", transaction {frame.transaction}"
        return InvalidResponse(
            f"sent as unit {frame.unit}, function {frame.pdu[0] & 0x7F}{which}",
            received=frame.pdu,
        )

    def _unanswered(self) -> Outcome:
        request = self.request
        if self.frame is None or request is None:
            return damaged(self.asked.adu)
        is_for_all = self.is_line and self.frame.unit == 0
        return Outcome("unanswered" if request.expects_response and not is_for_all else "broadcast")

    def transaction(self) -> Transaction:
        kind, response, error = self.outcome or self._unanswered()
        return Transaction(
            self.asked.time,
            kind,
            self.asked.unit,
            self.asked.function,
            self.request,
            response,
            error,
            None if self.ended is None else max(self.ended - self.asked.time, 0.0),
        )


class _Pairing:
    """Which answer belongs to which request; servers answer each client in its order."""

    def __init__(self) -> None:
        self.exchanges: list[_Exchange] = []
        self._open: dict[tuple[str, str | None], list[_Exchange]] = {}

    def take(self, traced: Traced) -> None:
        take = self._take_request if traced.direction == "received" else self._take_answer
        take(traced, self._open.setdefault((traced.endpoint, traced.peer), []))

    def _take_request(self, traced: Traced, open_ones: list[_Exchange]) -> None:
        framing = _framing(traced.endpoint)
        frame = _frame(traced, framing, "server")
        if frame is not None and not 0 < frame.pdu[0] < 0x80:
            frame = None  # no question (application protocol, 4.1)
        made = _Exchange(traced, frame, framing in ("rtu", "ascii"))
        self.exchanges.append(made)
        if made.frame is not None:
            open_ones.append(made)

    def _take_answer(self, traced: Traced, open_ones: list[_Exchange]) -> None:
        frame = _frame(traced, _framing(traced.endpoint), "client")
        at = _first(open_ones, frame)
        if at is not None:
            open_ones[at].answer(traced, frame)
            del open_ones[: at + 1]  # those before it get no answer any more


def _first(open_ones: Iterable[_Exchange], frame: Frame | None) -> int | None:
    """Where the request of an answer is; of one that fits none, what was asked last."""
    at = None
    for at, each in enumerate(open_ones):
        if frame is not None and each.fits(frame):
            return at
    return at


@lru_cache(16)
def _framing(url: str) -> Framing:
    return parse(url).framing


def _frame(traced: Traced, framing: Framing, role: Role) -> Frame | None:
    if traced.unit is None:
        return None
    framer = make_framer(framing, role)
    found = framer.scan(traced.adu) + framer.scan_silence()
    return next((each for each in found if isinstance(each, Frame)), None)
