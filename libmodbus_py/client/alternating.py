"""
One request at a time, on framings without transaction ids. No socket, no event loop.

Nothing tells a late answer from the next one there. So after a failure the line must
have been quiet for one timeout before the next request starts.
"""

from __future__ import annotations

from collections.abc import Callable

from ..protocol.errors import FrameError, InvalidResponse, ModbusError
from ..protocol.framing import Frame, Framer
from .flight import Answer, Asked, Batch, Statistics, no_answer

__all__ = ["Alternating"]


# Bytes of a line that does not fall silent; the rest is more of the same.
MAX_SHOWN = 600


class Alternating:
    """
    See `flight.Flight`.

    Args:
        make_framer: makes the framer of a new connection.
    """

    has_broadcast = True
    in_step = True
    is_torn = False  # whatever is there when a request starts is thrown away
    limit = 1

    def __init__(
        self, make_framer: Callable[[], Framer], timeout: float, statistics: Statistics
    ) -> None:
        self.timeout = timeout
        self._make_framer = make_framer
        self._statistics = statistics
        self._framer = make_framer()
        self._asked: Asked | None = None
        self._silent: Asked | None = None
        self._received = b""
        self._late = b""
        self._wrong: ModbusError | None = None
        self.ready_at = 0.0
        self._end_doubt()

    @property
    def room(self) -> int:
        return 0 if self._asked or self._silent else 1

    @property
    def is_empty(self) -> bool:
        return self._asked is None

    @property
    def quiet(self) -> float | None:
        is_open = self._asked and (self._framer.pending or self._wrong)
        return self._framer.quiet if is_open else None

    def start(self, batch: Batch, now: float) -> Asked:
        self._end_doubt()
        self._framer = self._make_framer()
        self._received = b""
        self._wrong = None
        index = batch.started
        adu = self._framer.encode(Frame(batch.unit, batch.pdus[index]))
        asked = Asked(batch, index, adu, now)
        if index in batch.silent:
            self._silent = asked
        else:
            self._asked = asked
        return asked

    def take(self, data: bytes, now: float) -> list[Answer]:
        if self._asked is None:
            self._skip(data, now)
            return []
        self._received += data
        answers = self._judge(self._framer.scan(data))
        # On a serial line a good answer may follow noise, and another unit's answer
        # does not end the wait (serial line, 2.4.1).
        return answers or ([] if self._framer.pending else self._end_if_damaged())

    def fall_silent(self) -> list[Answer]:
        return self._judge(self._framer.scan_silence()) or self._end_if_damaged()

    def _judge(self, found: list[Frame | FrameError]) -> list[Answer]:
        assert self._asked is not None
        for each in found:
            if isinstance(each, FrameError):
                self._statistics.invalid += 1
                self._wrong = each
            elif each.unit == self._asked.batch.unit:
                return self._end(each.pdu)
            else:
                self._statistics.invalid += 1
                self._wrong = InvalidResponse(f"unit {each.unit} answered")
        return []

    def _end_if_damaged(self) -> list[Answer]:
        return self._end(self._wrong) if isinstance(self._wrong, FrameError) else []

    def _end(self, found: bytes | ModbusError) -> list[Answer]:
        asked, self._asked = self._asked, None
        assert asked is not None
        if isinstance(found, ModbusError):
            found.received = self._received
        return [(asked, found)]

    def overdue(self, now: float) -> list[Answer]:
        due = self.next_due()
        if due is None or due > now:
            return []
        return self._end(self._wrong or no_answer(self.timeout, self._received))

    def next_due(self) -> float | None:
        return None if self._asked is None else self._asked.since + self.timeout

    def received(self, asked: Asked, pdu: bytes) -> bytes:
        return self._received

    def end_silent(self, asked: Asked) -> bool:
        had_it = self._silent is asked
        if had_it:
            self._silent = None
        return had_it

    # --- after a failure ------------------------------------------------------------

    def doubt(self, now: float) -> None:
        """Let the line fall silent first: the answer may still come."""
        self.ready_at = now + self.timeout
        self._in_doubt = True

    def _skip(self, data: bytes, now: float) -> None:
        if self._in_doubt:
            self._statistics.late_answers += not self._late
            self._late = (self._late + data)[-MAX_SHOWN:]
            self.ready_at = now + self.timeout

    def _end_doubt(self) -> None:
        self._in_doubt = False
        self._late = b""
        self._patience: float | None = None

    def hopeless(self, now: float) -> FrameError | None:
        if self._patience is None:
            self._patience = now + 2 * self.timeout
        if now <= self._patience:
            return None
        self._patience = None
        return FrameError("the line does not fall silent", received=self._late)

    def abandon(self, batch: Batch, now: float) -> None:
        if self._asked is not None and self._asked.batch is batch:
            self._asked = None
            self.doubt(now)

    def restart(self, now: float) -> list[Asked]:
        if self._asked is not None:
            self.doubt(now)  # the unit is not on this side of the connection
        asked = [each for each in (self._asked, self._silent) if each is not None]
        self._asked = self._silent = None
        return asked
