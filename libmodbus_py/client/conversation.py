"""
What is asked over one connection, and what comes back. No socket, no clock, no event loop.

`Conversation` decides who is told what, as `turns` does who may ask when; which answer is
whose, its two kinds know: `in_flight` by transaction ids, `in_turn` on lines without.
The drivers wait and read for it, and call it with bytes and times (time.monotonic()).
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from typing import Any

from ..protocol.errors import (
    Acknowledge,
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    alike,
)
from .batch import Batch, Pending, Reply
from .hints import explain, shown
from .reconnecting import State
from .statistics import result_of
from .turns import Turns

__all__ = ["Conversation", "no_answer"]

BUSY = (Acknowledge, ServerDeviceBusy)

# A host that drops connections unanswered will do so again: then all who wait fail.
LOSSES_BEFORE_END = 3


class Conversation(Turns):
    """Tells callers what became of their requests; see `Turns`, who may ask when."""

    # --- for callers ------------------------------------------------------------------

    def add(self, batch: Batch, now: float) -> None:
        """Take what a caller asks; it is told by `Batch.is_done`."""
        batch.since = now
        deadline = now + batch.timeouts.timeout
        if not self.connection.is_open:
            refusal = self.connection.refusal(now, deadline)
            if refusal is not None:
                self._refuse(batch, refusal)
                return
            self._wake(deadline)
        elif not batch.pdus:
            batch.finish()
            return
        batch.limit = min(batch.limit, self.limit)
        batch.queued = True
        self._queue.append(batch)

    def adopt(self, batch: Batch, adu: bytes, now: float) -> None:
        """Wait for the answer to the only request of a batch, which was sent already."""
        batch.started = batch.in_flight = 1
        self._room -= 1
        self._wake(now + batch.timeouts.timeout)
        self._note_starts(1, now)
        self._register(batch, adu, now)

    def abandon(self, batch: Batch, now: float) -> None:
        """Nobody waits any more: late answers are dropped, and count as missing until they come."""
        batch.on_done = None
        batch.finish()
        self._leave_queue(batch)
        self._unanswered += self._let_go(batch, now) > 0

    def change_timeout(self, now: float) -> None:
        """Some `Timeouts` has changed."""
        self._wake(now)

    # --- what happened to the connection ------------------------------------------------

    def opened(self, now: float) -> None:
        """It stands."""
        self._begin_anew()
        self._restart(now)
        self._framer = self._make_framer()
        if self._pace.connect_delay:
            self._next_start = now + self._pace.connect_delay
        waiting, self._queue = self._queue, deque()
        for batch in waiting:
            batch.used = now - batch.since
            batch.queued = bool(batch.pdus)
            if batch.queued:
                self._queue.append(batch)
            else:
                batch.finish()
        self.connection.opened()

    def failed(self, error: ModbusConnectionError, now: float) -> None:
        """It could not be made: nobody who waits for it gets it."""
        try:
            self.connection.failed(error, now)
        finally:  # whatever who is told of it raises
            self.refuse(error)

    def lost(self, error: ModbusConnectionError, now: float, *, by_itself: bool = True) -> None:
        """It ended: what is in flight fails, the queue waits for the next one."""
        try:
            self.connection.lost(error, now, by_itself=by_itself)
        finally:
            self._fail_all(error, now)
        # Each that was given up as dead took its time, and the next one may be alive.
        if by_itself and self.connection.fruitless >= LOSSES_BEFORE_END:
            self.refuse(error)
        waiting, self._queue = self._queue, deque()
        for batch in waiting:
            batch.queued = False
            if not batch.is_done:
                self.add(batch, now)

    def closed(self, error: ModbusConnectionError, now: float) -> None:
        """There will never be another one: all fails."""
        try:
            self.connection.close()
        finally:
            self._fail_all(error, now)
            self.refuse(error)

    def interrupted(self, error: ModbusConnectionError, now: float) -> None:
        """Whoever asked is gone, in the midst of anything: nothing of it must be sent later."""
        in_flight = [*self._restart(now), *(asked for asked, _ in self._found)]
        for asked in in_flight:
            self.statistics.note(asked.function, "cancelled")
        self._queue, self._repeats, self._found = deque(), [], []
        self._begin_anew()
        if self.connection.is_open:
            self.connection.lost(error, now, by_itself=False)
        elif self.connection.state is State.CONNECTING:
            self.connection.given_up()

    def _fail_all(self, error: ModbusConnectionError, now: float) -> None:
        self._begin_anew()
        for asked in self._restart(now):
            self._found.append((asked, alike(error)))
        self.settle(now)

    def refuse(self, error: ModbusError) -> None:
        """There will be none now: the queue fails."""
        queue, self._queue = self._queue, deque()
        repeats, self._repeats = self._repeats, []
        for _, batch, index in repeats:
            self._fail_at(batch, index, error)
            self._refuse(batch, error)
        for batch in queue:
            self._refuse(batch, error)

    def _refuse(self, batch: Batch, error: ModbusError) -> None:
        batch.queued = False
        if not batch.pdus:
            batch.refusal = self._completed(alike(error), batch, None, b"")
            batch.finish()
        while batch.started < batch.end:
            self._fail_next(batch, error)

    def _fail_at(self, batch: Batch, index: int, error: ModbusError) -> None:
        self.statistics.note(batch.pdus[index][0], "unsent")
        sent = batch.sent.get(index, b"")  # an attempt before this one
        batch.settle(index, self._completed(alike(error), batch, index, sent))

    def _fail_next(self, batch: Batch, error: ModbusError) -> None:
        index = batch.started
        batch.started += 1
        self._fail_at(batch, index, error)

    # --- bytes ------------------------------------------------------------------------------

    def take(self, data: bytes, now: float) -> None:
        """Take received bytes; slots may be free again."""
        before = len(self._found)
        self._take(data, now)
        for asked, what in self._found[before:]:
            self._free(asked, what)

    def _free(self, asked: Pending, what: Reply) -> None:
        """Give back the slot, and the place in its batch, unless its next one depends on it."""
        self._room += 1
        batch = asked.batch
        if batch.limit > 1 and isinstance(what, bytes) and what[0] < 0x80:
            batch.in_flight -= 1
            if not batch.queued:
                self._enqueue(batch)

    def settle(self, now: float) -> None:
        """Decode what came and tell the callers."""
        if not self._found:
            return
        found, self._found = self._found, []
        before = self.statistics.responses
        for asked, what in found:
            batch = asked.batch
            if batch.limit == 1 or not isinstance(what, bytes) or what[0] >= 0x80:
                batch.in_flight -= 1
                if not batch.queued:
                    self._enqueue(batch)
            if batch.is_done:
                self.statistics.note(asked.function, "cancelled")
            else:
                self._conclude(asked, what, now)
        if self.statistics.responses > before:
            if self.connection.fruitless:
                self.connection.prove()
            self.statistics.last_success = now

    def _conclude(self, asked: Pending, what: Reply, now: float) -> None:
        batch, index = asked.batch, asked.index
        if isinstance(what, ModbusError):
            self._fail(what, asked, now)
        else:
            try:
                outcome = batch.requests[index].decode_response(what)
            except ModbusError as error:
                self.statistics.invalid += isinstance(error, InvalidResponse)
                error.received = self._received_with(asked, what)
                self._fail(error, asked, now)
            except BaseException as error:  # a mistake in a request class is its caller's
                self.statistics.note(asked.function, "invalid")
                batch.settle(index, error)
            else:
                self.statistics.note_answer(asked.function, "ok", now - asked.sent)
                batch.settle(index, outcome)
                if self.limit == 1:
                    self._follow(batch.requests[index])
        if batch.is_done and batch.in_flight:
            self._let_go(batch, now)

    def _fail(self, error: ModbusError, asked: Pending, now: float) -> None:
        batch, index = asked.batch, asked.index
        if isinstance(error, ExceptionResponse):
            self.statistics.exceptions += 1
            self.statistics.note_answer(asked.function, "exception", now - asked.sent)
        else:
            self.statistics.note(asked.function, result_of(error))
            if not isinstance(error, ModbusConnectionError):
                self._doubt(batch, now)
        if not self._repeat(error, asked, now):
            batch.settle(index, self._completed(error, batch, index, asked.adu))

    def _repeat(self, error: ModbusError, asked: Pending, now: float) -> bool:
        """Have it asked again, if that may be; it keeps its place in its batch meanwhile."""
        batch, index = asked.batch, asked.index
        is_busy = isinstance(error, BUSY)
        if not is_busy and (
            isinstance(error, ExceptionResponse) or not batch.requests[index].repeatable
        ):
            return False
        done = batch.repeated.get((index, is_busy), 0)
        if done >= (batch.timeouts.busy_retries if is_busy else batch.timeouts.retries):
            return False
        batch.repeated[index, is_busy] = done + 1
        batch.sent[index] = asked.adu
        batch.in_flight += 1
        if batch.in_flight >= batch.limit:
            self._leave_queue(batch)
        batch.since = now
        due = now + (min(1.0, 0.1 * 2**done) if is_busy else 0.0)
        self._repeats.append((due, batch, index))
        self._wake(due)
        return True

    def _completed(
        self, error: ModbusError, batch: Batch, index: int | None, sent: bytes
    ) -> ModbusError:
        """Tell the error what was asked, and say what it looks like."""
        error.unit, error.endpoint, error.sent = batch.unit, self._place, sent
        if index is not None:
            request = batch.requests[index]
            error.function, error.asked = request.function, str(request)
        if error.received and sent and isinstance(error, FrameError | ModbusTimeoutError):
            hint = explain(self._scheme, sent, error.received)
            error.args = (f"{error.args[0]}; {hint}",) if hint else error.args
        return error

    # --- time ------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """Give up what has been waited for too long; `settle` tells the callers."""
        self._be_still()
        before = len(self._found)
        self._note_quiet(now)
        self._end_silent(now)
        if self.connection.is_open:
            overdue = self._overdue(now)
            self.statistics.timeouts += len(overdue)
            self._unanswered += sum(asked.since >= self._answered_at for asked, _ in overdue)
            self._found += overdue
        else:
            self._end_waits(now)
        for asked, what in self._found[before:]:
            self._free(asked, what)

    def _end_silent(self, now: float) -> None:
        over = [asked for due, asked in self._silent if due <= now]
        self._silent = [each for each in self._silent if each[0] > now]
        for asked in over:
            self._room += 1
            asked.batch.in_flight -= 1
            self.statistics.note(asked.function, "silent")
            asked.batch.settle(asked.index, None)
            if not asked.batch.queued:
                self._enqueue(asked.batch)
        for due, _ in self._silent:
            self._wake(due)

    def _end_waits(self, now: float) -> None:
        """Of those who wait for the connection."""
        waiting, self._queue = self._queue, deque()
        for batch in waiting:
            if not self._is_too_late(batch, now):
                self._queue.append(batch)
        repeats, self._repeats = self._repeats, []
        for repeat in repeats:
            _, batch, index = repeat
            if not self._is_too_late(batch, now):
                self._repeats.append(repeat)
            elif not batch.is_done:
                self._fail_at(batch, index, self.connection.not_in_time(batch.timeouts.timeout))

    def _is_too_late(self, batch: Batch, now: float) -> bool:
        until = batch.since + batch.timeouts.timeout
        if until > now:
            self._wake(until)
            return False
        self._refuse(batch, self.connection.not_in_time(batch.timeouts.timeout))
        return True

    def _note_life(self, now: float) -> None:
        """Somebody is there."""
        self._unanswered = 0
        self._answered_at = now

    def _restart(self, now: float) -> list[Pending]:
        """Give what was in flight, and begin anew on another connection."""
        asked = [*self._forget(now), *(each for _, each in self._silent)]
        self._silent = []
        self._room = self.limit
        return asked

    def _let_go(self, batch: Batch, now: float) -> int:
        """Wait no more for a batch; says for how many answers it waited."""
        self._repeats = [each for each in self._repeats if each[1] is not batch]
        for due, asked in self._silent:
            if asked.batch is batch:
                self._wake(due)  # its slot is free only then: the line is still in use
        given_up = self._give_up(batch, now)
        for asked in given_up:
            self.statistics.note(asked.function, "cancelled")
        self._room += len(given_up)
        return len(given_up)

    # --- which answer is whose -----------------------------------------------------------------

    @property
    @abstractmethod
    def is_plain(self) -> bool:
        """Whether the next answer can only be that to the next request: nothing else may come."""

    @abstractmethod
    def next_number(self) -> int:
        """Give the id of a request that somebody else will send; 0 where there are none."""

    @abstractmethod
    def _register(self, batch: Batch, adu: bytes, now: float) -> None: ...

    @abstractmethod
    def _take(self, data: bytes, now: float) -> None: ...

    @abstractmethod
    def _received_with(self, asked: Pending, pdu: bytes) -> bytes:
        """Give the bytes in which a PDU came."""

    @abstractmethod
    def _overdue(self, now: float) -> list[tuple[Pending, Reply]]:
        """Give up what has been waited for too long, and wake for the rest."""

    @abstractmethod
    def _give_up(self, batch: Batch, now: float) -> list[Pending]:
        """Wait no more for a batch; gives what it waited for."""

    @abstractmethod
    def _forget(self, now: float) -> list[Pending]: ...

    def _note_quiet(self, now: float) -> None:  # silence means nothing with ids
        """Look at what silence has ended, and wake for it."""

    def _doubt(self, batch: Batch, now: float) -> None:  # none with ids
        """An answer is missing, or turned out to be none."""

    def _follow(self, request: Any) -> None:  # most lines stay as they are
        """A request was answered; some change the line."""


def no_answer(timeout: float, received: bytes) -> ModbusTimeoutError:
    """Say that a request got no answer, and what came instead."""
    if received:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {shown(received)}", received=received
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")
