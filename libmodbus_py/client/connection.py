"""
The requests of one connection: when each is sent, and what its outcome is.

`Transactions` uses no socket, clock or event loop. A driver waits, reads and sends for it:

    submit      a caller has a request, or several
    start       send what may be sent now
    take        bytes were received; then `start` again, so that the server has work, then `settle`
    settle      decode the answers, and set the outcomes
    tick        the time `alarm` has come; then `settle`, then `start`
    withdraw    a caller is gone
    opened, failed, lost, interrupted, closed    what became of the connection itself

Three parts decide for it: `Queue`, which request is next; its `Matching`, which answer belongs to
which request (`Ids` by transaction ids, `Line` on lines without them, one request at a time); and
`Outcomes`, what becomes of a request without a result.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING

from ..ports.trace import Trace
from ..protocol.checks import finished, log_failure
from ..protocol.errors import ModbusConnectionError, ModbusError, alike
from .call import Batch, Call, Matching
from .ids import Ids
from .outcomes import CLOSED, Outcomes, add_hint, explain_end
from .queue import Queue
from .reconnecting import FORKED, IDLE, Notices, Reconnecting, State
from .statistics import Statistics

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from ..ports.port import Port
    from .options import AsyncOptions

__all__ = ["Transactions"]

# A connection is flooded if more bytes than this arrive that belong to no request.
MAX_UNASKED_BYTES = 1 << 16

# After so many connections in a row that end without an answer, all waiting requests fail.
LOSSES_BEFORE_END = 3


class Transactions:
    """
    Sends requests in their order, and settles their outcomes.

    Of the port only the name, the silence and the certificate are used.
    """

    def __init__(self, endpoint: Endpoint, settings: AsyncOptions, port: Port) -> None:
        self.in_flight: int = 0
        # The reason to replace the connection by a new one.
        self.broken: ModbusConnectionError | None = None
        # True if so many bytes arrived that belong to no request that it is no accident.
        self.is_flooded: bool = False
        self.is_guarded: bool = settings["may_send"] is not None
        self.notices: Notices = Notices()
        self.statistics: Statistics = settings["statistics"] or Statistics()
        self.url: str = str(endpoint)
        self._trace = Trace(self.url, settings["trace"], later=self.notices.add)
        # Whoever waits for a device to connect would miss the connection during a pause.
        pause = 0.0 if endpoint.is_listening else settings["max_pause"]
        life = Reconnecting(str(port), pause, self.statistics, self.notices, settings["on_state"])
        self.life: Reconnecting = life
        self.matching: Matching
        any_unit, any_id = settings["accept_unit"] == "any", settings["ids"] == "ignore"
        # With any id, a late answer would be taken for that of the next request.
        self._most_unanswered = 1 if any_id else settings["timeouts_before_reconnect"]
        common = endpoint, self.statistics, self._trace
        if endpoint.has_transactions:
            self.matching = Ids(*common, any_unit=any_unit, any_id=any_id)
        else:
            from .line import Line

            self.matching = Line(*common, port.silence, settings["delimiter"], any_unit=any_unit)
        self._has_ids = endpoint.has_transactions
        self._scheme = endpoint.scheme
        self._is_socket = not endpoint.is_serial
        self._settings = settings
        self.queue: Queue = Queue(self.matching, settings["max_in_flight"])
        self._outcomes = Outcomes(endpoint, port, self.queue, self.life, self.statistics)
        self._silent: list[tuple[float, Call]] = []  # calls without an answer, and when they end
        self._answered: list[Call] = []
        self._next_start = self._opened_at = 0.0
        self._spacing = settings["request_spacing"]
        self.idle_close: float | None = settings["idle_close"]

    @property
    def is_wanted(self) -> bool:
        """True if a request waits to be sent, or a caller waits for the connection."""
        return bool(self.queue.waiting or self.queue.again)

    @property
    def limit(self) -> int:
        """The most requests in flight."""
        return self.queue.limit

    @property
    def room(self) -> int:
        """The most requests in flight now: 0 while a write has no outcome yet."""
        return 0 if self.queue.write is not None else self.queue.limit

    # --- callers ------------------------------------------------------------------------------

    def submit(self, job: Call | Batch, now: float) -> None:
        """Accept a request, or several of one caller; outcomes may be set at once."""
        if isinstance(job, Batch):
            if not job.waiting:
                return
            call = job.next()
        else:
            call = job
        if not self.life.is_open:
            call.await_connection(now)
            refusal = self.life.refusal(now, call.deadline)
            if refusal is not None:
                self._outcomes.refuse(call, refusal)
                return
            self.matching.wake(call.deadline)
        elif call.request is None:
            call.settle(None)
            return
        self.queue.waiting.append(call)

    def withdraw(self, job: Call | Batch, now: float) -> None:
        """Forget requests; their answers count as missing until they arrive."""
        job.forget()
        # Of a batch also the calls after a failed one, which may be in flight.
        calls = job.calls if isinstance(job, Batch) else [job]
        were_in_flight = [self._let_go(call, now) for call in calls]
        if any(were_in_flight):
            self.matching.note_unanswered()

    def _let_go(self, call: Call, now: float) -> bool:
        """Stop waiting for a request whose caller left; return True if it was in flight."""
        self.queue.leave(call)
        was_in_flight = self.matching.withdraw(call, now)
        if was_in_flight:
            self.statistics.note(call.function, "cancelled")
            self.in_flight -= 1
        for due, other in self._silent:
            if other is call:
                self.matching.wake(due)  # it stays in flight until then, because the line is in use
        return was_in_flight

    def forbidden(self) -> ModbusConnectionError | None:
        """Return the error for requests that `may_send` does not allow now; None if it does."""
        if self._settings["may_send"] is None:
            return None
        try:
            answer = finished("may_send", self._settings["may_send"]())
            if answer is True:
                return None
            if answer is not False:
                raise TypeError(f"may_send must return True or False, not {answer!r}")
        except Exception:
            log_failure(__name__, "may_send failed; nothing is sent")
        return ModbusConnectionError("may_send allows no request now", errno=errno.EPERM)

    # --- sending ------------------------------------------------------------------------------

    def start(self, now: float, send: Callable[[list[bytes], float], object]) -> bool:
        """
        Send the requests that may be sent now; return True if any was sent.

        At once up to half of those that may be in flight: the next call sends the others, so that
        the server has work while answers are decoded. Frames are traced once they were sent.
        """
        queue, matching = self.queue, self.matching
        if not (queue.waiting or queue.again) or self.broken is not None or not self.life.is_open:
            return False
        if self.is_guarded and (error := self.forbidden()) is not None:
            self.refuse(error)
            return False
        if (matching.unanswered or matching.rest) and self._is_useless():
            if not self.in_flight:
                self._break("given up for a new connection")
            return False
        if now < self._next_start:
            matching.wake(self._next_start)
            return False
        adus: list[bytes] = []
        calls: list[Call] = []
        pending, spacing = self._answered, self._spacing
        room, in_flight = queue.half, self.in_flight
        if (is_traced := self._trace.is_on()) is not matching.is_traced:
            matching.trace_frames(is_on=is_traced)
        while (call := queue.next(now, in_flight, pending)) is not None:
            if call.adu:
                self.statistics.retries += 1
            adu = matching.start(call, now)
            call.note_sent(adu, now)
            adus.append(adu)
            in_flight += 1
            deadline = now - call.waited + call.timeouts.timeout
            if deadline < matching.alarm:
                matching.wake(deadline)
            if is_traced:
                calls.append(call)
            if call.changes:
                queue.note_write(call)
            if call.is_silent:
                self._note_silent(call, now)
            if spacing:
                self._next_start = now + spacing
                break
            room -= 1
            if not room or not (queue.waiting or queue.again):
                break
        self.in_flight = in_flight
        if not adus:
            return False
        self.is_flooded = False
        self.statistics.requests += len(adus)
        send(adus, now)
        for call in calls:
            self._trace.tell("sent", call.adu, call.unit, call.pdu[0])
        return True

    def _note_silent(self, call: Call, now: float) -> None:
        """Note that a request gets no answer: it is over after the turnaround."""
        due = now + self._settings["turnaround"]
        self._silent.append((due, call))
        self.matching.wake(due)

    def _is_useless(self) -> bool:
        """Return True if the connection is dead, or an answer on it was cut off."""
        matching = self.matching
        is_dead = self._is_socket and matching.unanswered >= self._most_unanswered
        # The next answer would be appended to half a frame that no request expects.
        is_cut = matching.rest and self.in_flight == len(self._silent) and not matching.drop_rest()
        return is_dead or bool(is_cut)

    # --- the connection -----------------------------------------------------------------------

    def opened(self, now: float) -> None:
        """The connection was established: send the waiting requests."""
        self._reset(now)
        self._opened_at = now
        self._next_start = max(self._next_start, now + self._settings["connect_delay"])
        for call in list(self.queue.waiting):
            call.note_connection(now)
            if call.request is None:
                self.queue.remove(call)
                call.settle(None)
        self.life.opened()
        self.matching.wake(self.idle_until(now))

    def begin_connecting(self, now: float) -> float | None:
        """
        Begin an attempt to connect, and return until when requests wait for it; None if none is
        due, and the alarm is set for a later one.
        """
        if self.life.state is not State.DISCONNECTED or not self.is_wanted:
            return None
        if self.life.next_attempt > now:
            self.matching.wake(self.life.next_attempt)
            return None
        if (forbidden := self.forbidden()) is not None:
            self.refuse(forbidden)
            return None
        self.life.connecting()
        return max((call.deadline for call in self.queue.calls), default=0.0)

    def failed(self, error: ModbusConnectionError, now: float, until: float = math.inf) -> None:
        """
        Note that no connection was established: the requests that wait for it fail.

        Those with more time than `until` wait for the next attempt, if this one had too little.
        """
        later: set[Call] = set()
        self.life.failed(error, now)
        if error.errno == errno.ETIMEDOUT:
            later = {
                call
                for call in self.queue.calls
                if call.deadline > until and self.life.refusal(now, call.deadline) is None
            }
        self.refuse(error, later)

    def lost(self, error: ModbusConnectionError, now: float, *, by_itself: bool = True) -> None:
        """Note the end of the connection: requests in flight fail, others wait for a new one."""
        if by_itself and error.errno in CLOSED:
            calls = self.matching.end(now)
            self.in_flight -= len(calls)
            self._answered += calls
            self.settle(now)
        was_answered = self.statistics.last_success is not None
        if by_itself and self.life.fruitless and self.in_flight and not was_answered:
            add_hint(error, explain_end(self._scheme, error.errno))
        self.life.lost(error, now, by_itself=by_itself)
        # Some devices close connections, and may do so while a request is under way to them.
        is_closed = by_itself and error.errno in CLOSED and not self.life.fruitless
        again = self._fail_all(error, now, but_reads=is_closed and not self.matching.has_begun())
        # A connection that was given up as dead has taken its time, and the next one may be alive.
        if by_itself and self.life.fruitless >= LOSSES_BEFORE_END:
            self.refuse(error)
        for call in list(self.queue.waiting):  # their time to wait for a connection begins
            self.queue.remove(call)
            if not call.is_done:
                self.submit(call, now)
        self.queue.wait_again(again)

    def closed(self, now: float) -> None:
        """Note that the client was closed: all requests fail, now and later."""
        self.life.close()
        error = self.life.refusal(now, now)
        assert error is not None
        self._fail_all(error, now)
        self.refuse(error)

    def interrupted(self, error: ModbusConnectionError, now: float) -> None:
        """Forget all requests, whose callers were interrupted, and give up the connection."""
        for call in [*self._reset(now), *self._answered]:
            self.statistics.note(call.function, "cancelled")
        self.queue.clear()
        self._answered = []
        if self.life.is_open:
            self.life.lost(error, now, by_itself=False)
        elif self.life.state is State.CONNECTING:
            self.life.given_up()

    def forked(self, now: float) -> None:
        """Forget all requests in a forked child: the connection belongs to the parent."""
        self.interrupted(ModbusConnectionError(FORKED, errno=errno.EBADF), now)

    def _reset(self, now: float) -> list[Call]:
        """Return the requests in flight, and reset the state of the previous connection."""
        calls = [*self.matching.reset(now), *(call for _, call in self._silent)]
        self.broken = None
        self.is_flooded = False
        self._silent = []
        self.in_flight = 0
        return calls

    def _break(self, reason: str) -> None:
        """Ask the driver to close the connection for a new one."""
        if self.broken is None:
            self.broken = ModbusConnectionError(reason)

    # --- failures -----------------------------------------------------------------------------

    def _fail_all(
        self, error: ModbusConnectionError, now: float, *, but_reads: bool = False
    ) -> list[Call]:
        """Fail the requests in flight; with `but_reads`, return those to be sent once more."""
        again: list[Call] = []
        for call in self._reset(now):
            if but_reads and not call.changes:
                call.await_another_connection()
                self.statistics.note(call.function, "lost")
                again.append(call)
            else:
                call.answer(alike(error))
                self._answered.append(call)
        self.settle(now)
        return again

    def refuse(self, error: ModbusError, later: Collection[Call] = ()) -> None:
        """Fail all waiting requests, except some."""
        for call in self.queue.drain(later):
            if not call.is_done:
                self._outcomes.refuse(call, error)

    # --- answers ------------------------------------------------------------------------------

    def take(self, chunks: Iterable[bytes], now: float) -> bool:
        """
        Take received bytes; return True if requests wait to be sent. `settle` decodes the answers;
        at once, if one is known to be an error, because it may end the other calls of its caller.
        """
        matching, queue = self.matching, self.queue
        for data in chunks:
            calls = matching.take(data, now)
            self.in_flight -= len(calls)
            self._answered += calls
        if matching.unasked > MAX_UNASKED_BYTES or not matching.is_in_step:
            self.is_flooded = matching.unasked > MAX_UNASKED_BYTES
            if not matching.is_in_step:
                self._break("closed, because the received bytes cannot be understood")
            elif self._is_socket:
                self._break("flooded with frames that answer no request")
        if not (queue.waiting or queue.again):
            return False
        for call in self._answered:
            if not isinstance(call.reply, bytes) or call.reply[0] & 0x80:
                return False
        return True

    def settle(self, now: float) -> None:
        """Decode the answers and set the outcomes."""
        calls, self._answered = self._answered, []
        for call in calls:
            if call.changes:
                self.queue.note_end(call)
            reply = call.reply
            if call.is_done:
                self.statistics.note(call.function, "cancelled")
            elif isinstance(reply, bytes):
                try:
                    result = call.request.decode_response(reply)  # type: ignore[union-attr]
                except BaseException as mistake:
                    self._outcomes.note_invalid(mistake, call, now)
                else:
                    self.statistics.note_answer(reply[0], now - call.sent_at, now)
                    if self.life.fruitless:  # the server or device is alive
                        self.life.prove()
                    call.settle(result)
                    if not self._has_ids:
                        self.matching.conclude(call, None, now)
            else:
                assert reply is not None
                self._outcomes.fail(reply, call, now)
            batch = call.batch
            if batch is not None:
                if batch.one_by_one and call.is_done and batch.waiting:
                    self.queue.waiting.append(batch.next())
                if batch.is_done and isinstance(call.outcome, BaseException):
                    for behind in batch.calls:
                        self._let_go(behind, now)

    # --- time ---------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """End requests whose time is over; `settle` tells their callers."""
        matching = self.matching
        matching.clear_alarm()
        self._end_silent(now)
        if self.life.is_open:
            calls = matching.expire(now)
            self.in_flight -= len(calls)
            self._answered += calls
            self.end_idle(now)
        else:
            self._end_waits(now)

    def idle_until(self, now: float) -> float:
        """Return when the connection is to be closed if no request comes; infinite for never."""
        if self.idle_close is None or not self.life.is_open:
            return math.inf
        used_at = max(self._opened_at, self.statistics.last_success or 0.0)
        return self.idle_close + (now if self.in_flight or self.is_wanted else used_at)

    def end_idle(self, now: float) -> None:
        """Ask the driver to close a connection that has been idle for too long."""
        if (until := self.idle_until(now)) <= now:
            self.broken = self.broken or IDLE
        else:
            self.matching.wake(until)

    def _end_silent(self, now: float) -> None:
        over = [call for due, call in self._silent if due <= now]
        self._silent = [silence for silence in self._silent if silence[0] > now]
        for call in over:
            self.in_flight -= 1
            self.queue.note_end(call)
            self.statistics.note(call.function, "silent")
            call.settle(None)
            if call.batch is not None and call.batch.waiting:
                self.queue.waiting.append(call.batch.next())
        for due, _ in self._silent:
            self.matching.wake(due)

    def _end_waits(self, now: float) -> None:
        """Fail the requests that have waited too long for a connection."""
        for call in self.queue.calls:
            if call.is_done:
                continue
            if call.deadline > now:
                self.matching.wake(call.deadline)
                continue
            self.queue.remove(call)
            self._outcomes.refuse(call, self.life.not_in_time(call.timeouts.timeout))
