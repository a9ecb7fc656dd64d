"""
The requests of one connection: when each may be sent, and what its outcome is.

`Conversation` uses no socket, clock or event loop. The drivers wait and read for it: they pass it
bytes and times (time.monotonic()), and send the frames that it returns. Its `Matching` determines
which answer belongs to which request: `in_flight` by transaction ids, `in_turn` on lines without
them.
"""

from __future__ import annotations

import errno
import math
from collections import deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from ..ports.endpoint import Endpoint
from ..ports.trace import Trace
from ..protocol.callbacks import finished, log_failure
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
from .capacity import Capacity, Lost
from .hints import explain, explain_end
from .matching import Matching, Replies
from .reconnecting import Reconnecting, State
from .statistics import Statistics, result_of

__all__ = ["Conversation", "Pace", "forbidden"]

BUSY = (Acknowledge, ServerDeviceBusy)

# A connection is flooded if more bytes than this arrive that belong to no request.
MAX_UNASKED = 1 << 16

# After so many connections in a row that end without an answer, all waiting batches fail.
LOSSES_BEFORE_END = 3


@dataclass(frozen=True, slots=True)
class Pace:
    """
    The minimum times between requests, in seconds.

    Attributes:
        turnaround: the duration of a request that gets no response.
        request_spacing: the minimum time between the starts of two requests.
        connect_delay: the time between connecting and the first request.
        timeouts_before_reconnect: timeouts in a row after which a connection counts as dead;
            a serial port never does.
    """

    turnaround: float
    request_spacing: float
    connect_delay: float
    timeouts_before_reconnect: int


