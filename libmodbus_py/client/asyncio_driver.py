"""
The driver of asyncio clients: one reader and one timer for a connection.

A caller owns neither a task, a timer nor the connection, but only its call or batch, and a
`TaskCaller`. Cancelling the caller removes only these two.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import warnings
from collections import deque
from collections.abc import Callable
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Any

from ..ports.port import abandoned_in_children
from ..ports.waiting import Alarm, run_async
from ..protocol.checks import finished, log_failure
from ..protocol.errors import ModbusConnectionError
from .call import Batch, Call
from .connection import Transactions
from .reconnecting import State
from .task_caller import TaskCaller

if TYPE_CHECKING:
    from ..ports.port import Port

__all__ = ["AsyncioDriver"]


class AsyncioDriver:
    """Runs the requests of one connection in an event loop."""

    def __init__(self, port: Port, connection: Transactions) -> None:
        self._port = port
        self._connection = connection
        self._life = connection.life
        self._notices = connection.notices
        self._queue = connection.queue
        self._matching = connection.matching
        # What callers wait for, each with the function that tells its caller.
        self._callers: dict[Call | Batch, Callable[[], object]] = {}
        self._begin_anew()
        abandoned_in_children(self)

    def _begin_anew(self) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        # Held by a task that reads, changes and writes registers.
        self.lock: asyncio.Lock = asyncio.Lock()
        self._now: Callable[[], float] = monotonic  # the clock of the loop, once there is one
        self._attempt: asyncio.Task[None] | None = None
        self._attempt_until = 0.0
        self._alarm = Alarm(partial(self._enter, self._ring))
        self._is_writing = False
        self._is_reading = False
        self._is_due = False
        self._is_inside = False
        self._is_telling = False
        # Calls that have ended, of which the caller does not know yet.
        self._ended: deque[Call | Batch] = deque()
        self._closed = asyncio.Event()

    def now(self) -> float:
        """Return the time of the event loop, by which timeouts are measured."""
        return self._bind().time()

    async def wait_until(self, at: float) -> bool:
        """Wait until a time of the event loop; return False if `close` was called."""
        loop = self._bind()
        if at > loop.time():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(at):
                    await self._closed.wait()
        return self._life.state is not State.CLOSED

    def run(self, job: Call | Batch) -> TaskCaller:
        """Send requests; the caller must await the returned object at once, for their result."""
        loop = asyncio.get_running_loop()
        if loop is not self._loop:
            self._bind()
        caller = TaskCaller(loop, job, self.withdraw)
        self._submit(job, caller.go_on)
        return caller

    def ask(self, job: Call | Batch, caller: Callable[[], object]) -> None:
        """
        Send requests; once they are over, perhaps before this method returns, call a function.

        What it raises is logged.
        """
        self._bind()
        self._submit(job, caller)

    def _submit(self, job: Call | Batch, caller: Callable[[], object]) -> None:
        self._callers[job] = caller
        job.on_end(self._ended.append)
        try:
            self._enter(self._add, job)
        except BaseException:
            self._callers.pop(job, None)
            raise

    def _add(self, job: Call | Batch) -> None:
        connection, now = self._connection, self._now()
        connection.submit(job, now)
        if not connection.in_flight:
            self._turn(now)
        else:  # requests of this turn of the loop are sent together
            self._turn_soon()

    def _turn_soon(self) -> None:
        """Take one turn for all calls submitted and withdrawn in this turn of the loop."""
        if not self._is_due:
            self._is_due = True
            self._bound.call_soon(self._enter, self._turn)

    def withdraw(self, job: Call | Batch) -> None:
        """Drop requests; their outcome is not reported to their caller."""
        self._callers.pop(job, None)
        if not job.is_done:
            self._enter(self._abandon, job)

    def _abandon(self, job: Call | Batch) -> None:
        self._connection.withdraw(job, self._now())
        self._turn_soon()

    async def close(self) -> None:
        self._bind()
        self._enter(self._close)
        if self._attempt is not None:
            self._attempt.cancel()
            await asyncio.wait([self._attempt])
        self._port.shut()

    def forget(self) -> None:
        """Close the port after the last handle was garbage collected."""
        if self._life.state not in (State.CONNECTING, State.CONNECTED):
            # No other cleaning: libmodbus's context of a serial port may be freed by now.
            self._in_loop(self._alarm.cancel)
            return
        try:
            message = f"AsyncClient({self._connection.url!r}) was not closed"
            warnings.warn(message, ResourceWarning, stacklevel=2)
        finally:
            self._in_loop(self._forget)

    def _in_loop(self, call: Callable[[], None]) -> None:
        # In the event loop, because garbage may be collected in another thread. If the loop does
        # not run, no user function is called: a finalizer may run anywhere.
        if self._loop is not None and self._loop.is_running():
            with contextlib.suppress(RuntimeError):  # it was just closed
                self._loop.call_soon_threadsafe(self._enter, call)
                return
        call()

    def _close(self) -> None:
        self._close_port()
        self._connection.closed(self._now())
        self._alarm.cancel()
        self._closed.set()

    def _forget(self) -> None:
        if self._attempt is not None and self._loop is not None and not self._loop.is_closed():
            self._attempt.cancel()
        self._close_port()
        if self._attempt is None:
            self._port.shut()
        self._life.close()
        self._alarm.cancel()

    def abandon(self) -> None:
        """Forget the connection and the loop in a forked child, which may use another loop."""
        # Nothing is removed from the epoll of the parent's loop, which the child shares.
        self._port.abandon()
        self._callers.clear()
        self._begin_anew()
        self._connection.forked(self._now())

    def change_timeout(self) -> None:
        """Note that some `Timeouts` were changed."""
        if self._loop is not None and not self._loop.is_closed():
            self._matching.wake(self._now())
            self._set_timer()

    def _bind(self) -> asyncio.AbstractEventLoop:
        loop = asyncio.get_running_loop()
        if self._loop is None:
            self._loop = loop
            # What most loops read, without a call of Python for it; tests may replace the method.
            usual = asyncio.BaseEventLoop.time
            self._now = monotonic if getattr(loop.time, "__func__", None) is usual else loop.time
        elif self._loop is not loop:
            raise RuntimeError("this client belongs to another event loop; make one for each loop")
        return loop

    @property
    def _bound(self) -> asyncio.AbstractEventLoop:
        assert self._loop is not None
        return self._loop

    # --- entry --------------------------------------------------------------------------------

    def _enter(self, act: Callable[..., object], subject: Any = None) -> None:
        """
        Change the state, then report the change. Every change of the state is made through this,
        by a method without an argument, or with the subject.

        If an action raises an exception, it is unknown how much of its work was done. Then the
        connection is given up, and all calls end, so that no caller waits forever.
        """
        if self._is_inside:  # called by user code, such as the class of a request
            self._bound.call_soon(self._enter, act, subject)
            return
        self._is_inside = True
        try:
            if subject is None:
                act()
            else:
                act(subject)
        except BaseException as error:
            self._interrupt(error)
            raise
        finally:
            self._is_inside = False
            if self._ended or self._notices.waiting:
                self._tell()

    def _interrupt(self, cause: BaseException) -> None:
        """Leave the connection, because it is unknown how much was sent, and end all calls."""
        error = ModbusConnectionError(f"interrupted: {cause!r}", errno=errno.EINTR)
        error.__cause__ = cause
        if self._attempt is None:
            self._close_port()
        else:
            self._attempt.cancel()
        self._connection.interrupted(error, self._now())
        for job in list(self._callers):
            job.settle(error)
        self._ended.extend(self._callers)  # also calls that had ended when the exception came

    def _tell(self) -> None:
        """Call user functions, and let tasks go on, now that the state is consistent."""
        if self._is_telling:  # a user function uses the client; the others are called after it
            return
        self._is_telling = True
        try:
            while self._notices.waiting or self._ended:
                if self._notices.waiting:
                    self._notices.give()
                    continue
                caller = self._callers.pop(self._ended.popleft(), None)
                if caller is None:  # the caller was cancelled, or has its outcome
                    continue
                try:
                    if (result := caller()) is not None:
                        finished("on_done", result)
                except Exception:
                    log_failure(__name__, "on_done failed")
        except BaseException:
            self._bound.call_soon(self._tell)
            raise
        finally:
            self._is_telling = False

    # --- turns ------------------------------------------------------------------------------

    def _turn(self, now: float | None = None) -> None:
        """Send what may be sent now, and set the timer for the rest."""
        self._is_due = False
        connection = self._connection
        if now is None:
            now = self._now()
        if self._attempt is not None and self._attempt.done():
            self._end_attempt(self._attempt)
        if not self._life.is_open:
            if self._attempt is None and (until := connection.begin_connecting(now)) is not None:
                self._connect(until)
        else:
            if not connection.in_flight and self._port.has_input():
                self._read()
            queue = self._queue
            while self._send(now) and (queue.waiting or queue.again):
                pass
        if connection.broken is not None:
            self._lose(connection.broken, by_itself=False)
        if self._matching.alarm < self._alarm.at:
            self._set_timer()

    def _send(self, now: float) -> bool:
        """Send what may be sent now; return True if that was anything."""
        port = self._port
        try:
            if not self._connection.start(now, port.send):
                return False
            if port.has_unsent or self._is_writing:
                self._follow_port()
            if port.resume_at is not None:
                self._set_timer()
            if not self._is_reading:
                self._read_on()
        except ModbusConnectionError as error:
            self._lose(error)
            return False
        return True

    def _set_timer(self) -> None:
        at = self._matching.alarm
        if self._port.resume_at is not None:
            at = min(at, self._port.resume_at)
        if at < self._alarm.at and self._life.state is not State.CLOSED:
            self._alarm.set(at, self._bound)

    def _ring(self, now: float) -> None:
        """Process timeouts and pauses of the port that are over."""
        if self._port.resume_at is not None:
            if self._port.resume_at <= now:
                self._go_on()
            else:
                self._set_timer()
        self._connection.tick(now)
        self._connection.settle(now)
        self._turn(now)

    # --- reading and writing ------------------------------------------------------------------

    def _readable(self) -> None:
        self._read()
        queue = self._queue
        if queue.waiting or queue.again or self._connection.broken is not None:
            self._turn()
        elif self._matching.alarm < self._alarm.at:
            self._set_timer()

    def _read(self) -> None:
        """Take the received bytes, and send what may be sent now."""
        connection, port, now = self._connection, self._port, self._now()
        try:
            is_wanted = connection.take(port.receive(), now)
        except ModbusConnectionError as error:
            self._lose(error)
            return
        if is_wanted and self._send(now):
            pass  # sending also acknowledges received bytes
        elif connection.in_flight:
            port.acknowledge()
        elif connection.is_flooded:
            # Until the next request: a flood must not keep an idle client busy.
            self._is_reading = False
            self._bound.remove_reader(port.descriptor)
            port.discard_input()
        connection.settle(now)

    def _read_on(self) -> None:
        self._is_reading = True
        self._watch(self._bound.add_reader, self._readable)

    def _watch(self, add: Callable[..., None], call: Callable[[], None]) -> None:
        """Register a callback; raise ModbusConnectionError if the system cannot watch more."""
        try:
            add(self._port.descriptor, self._enter, call)
        except OSError as error:
            reason = f"cannot wait for {self._connection.url}: {error.strerror}"
            raise ModbusConnectionError(reason, errno=error.errno) from error

    def _follow_port(self) -> None:
        """Continue to send when the port takes bytes again."""
        if self._port.has_unsent != self._is_writing:
            self._is_writing = self._port.has_unsent
            if self._is_writing:
                self._watch(self._bound.add_writer, self._go_on)
            else:
                self._bound.remove_writer(self._port.descriptor)

    def _go_on(self) -> None:
        if (forbidden := self._connection.forbidden()) is not None:
            self._lose(forbidden, by_itself=False)  # drops the bytes that were not sent yet
            return
        try:
            self._port.go_on(self._now())
            self._follow_port()
            self._set_timer()
        except ModbusConnectionError as error:
            self._lose(error)
            self._turn()

    def _lose(self, error: ModbusConnectionError, *, by_itself: bool = True) -> None:
        self._close_port()
        self._connection.lost(error, self._now(), by_itself=by_itself)
        self._turn()

    def _close_port(self) -> None:
        is_watched = self._loop is not None and not self._loop.is_closed()
        if self._port.descriptor >= 0 and is_watched:
            self._bound.remove_reader(self._port.descriptor)
            self._bound.remove_writer(self._port.descriptor)
        self._is_writing = self._is_reading = False
        self._port.close()

    # --- connecting ---------------------------------------------------------------------------

    def _connect(self, until: float) -> None:
        self._attempt_until = until
        opening = self._port.opening(until)
        self._attempt = self._bound.create_task(run_async(opening))
        # Not in the task itself, because a task that is cancelled early never begins.
        self._attempt.add_done_callback(partial(self._enter, self._end_attempt))

    def _end_attempt(self, attempt: asyncio.Task[None]) -> None:
        if attempt is not self._attempt:  # its end was noted before this callback was called
            return
        self._attempt = None
        connection, life = self._connection, self._life
        failure = None if attempt.cancelled() else attempt.exception()
        if attempt.cancelled() or life.state is State.CLOSED:
            failure = asyncio.CancelledError()
        try:
            if failure is None:
                self._read_on()
        except ModbusConnectionError as unwatched:
            failure = unwatched
        if failure is None:
            connection.opened(self._now())
            self._turn()
            return
        self._close_port()
        if isinstance(failure, ModbusConnectionError):
            connection.failed(failure, self._now(), self._attempt_until)
        elif life.state is State.CONNECTING:
            error = ModbusConnectionError(f"connecting was interrupted: {failure!r}")
            error.__cause__ = failure
            life.given_up()
            connection.refuse(error)
        if connection.is_wanted:  # by callers that have more time, or came after it was cancelled
            self._turn()
        else:  # all callers have their outcome, and nothing is in flight
            self._alarm.cancel()
