"""
Many callers, one connection: who may send when, and who is told what.

No caller owns a task, a timer or the connection, only his place in the queue and his
future. Cancelling him takes these away, and that is all.
"""

from __future__ import annotations

import asyncio
import errno
import time
from collections import deque

from ..protocol.errors import (
    ExceptionResponse,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    alike,
)
from .connection import Connection, State
from .flight import Answer, Asked, Batch, Flight, Statistics
from .transport import Transport

__all__ = ["Channel"]


class Channel:
    """
    Sends requests as slots become free, in the order of their callers.

    Args:
        turnaround: seconds that a request takes which nobody answers.
        request_spacing: seconds between the starts of two requests, at least.
        connect_delay: seconds between connecting and the first request.
        timeouts_before_reconnect: in a row, for a connection to count as dead.
    """

    def __init__(
        self,
        transport: Transport,
        connection: Connection,
        flight: Flight,
        statistics: Statistics,
        *,
        timeout: float,
        turnaround: float,
        request_spacing: float,
        connect_delay: float,
        timeouts_before_reconnect: int,
    ) -> None:
        self.connection = connection
        self.flight = flight
        self.statistics = statistics
        self._transport = transport
        self._timeout = timeout
        self._turnaround = turnaround
        self._request_spacing = request_spacing
        self._connect_delay = connect_delay
        self._timeouts_before_reconnect = timeouts_before_reconnect
        self._loop: asyncio.AbstractEventLoop | None = None
        self._queue: deque[Batch] = deque()
        self._waiters: set[asyncio.Future[ModbusConnectionError | None]] = set()
        self._timeouts = 0
        self._next_start = 0.0
        self._wake: asyncio.TimerHandle | None = None
        self._expiry: asyncio.TimerHandle | None = None
        self._silence: asyncio.TimerHandle | None = None
        connection.opened, connection.failed = self._opened, self._fail_queue
        connection.readable = self._read

    # --- for callers ------------------------------------------------------------------

    async def run(self, batch: Batch) -> None:
        """
        Ask what the batch holds; returns when nothing of it is left to come.

        Raises:
            RuntimeError: the client belongs to another event loop.
        """
        loop = self._bind()
        batch.done = loop.create_future()
        if self.connection.state is State.CLOSED:
            self._fail_rest(batch, _closed())
            return
        batch.since = loop.time()
        self._enqueue(batch)
        self._pump()
        try:
            await batch.done
        finally:
            if not batch.is_settled:  # cancelled
                batch.stop()
                self.flight.abandon(batch, loop.time())
                self._listen()
                self._pump()

    async def connect(self) -> None:
        """Raises ModbusConnectionError, RuntimeError."""
        loop = self._bind()
        if self.connection.is_open:
            return
        if self.connection.state is State.CLOSED:
            raise _closed()
        refusal = self.connection.refusal(loop.time() + self._timeout)
        if refusal is not None:
            raise refusal
        waiter: asyncio.Future[ModbusConnectionError | None] = loop.create_future()
        self._waiters.add(waiter)
        self.connection.want(loop)
        try:
            async with asyncio.timeout(self._timeout):
                error = await waiter
        except TimeoutError:
            error = self.connection.not_in_time()
        finally:
            self._waiters.discard(waiter)
        if error is not None:
            raise error

    async def close(self) -> None:
        """Raises RuntimeError."""
        self._bind()
        attempt = self.connection.close()
        self._fail(self.flight.restart(self._now()), _closed())
        self._fail_queue(_closed())
        self._listen()
        for timer in (self._wake, self._expiry):
            if timer is not None:
                timer.cancel()
        if attempt is not None:
            await asyncio.wait([attempt])

    @property
    def timeout(self) -> float:
        return self._timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._timeout = self.flight.timeout = self.connection.timeout = value
        if self._expiry is not None:
            self._expiry.cancel()
            self._expiry = None
            self._watch()

    def _bind(self) -> asyncio.AbstractEventLoop:
        loop = asyncio.get_running_loop()
        if self._loop is None:
            self._loop = loop
        elif self._loop is not loop:
            raise RuntimeError("this client belongs to another event loop; make one for each loop")
        return loop

    def _now(self) -> float:
        assert self._loop is not None
        return self._loop.time()

    # --- sending ----------------------------------------------------------------------

    def _enqueue(self, batch: Batch) -> None:
        batch.queued = True
        self._queue.append(batch)

    def _pump(self) -> None:
        """Send what may be sent now, and see to it that the rest has its turn."""
        self._pump_half()
        self._pump_half(looked=True)

    def _pump_half(self, *, looked: bool = False) -> None:
        """
        The same for half of what may be in flight.

        Args:
            looked: whether all that has come was read.
        """
        queue, flight = self._queue, self.flight
        while queue and not queue[0].has_next:
            queue.popleft().queued = False
        if not queue or flight.room <= 0:
            return
        if not self.connection.is_open:
            self._seek_connection()
        elif flight.is_empty and not looked:
            self._read()  # bytes nobody asked for, or the end of the connection
        elif self._is_spent():
            if flight.is_empty:
                self._lose(ModbusConnectionError("given up for a new connection"), by_itself=False)
        elif (wait := self._time_to_start()) > 0:
            self._wait(wait)
        else:
            self._send()

    def _seek_connection(self) -> None:
        assert self._loop is not None
        refusal = self.connection.refusal(self._now() + self._timeout)
        if refusal is not None:
            self._fail_queue(refusal)
        else:
            self.connection.want(self._loop)
            self._watch()

    def _is_spent(self) -> bool:
        """Whether no request should go over this connection any more."""
        if self._timeouts >= self._timeouts_before_reconnect and self._transport.can_die_silently:
            return True
        return self.flight.is_empty and self.flight.is_torn

    def _time_to_start(self) -> float:
        ready_at = max(self._next_start, self.flight.ready_at)
        wait = ready_at - self._now() if ready_at else 0.0
        return max(wait, self._transport.time_to_silence())

    def _wait(self, seconds: float) -> None:
        assert self._loop is not None
        now = self._now()
        if self.flight.ready_at > now and (error := self.flight.hopeless(now)):
            self._fail_next(self._queue[0], error)
        if self._wake is not None:
            self._wake.cancel()
        self._wake = self._loop.call_later(seconds, self._pump)

    def _send(self) -> None:
        queue, flight = self._queue, self.flight
        now = self._now()
        room = 1 if self._request_spacing else min(flight.room, (flight.limit + 1) // 2)
        adus = []
        while queue and room:
            batch = queue.popleft()
            batch.queued = False
            while room and batch.in_flight < batch.limit and batch.has_next:
                adus.append(self._start(batch, now))
                room -= 1
                if queue:
                    break  # the others have their turn
            if batch.in_flight < batch.limit and batch.has_next:
                self._enqueue(batch)
        self.statistics.requests += len(adus)
        self._next_start = now + self._request_spacing if self._request_spacing else 0.0
        try:
            self._transport.send(adus)
        except ModbusConnectionError as error:
            self._lose(error)
            return
        self._watch()
        if self._request_spacing:
            self._pump_half(looked=True)

    def _start(self, batch: Batch, now: float) -> bytes:
        asked = self.flight.start(batch, now)
        batch.started += 1
        batch.in_flight += 1
        if batch.silent and asked.index in batch.silent:
            assert self._loop is not None
            self._loop.call_later(self._turnaround, self._end_silent, asked)
        return asked.adu

    def _end_silent(self, asked: Asked) -> None:
        if self.flight.end_silent(asked):
            self._release(asked.batch)
            asked.batch.settle(asked.index, None)
            self._pump()

    def _release(self, batch: Batch) -> None:
        """A request of the batch is no longer in flight: its next one may queue up."""
        batch.in_flight -= 1
        if not batch.queued and batch.has_next:
            self._enqueue(batch)

    # --- receiving --------------------------------------------------------------------

    def _read(self) -> None:
        try:
            chunks = self._transport.receive()
        except ModbusConnectionError as error:
            self._lose(error)
            return
        answers = []
        for data in chunks:
            answers += self.flight.take(data, self._now())
        self._deliver(answers)
        self._listen()
        if not self.flight.in_step:
            self._lose(ModbusConnectionError("closed, for what came cannot be understood"))

    def _deliver(self, answers: list[Answer]) -> None:
        for asked, found in answers:
            self._release(asked.batch)
            if isinstance(found, bytes):
                self._timeouts = 0
        # Half of the next go out before these are decoded, so that the server has work
        # meanwhile; unless the next request depends on what became of this one.
        if self.flight.limit > 1 and self.flight.in_step:
            self._pump_half(looked=True)
        before = self.statistics.responses
        for asked, found in answers:
            self._settle(asked, found)
        if self.statistics.responses > before:
            self.connection.prove()
            self.statistics.last_success = time.monotonic()
        if self.flight.in_step:
            self._pump_half(looked=True)

    def _settle(self, asked: Asked, found: bytes | ModbusError) -> None:
        batch, index = asked.batch, asked.index
        if isinstance(found, bytes):
            try:
                outcome = batch.requests[index].decode_response(found)
                self.statistics.responses += 1
            except ModbusError as error:
                self.statistics.invalid += isinstance(error, InvalidResponse)
                error.received = self.flight.received(asked, found)
                outcome = self._complete(error, batch, index, asked.adu)
            except Exception as error:  # a mistake in a request class is its caller's
                outcome = error
        else:
            outcome = self._complete(found, batch, index, asked.adu)
        batch.settle(index, outcome)

    def _complete(self, error: ModbusError, batch: Batch, index: int, sent: bytes) -> ModbusError:
        """Tell the error what was asked, and remember what it means for the next request."""
        request = batch.requests[index]
        error.unit, error.function, error.asked = batch.unit, request.function, str(request)
        error.sent = sent
        if isinstance(error, ExceptionResponse):
            self.statistics.responses += 1
            self.statistics.exceptions += 1
        elif sent:
            self.flight.doubt(self._now())
        return error

    def _listen(self) -> None:
        """Have silence noticed, where it means something."""
        if self._silence is not None:
            self._silence.cancel()
            self._silence = None
        quiet = self.flight.quiet
        if quiet is not None:
            assert self._loop is not None
            self._silence = self._loop.call_later(quiet, self._fall_silent)

    def _fall_silent(self) -> None:
        self._silence = None
        self._deliver(self.flight.fall_silent())

    # --- failing ----------------------------------------------------------------------

    def _watch(self) -> None:
        """See to it that somebody looks when the first one has waited for too long."""
        if self._expiry is not None:
            return
        if self.connection.is_open:
            due = self.flight.next_due()
        else:
            due = self._queue[0].since + self._timeout if self._queue else None
        if due is not None:
            assert self._loop is not None
            self._expiry = self._loop.call_at(due, self._expire)

    def _expire(self) -> None:
        self._expiry = None
        now = self._now()
        if self.connection.is_open:
            overdue = self.flight.overdue(now)
            self.statistics.timeouts += len(overdue)
            self._timeouts += len(overdue)
            for asked, error in overdue:
                self._release(asked.batch)
                self._settle(asked, error)
        else:
            while self._queue and self._queue[0].since + self._timeout <= now:
                self._fail_rest(self._queue.popleft(), self.connection.not_in_time())
        self._watch()
        self._listen()
        self._pump()

    def _lose(self, error: ModbusConnectionError, *, by_itself: bool = True) -> None:
        now = self._now()
        asked = self.flight.restart(now)
        self.connection.lose(error, by_itself=by_itself)
        self._fail(asked, error)
        for batch in self._queue:
            batch.since = now
        self._listen()
        self._pump()

    def _fail(self, asked: list[Asked], error: ModbusConnectionError) -> None:
        for each in asked:
            self._release(each.batch)
            self._settle(each, alike(error))

    def _fail_rest(self, batch: Batch, error: ModbusError) -> None:
        batch.queued = False
        while batch.has_next:
            self._fail_next(batch, error)

    def _fail_next(self, batch: Batch, error: ModbusError) -> None:
        index = batch.started
        batch.started += 1
        batch.settle(index, self._complete(alike(error), batch, index, b""))

    def _fail_queue(self, error: ModbusConnectionError) -> None:
        """Nobody who waits for the connection gets it."""
        queue, self._queue = self._queue, deque()
        for batch in queue:
            self._fail_rest(batch, error)
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(alike(error))

    def _opened(self) -> None:
        self._timeouts = 0
        if self._connect_delay:
            self._next_start = self._now() + self._connect_delay
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)
        self._pump()


def _closed() -> ModbusConnectionError:
    return ModbusConnectionError("this client is closed", errno=errno.EBADF)