class Conversation:
    """
    Sends the requests of batches in the order of their callers, and settles them.

    Args:
        endpoint: the endpoint of the connection.
        limit: the most requests that may be in flight.
        may_send: as in `AsyncOptions`.
        finds_out: True to find out how many requests the device takes at once.

    Attributes:
        limit: how many requests may be in flight now.
        in_flight: how many requests are in flight now.
        alarm: the time at which `tick` must be called; may be too early, but never too late.
        capacity: how many requests the device takes at once.
        is_guarded: True if `may_send` was given, and must be called before each request.
        broken: the reason to replace the connection by a new one, or None.
        is_flooded: True if so many bytes arrived that belong to no request that it is no accident.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        limit: int,
        pace: Pace,
        matching: Matching,
        connection: Reconnecting,
        statistics: Statistics,
        trace: Trace,
        may_send: Callable[[], bool] | None,
        finds_out: bool,
    ) -> None:
        capacity = Capacity(str(endpoint), limit, not finds_out, matching, statistics)
        self.limit: int = capacity.now
        self.in_flight: int = 0
        self.alarm: float = math.inf
        self.broken: ModbusConnectionError | None = None
        self.is_flooded: bool = False
        self.connection = connection
        self.statistics = statistics
        self._place = str(endpoint)
        self._scheme = endpoint.scheme
        self._is_socket = not endpoint.is_serial
        self._pace = pace
        self._matching = matching
        self._trace = trace
        self.is_guarded: bool = may_send is not None
        self._may_send = may_send
        self._is_traced = False
        self._has_ids = matching.has_ids
        self._most = limit
        self.capacity = capacity
        self._queue: deque[Batch] = deque()
        # Requests to send again, each with the time at which this is due.
        self._repeats: list[tuple[float, Batch, int]] = []
        # Requests that get no answer, each with the time at which it is over.
        self._silent: list[tuple[float, Pending]] = []
        self._replies: Replies = []
        self._next_start = 0.0

    @property
    def is_wanted(self) -> bool:
        """True if a request waits to be sent, or a caller waits for the connection."""
        return bool(self._queue or self._repeats or self.capacity.lost)

    @property
    def room(self) -> int:
        """The most requests in flight; 0 while one is sent alone, or waits to be sent alone."""
        return 0 if self.capacity.lost or self.capacity.is_on_trial else self.limit

    @property
    def is_plain(self) -> bool:
        """True if the next bytes can only answer the next request, and no caller waits."""
        return (
            not self.in_flight
            and self._matching.is_clean
            and self.connection.is_open
            and not (self._queue or self._repeats or self.capacity.lost)
            and not self._trace.is_on()
        )

    # --- callers ------------------------------------------------------------------------------

    def add(self, batch: Batch, now: float) -> None:
        """Enqueue a batch; `Batch.is_done` says when it is settled, perhaps at once."""
        batch.since = now
        if not self.connection.is_open:
            refusal = self.connection.refusal(now, batch.wait_until)
            if refusal is not None:
                self._refuse(batch, refusal)
                return
            self._wake(batch.wait_until)
        elif not batch.pdus:
            batch.finish()
            return
        if batch.limit > self._most:
            batch.limit = self._most
        batch.queued = True
        self._queue.append(batch)

    def adopt(self, batch: Batch, adu: bytes, now: float) -> None:
        """
        Expect the answer to the only request of a batch, which was already sent as `adu`.

        The sender has counted it.
        """
        batch.started = batch.in_flight = 1
        self.in_flight += 1
        self._wake(now + batch.timeouts.timeout)
        self.is_flooded = False
        pending = self._matching.start(batch, 0, now, adu)
        if self.capacity.is_open:
            self.capacity.note_start(pending, 0)

    def abandon(self, batch: Batch, now: float) -> None:
        """Drop a batch; its answers count as missing until they arrive."""
        batch.on_done = None
        batch.finish()
        self._leave_queue(batch)
        self._matching.unanswered += self._let_go(batch, now) > 0

    def change_timeout(self, now: float) -> None:
        """Note that some `Timeouts` were changed."""
        self._wake(now)

    def is_allowed(self) -> bool:
        """Return what `may_send` returns; True without it, False if it fails or returns neither."""
        if self._may_send is None:
            return True
        try:
            allowed = finished("may_send", self._may_send())
            if allowed is not True and allowed is not False:
                raise TypeError(f"may_send must return True or False, not {allowed!r}")
            return allowed
        except Exception:
            log_failure(__name__, "may_send failed; nothing is sent")
            return False

    # --- sending ------------------------------------------------------------------------------

    def start(self, now: float) -> list[bytes]:
        """
        Return the frames to send now: up to half of what may be in flight.

        The next call returns the other half, so that the server has work meanwhile.
        """
        if not (self._queue or self._repeats or self.capacity.lost):
            return []
        if self.is_guarded and not self.is_allowed():
            self.refuse(forbidden())
            return []
        if self.in_flight >= self.limit or not self._is_usable():
            return []
        if now < self._next_start:
            self._wake(self._next_start)
            return []
        adus: list[bytes] = []
        self._is_traced = self._trace.is_on()
        if self.capacity.lost or self.capacity.is_on_trial:
            self._start_trial(adus, now)
        if not (self.capacity.lost or self.capacity.is_on_trial):
            if self._repeats:
                self._start_repeats(adus, now)
            if self._queue and not (adus and self._pace.request_spacing):
                self._start_queue(adus, now)
        if adus:
            self.is_flooded = False
            self.statistics.requests += len(adus)
            if self._pace.request_spacing:
                self._next_start = now + self._pace.request_spacing
        if self._matching.alarm < self.alarm:
            self.alarm = self._matching.alarm
        return adus

    def _is_usable(self) -> bool:
        """Return True if requests may be sent over this connection; else it may be broken now."""
        if self.broken is not None or not self.connection.is_open:
            return False
        if self._replies and self.limit == 1:
            return False  # bytes on a line belong to the request that they answer
        matching = self._matching
        is_dead = (
            self._is_socket
            and matching.unanswered >= self._pace.timeouts_before_reconnect
            and not self.capacity.lost  # lost requests may be answered when they are sent alone
        )
        # The next answer would be appended to half a frame that no pending request expects.
        has_leftover = matching.rest and self.in_flight == len(self._silent)
        if not is_dead and not has_leftover:
            return True
        if not self.in_flight:
            self._break("given up for a new connection")
        return False

    def _start_queue(self, adus: list[bytes], now: float) -> None:
        room = self._window()
        while room > 0 and self._queue and (batch := self._pick(now)) is not None:
            # Other batches of the queue have their turn before the next request of this batch.
            most = 1 if self._queue else room
            count = max(0, min(most, batch.limit - batch.in_flight, batch.end - batch.started))
            for index in range(batch.started, batch.started + count):
                adus.append(self._start(batch, index, now))
            batch.started += count
            batch.in_flight += count
            room -= count
            batch.queued = False
            if batch.started < batch.end:
                self._enqueue(batch)

    def _window(self) -> int:
        """Return how many requests may start at once."""
        room = self.limit - self.in_flight
        if self._pace.request_spacing:
            return min(room, 1)
        first = self._queue[0].limit
        return min(room, ((self.limit if first == 1 else min(first, self.limit)) + 1) // 2)

    def _pick(self, now: float) -> Batch | None:
        """Remove and return the first batch in the queue with a request that may be sent now."""
        queue = self._queue
        held: list[Batch] = []
        picked = None
        while queue and picked is None:
            batch = queue.popleft()
            if batch.started >= batch.end:
                batch.queued = False
            elif self._has_ids or self._may_start_next(batch, now):
                picked = batch
            else:
                held.append(batch)
        if held:
            queue.extendleft(reversed(held))
        return picked

    def _may_start_next(self, batch: Batch, now: float) -> bool:
        try:
            return self._matching.may_start(batch, now)
        except FrameError as error:
            self._fail_next(batch, error)
            return False

    def _enqueue(self, batch: Batch) -> None:
        if not batch.queued and batch.in_flight < batch.limit and batch.started < batch.end:
            batch.queued = True
            self._queue.append(batch)

    def _leave_queue(self, batch: Batch) -> None:
        if batch.queued:
            batch.queued = False
            self._queue.remove(batch)

    def _start(self, batch: Batch, index: int, now: float) -> bytes:
        deadline = now + batch.timeouts.timeout - batch.used
        if deadline < self.alarm:
            self.alarm = deadline
        pending = self._matching.start(batch, index, now)
        batch.used = 0.0
        if self.capacity.is_open:
            self.capacity.note_start(pending, self.in_flight)
        self.in_flight += 1
        if batch.silent and batch.silent[index]:
            self._silent.append((now + self._pace.turnaround, pending))
            self._wake(now + self._pace.turnaround)
        if self._is_traced:
            self._trace.tell("sent", pending.adu, batch.unit, batch.pdus[index][0])
        return pending.adu

    def _start_repeats(self, adus: list[bytes], now: float) -> None:
        waiting, self._repeats = self._repeats, []
        for repeat in waiting:
            due, batch, index = repeat
            is_full = self.in_flight >= self.limit or (adus and self._pace.request_spacing)
            if not batch.matters(index):
                batch.in_flight -= 1
            elif due > now or is_full:
                self._repeats.append(repeat)
                self._wake(due if due > now else self.alarm)
            else:
                self._start_repeat(repeat, adus, now)

    def _start_repeat(
        self, repeat: tuple[float, Batch, int], adus: list[bytes], now: float
    ) -> None:
        _, batch, index = repeat
        try:
            may_start = self._has_ids or self._matching.may_start(batch, now)
        except FrameError as error:
            batch.in_flight -= 1
            self._fail_at(batch, index, error)
            self._enqueue(batch)
            return
        if may_start:
            self.statistics.retries += 1
            adus.append(self._start(batch, index, now))
        else:
            self._repeats.append(repeat)

    def _start_trial(self, adus: list[bytes], now: float) -> None:
        """Ask alone one of the requests that were lost beside others, once none is in flight."""
        if self.in_flight or self._replies or (asked := self.capacity.next_trial()) is None:
            return
        batch, index = asked[0].batch, asked[0].index
        timeout = batch.timeouts.timeout
        batch.used = timeout - self.capacity.time_for_trial(timeout)
        self.statistics.retries += 1
        adus.append(self._start(batch, index, now))

    def _end_trial(self, reply: Reply, now: float) -> None:
        """Ask again what was lost beside others, or fail it, now that one was asked alone."""
        is_taken, lost = self.capacity.conclude(reply)
        self.limit = self.capacity.now
        if not is_taken:
            self._fail_lost(lost, now)
            return
        for pending, _ in lost:
            pending.batch.sent[pending.index] = pending.adu
            self._repeats.append((now, pending.batch, pending.index))
        self.capacity.tell()

    def _fail_lost(self, lost: list[Lost], now: float) -> None:
        for pending, error in lost:
            pending.batch.in_flight -= 1
            self._go_on_without(error, pending, now, self._repeat)
            self._enqueue(pending.batch)

    def _wake(self, at: float) -> None:
        if at < self.alarm:
            self.alarm = at

    # --- the connection -----------------------------------------------------------------------

    def opened(self, now: float) -> None:
        """The connection was established: send what waits for it."""
        self._reset(now)
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

    def time_to_connect(self) -> float:
        """Return the longest timeout of the batches that wait for a connection, in seconds."""
        return max((batch.timeouts.timeout for batch in self._waiting()), default=0.0)

    def failed(self, error: ModbusConnectionError, now: float, until: float = math.inf) -> None:
        """
        Note that no connection was established: the batches that wait for it fail.

        Args:
            until: the end of the time for the attempt. If it failed for lack of time, batches that
                have more time wait for the next attempt.
        """
        later: set[Batch] = set()
        try:
            self.connection.failed(error, now)
            if error.errno == errno.ETIMEDOUT:
                later = {each for each in self._waiting() if self._has_time(each, until, now)}
        finally:  # even if `on_state` raises
            self.refuse(error, later)

    def _waiting(self) -> list[Batch]:
        return [*self._queue, *(batch for _, batch, _ in self._repeats)]

    def _has_time(self, batch: Batch, until: float, now: float) -> bool:
        """Return True if a batch has more time than an attempt had, and waits for the next one."""
        deadline = batch.wait_until
        return deadline > until and self.connection.refusal(now, deadline) is None

    def lost(self, error: ModbusConnectionError, now: float, *, by_itself: bool = True) -> None:
        """Note the end of the connection: requests in flight fail, others wait for a new one."""
        if by_itself and self.connection.fruitless and self.in_flight:
            hint = explain_end(self._scheme, error.errno)
            error.args = (f"{error.args[0]}; {hint}",) if hint else error.args
        try:
            self.connection.lost(error, now, by_itself=by_itself)
        finally:
            self._fail_all(error, now)
        if by_itself:  # else the next connection leads to the same device
            self.capacity.reset()
            self.limit = self.capacity.now
        # A connection that was given up as dead has taken its time, and the next one may be alive.
        if by_itself and self.connection.fruitless >= LOSSES_BEFORE_END:
            self.refuse(error)
        waiting, self._queue = self._queue, deque()
        for batch in waiting:
            batch.queued = False
            if not batch.is_done:
                self.add(batch, now)

    def closed(self, error: ModbusConnectionError, now: float) -> None:
        """Note that the client was closed: all batches fail, now and later."""
        try:
            self.connection.close()
        finally:
            self._fail_all(error, now)
            self.refuse(error)

    def interrupted(self, error: ModbusConnectionError, now: float) -> None:
        """Forget all batches, whose callers were interrupted, and give up the connection."""
        for pending in [*self._reset(now), *(pending for pending, _ in self._replies)]:
            self.statistics.note(pending.function, "cancelled")
        self._queue, self._repeats, self._replies = deque(), [], []
        self.capacity.forget()
        if self.connection.is_open:
            self.connection.lost(error, now, by_itself=False)
        elif self.connection.state is State.CONNECTING:
            self.connection.given_up()

    def _reset(self, now: float) -> list[Pending]:
        """Return the requests in flight, and reset the state of the previous connection."""
        pending = [*self._matching.reset(now), *(pending for _, pending in self._silent)]
        self.broken = None
        self.is_flooded = False
        self._silent = []
        self.in_flight = 0
        return pending

    def _break(self, reason: str) -> None:
        """Ask the driver to close the connection for a new one."""
        if self.broken is None:
            self.broken = ModbusConnectionError(reason)

    # --- failures -----------------------------------------------------------------------------

    def _fail_all(self, error: ModbusConnectionError, now: float) -> None:
        self._replies += [(pending, alike(error)) for pending in self._reset(now)]
        lost = self.capacity.forget()
        self.settle(now)
        self._fail_lost(lost, now)

    def refuse(self, error: ModbusError, later: Collection[Batch] = ()) -> None:
        """Fail all requests that wait, except those of some batches."""
        queue, self._queue = self._queue, deque()
        repeats, self._repeats = self._repeats, []
        lost, self.capacity.lost = self.capacity.lost, []
        repeats += [(0.0, pending.batch, pending.index) for pending, _ in lost]
        for repeat in repeats:
            _, batch, index = repeat
            if batch in later:
                self._repeats.append(repeat)
                continue
            self._fail_at(batch, index, error)
            self._refuse(batch, error)
        for batch in queue:
            if batch in later:
                self._queue.append(batch)
            else:
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
        batch.settle(index, self._outcome(alike(error), batch, index, sent))

    def _fail_next(self, batch: Batch, error: ModbusError) -> None:
        index = batch.started
        batch.started += 1
        self._fail_at(batch, index, error)

    def _outcome(self, error: ModbusError, batch: Batch, index: int, sent: bytes) -> BaseException:
        """Return an error with its request, or the exception that the request's class raised."""
        try:
            return self._completed(error, batch, index, sent)
        except BaseException as mistake:
            return mistake

    def _completed(
        self, error: ModbusError, batch: Batch, index: int | None, sent: bytes
    ) -> ModbusError:
        """Return an error with its request, and with a hint at its cause."""
        error.unit, error.endpoint, error.sent = batch.unit, self._place, sent
        if index is not None:
            request = batch.requests[index]
            error.function, error.asked = request.function, str(request)
        if (
            error.received
            and sent
            and isinstance(error, FrameError | ModbusTimeoutError | ModbusConnectionError)
        ):
            hint = explain(self._scheme, sent, error.received)
            error.args = (f"{error.args[0]}; {hint}",) if hint else error.args
        return error

    # --- replies ------------------------------------------------------------------------------

    def take(self, chunks: Iterable[bytes], now: float) -> bool:
        """
        Take received bytes; `settle` decodes the replies.

        Return True if requests wait to be sent. Call `start` before `settle` then, because some of
        them may be sent now, so that the server has work meanwhile.
        """
        matching = self._matching
        for data in chunks:
            replies = matching.take(data, now)
            if replies:
                self._note_ends(replies, now)
        if matching.alarm < self.alarm:
            self.alarm = matching.alarm
        if matching.unasked > MAX_UNASKED or not matching.is_in_step:
            self._note_flood()
        return self.is_wanted

    def _note_flood(self) -> None:
        self.is_flooded = self._matching.unasked > MAX_UNASKED
        if not self._matching.is_in_step:
            self._break("closed, because the received bytes cannot be understood")
        elif self._is_socket:
            self._break("flooded with frames that answer no request")

    def _note_ends(self, replies: Replies, now: float) -> None:
        """
        Free the slots of requests that were answered.

        A valid answer also frees the place in its batch. After any other reply, the outcome decides
        how the batch goes on.
        """
        if self.capacity.is_growing:
            self.capacity.note_replies(replies, self.in_flight, now)
            self.limit = self.capacity.now
        if self.capacity.silent:
            self.capacity.note_answers(replies)
        self.in_flight -= len(replies)
        self._replies += replies
        for pending, reply in replies:
            batch = pending.batch
            if batch.limit > 1 and _is_good(reply):
                batch.in_flight -= 1
                self._enqueue(batch)

    def settle(self, now: float) -> bool:
        """Decode the replies and settle their requests; return True if others wait to be sent."""
        replies, self._replies = self._replies, []
        for pending, reply in replies:
            batch = pending.batch
            if self.capacity.is_on_trial:
                self._end_trial(reply, now)
            if batch.limit == 1 or not _is_good(reply):
                batch.in_flight -= 1
                if batch.started < batch.end:
                    self._enqueue(batch)
            if batch.is_done:
                self.statistics.note(pending.function, "cancelled")
            else:
                self._settle(pending, reply, now)
        return self.is_wanted

    def _settle(self, pending: Pending, reply: Reply, now: float) -> None:
        batch, index = pending.batch, pending.index
        if isinstance(reply, ModbusError):
            self._fail(reply, pending, now)
        elif isinstance(reply, BaseException):
            self._blame_class(pending, reply)
        else:
            try:
                outcome = batch.requests[index].decode_response(reply)
            except ModbusError as error:
                self.statistics.invalid += isinstance(error, InvalidResponse)
                error.received = self._matching.received_with(pending, reply)
                self._fail(error, pending, now)
            except BaseException as error:
                self._blame_class(pending, error)
            else:
                self.note_answer(reply[0], "ok", now - pending.sent, now)
                batch.settle(index, outcome)
                if not self._has_ids:
                    self._matching.conclude(pending, None, now)
        if batch.is_done and batch.in_flight:
            self._let_go(batch, now)

    def _blame_class(self, pending: Pending, mistake: BaseException) -> None:
        """Settle a request with an exception of its class, which only its caller must get."""
        self.statistics.note(pending.function, "invalid")
        pending.batch.settle(pending.index, mistake)

    def note_answer(self, function: int, result: str, seconds: float, now: float) -> None:
        """Note a valid answer, perhaps an exception response: the connection works."""
        self.statistics.note_answer(function, result, seconds, now)
        if self.connection.fruitless:
            self.connection.prove()

    def _fail(self, error: ModbusError, pending: Pending, now: float) -> None:
        if isinstance(error, ExceptionResponse):
            self.statistics.exceptions += 1
            self.note_answer(pending.function, "exception", now - pending.sent, now)
        else:
            self.statistics.note(pending.function, result_of(error))
        self._matching.conclude(pending, error, now)
        self._go_on_without(error, pending, now, self._ask_again)

    def _go_on_without(
        self,
        error: ModbusError,
        pending: Pending,
        now: float,
        again: Callable[[ModbusError, Pending, float], bool],
    ) -> None:
        """Settle a request that failed, unless `again` sends it again."""
        batch, index = pending.batch, pending.index
        try:
            is_repeated = again(error, pending, now)
        except BaseException as mistake:  # of the class of the request
            batch.settle(index, mistake)
        else:
            if not is_repeated:
                batch.settle(index, self._outcome(error, batch, index, pending.adu))

    def _ask_again(self, error: ModbusError, pending: Pending, now: float) -> bool:
        """Send a request again that was lost beside others, or one that may be repeated."""
        if self.capacity.is_open and self.capacity.takes(error, pending):
            pending.batch.in_flight += 1
            return True
        return self._repeat(error, pending, now)

    def _repeat(self, error: ModbusError, pending: Pending, now: float) -> bool:
        """Send a request again later, if that is allowed; it keeps its place in its batch."""
        batch, index = pending.batch, pending.index
        is_busy = isinstance(error, BUSY)
        if not is_busy and (
            isinstance(error, ExceptionResponse) or not batch.requests[index].repeatable
        ):
            return False
        done = batch.repeated.get((index, is_busy), 0)
        if done >= (batch.timeouts.busy_retries if is_busy else batch.timeouts.retries):
            return False
        batch.repeated[index, is_busy] = done + 1
        batch.sent[index] = pending.adu
        batch.in_flight += 1
        if batch.in_flight >= batch.limit:
            self._leave_queue(batch)
        batch.since = now
        due = now + (min(1.0, 0.1 * 2**done) if is_busy else 0.0)
        self._repeats.append((due, batch, index))
        self._wake(due)
        return True

    def _let_go(self, batch: Batch, now: float) -> int:
        """Stop waiting for a batch; return the number of answers that it waited for."""
        self._repeats = [each for each in self._repeats if each[1] is not batch]
        self.capacity.drop(batch)
        for due, pending in self._silent:
            if pending.batch is batch:
                self._wake(due)  # its slot becomes free only then, because the line is in use
        withdrawn = self._matching.withdraw(batch, now)
        for pending in withdrawn:
            self.statistics.note(pending.function, "cancelled")
        self.in_flight -= len(withdrawn)
        return len(withdrawn)

    # --- time ---------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """End requests that are overdue; `settle` reports this to their callers."""
        matching = self._matching
        self.alarm = matching.alarm = math.inf
        self._end_silent(now)
        if self.connection.is_open:
            self._note_ends(matching.expire(now), now)
            self._wake(matching.alarm)
        else:
            self._end_waits(now)

    def _end_silent(self, now: float) -> None:
        over = [pending for due, pending in self._silent if due <= now]
        self._silent = [each for each in self._silent if each[0] > now]
        for pending in over:
            batch = pending.batch
            self.in_flight -= 1
            batch.in_flight -= 1
            self.statistics.note(pending.function, "silent")
            batch.settle(pending.index, None)
            self._enqueue(batch)
        for due, _ in self._silent:
            self._wake(due)

    def _end_waits(self, now: float) -> None:
        """Fail the batches that have waited too long for a connection."""
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
        if batch.wait_until > now:
            self._wake(batch.wait_until)
            return False
        self._refuse(batch, self.connection.not_in_time(batch.timeouts.timeout))
        return True


def _is_good(reply: Reply) -> bool:
    return isinstance(reply, bytes) and reply[0] < 0x80


def forbidden() -> ModbusConnectionError:
    """Return the error for requests that `may_send` does not allow."""
    return ModbusConnectionError("may_send allows no request now", errno=errno.EPERM)
