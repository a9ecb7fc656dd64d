"""
The driver of blocking clients: it waits, reads and sends for a connection, for any thread.

It deals with threads, forks, signals and the lock. The connection decides what is sent, and what
received bytes mean.
"""

from __future__ import annotations

import errno
import threading
import weakref
from typing import TYPE_CHECKING, Any

from ..ports.port import abandoned_in_children
from ..ports.waiting import READ, WRITE, WaitInterrupted, run
from ..protocol.errors import ModbusConnectionError
from .reconnecting import FORKED, State

if TYPE_CHECKING:
    from ..ports.port import Port
    from ..ports.waiting import Waker
    from .call import Batch, Call
    from .connection import Transactions

__all__ = ["BlockingDriver", "make_driver"]

# How long `close` waits for another thread to leave the connection.
LEAVING_S = 1.0

# Shorter waits are slept, because silences on a line are shorter than the milliseconds of poll().
SLEPT_S = 0.005


class BlockingDriver:
    """
    Runs the requests of one connection; several threads may call, one at a time is served.

    While a thread holds `lock`, only that thread can send. `waker` is how it waits.
    """

    def __init__(self, port: Port, connection: Transactions) -> None:
        self._port = port
        self._connection = connection
        self._life = connection.life
        self._notices = connection.notices
        self._queue = connection.queue
        try:
            self.waker: Waker = port.waker()
        except OSError as error:
            reason = f"cannot make a client of {connection.url}: {error.strerror}"
            raise ModbusConnectionError(reason, errno=error.errno) from error
        self._now = self.waker.now
        self._closed = False
        self._pauses: set[Waker] = set()
        self._start_anew()
        abandoned_in_children(self)
        weakref.finalize(self, port.shut)

    def _start_anew(self) -> None:
        # Reentrant, so that a signal handler that sends a request during another one gets an error
        # and does not wait forever.
        self.lock: threading.RLock = threading.RLock()
        self._is_busy = False
        self._is_left = False

    def now(self) -> float:
        """Return the time by which timeouts are measured."""
        return self._now()

    def wait_until(self, at: float) -> bool:
        """Wait until a time, while other threads may send; return False if `close` was called."""
        waker = self._port.waker()
        try:
            self._pauses.add(waker)  # before `_closed` is read: `close` sets it, then wakes
            return self._pause(waker, at)
        finally:
            self._pauses.discard(waker)
            waker.close()

    def _pause(self, waker: Waker, at: float) -> bool:
        while not self._closed and self._now() < at:
            try:
                waker.wait(-1, READ, at)
            except WaitInterrupted:
                waker.clear()
        return not self._closed

    def run(self, job: Call | Batch) -> Any:
        """
        Send requests; return their result when they are over, or raise it.

        An exception that is not the outcome of a request, such as a KeyboardInterrupt, gives up the
        connection and all requests on it, because it is unknown how much was done.

        Raises:
            RuntimeError: called from within a request of the same thread.
        """
        lock, connection = self.lock, self._connection
        with lock:
            if self._is_busy:
                raise RuntimeError(
                    "a request of this thread is in progress on the same connection; a signal "
                    "handler or a callback must not send another one"
                )
            if self._is_left:  # the end of an earlier request was interrupted
                self._interrupt()
            if self._closed and self._life.state is not State.CLOSED:
                self._shut()
            try:
                self._is_busy = self._is_left = True
                now = self._now()
                connection.submit(job, now)
                if not job.is_done:
                    self._turn(job, now)
                    if self._notices.waiting:
                        self._notices.give()
                    if not job.is_done:  # most requests are done after one turn
                        self._take_turns(job, lock)
                if self._port.resume_at is not None:
                    self._finish_sending()
                self._is_left = False
            except BaseException:
                self._interrupt()
                raise
            finally:
                self._is_busy = False
                if self._closed:
                    self._shut()
                if self._notices.waiting:
                    self._notices.give()
        return job.result()

    def change_timeout(self) -> None:
        """Apply changed `Timeouts` to a request that is under way, perhaps in another thread."""
        if self._is_busy:
            self.waker.wake()

    def close(self) -> None:
        """Close for good, from any thread or signal handler. Requests that wait fail at once."""
        self._closed = True
        self.waker.wake()
        for waker in tuple(self._pauses):
            waker.wake()
        if self.lock.acquire(timeout=LEAVING_S):
            try:
                if not self._is_busy:
                    self._shut()
                    self._notices.give()
            finally:
                self.lock.release()

    def abandon(self) -> None:
        """Forget the connection in a forked child: it belongs to the parent."""
        self._port.abandon()
        self.waker.renew()
        self._start_anew()
        self._connection.forked(self._now())
        if self._closed:
            self.waker.close()

    def _shut(self) -> None:
        self._port.shut()
        self._connection.closed(self._now())
        self.waker.close()

    def _interrupt(self) -> None:
        """Leave the connection, because it is unknown what was sent, and forget all requests."""
        self._port.close()
        error = ModbusConnectionError("interrupted", errno=errno.EINTR)
        self._connection.interrupted(error, self._now())
        self._is_left = False

    # --- the requests of one caller -----------------------------------------------------------

    def _take_turns(self, job: Call | Batch, lock: threading.RLock) -> None:
        """
        Take turns until the requests are over.

        A function of its own, as each loop here that Ctrl-C may end: CPython 3.13 leaves the jump
        at the end of a loop outside of the `try` and the `with` around it, so that the lock would
        stay held.
        """
        while not job.is_done:
            if lock is not self.lock:  # a callback or a signal handler forked
                raise ModbusConnectionError(FORKED, errno=errno.EBADF)
            self._turn(job, self._now())
            if self._notices.waiting:
                self._notices.give()

    def _turn(self, job: Call | Batch, now: float) -> None:
        """Send requests that may be sent, wait for bytes, and process them."""
        connection, port, queue = self._connection, self._port, self._queue
        try:
            if not self._life.is_open:
                self._connect()
                return
            if not connection.in_flight and port.has_input():
                self._look(now)
            while connection.start(now, port.send) and (queue.waiting or queue.again):
                pass
            if self._notices.waiting:
                self._notices.give()  # the sent frames are traced before the wait for answers
            if not (job.is_done or connection.broken):
                until = connection.matching.alarm
                if connection.in_flight and not port.has_unsent and port.resume_at is None:
                    is_ready = self.waker.is_ready(until - now)
                else:
                    is_ready = self._wait(now, until)
                now = self._now()
                if is_ready:
                    # Sent before the answers are decoded, so that the server has work meanwhile;
                    # sending also acknowledges received bytes.
                    is_wanted = connection.take(port.receive(), now)
                    is_sent = is_wanted and connection.start(now, port.send)
                    if connection.in_flight and not is_sent:
                        port.acknowledge()
                if port.has_unsent or (port.resume_at is not None and port.resume_at <= now):
                    port.go_on(now)
                if connection.matching.alarm <= now:
                    connection.tick(now)
                connection.settle(now)
        except ModbusConnectionError as error:
            self._lose(error, by_itself=True)
        except WaitInterrupted:  # by `close`, or because timeouts have changed
            self.waker.clear()  # before `_closed` is read: `close` sets it, then wakes
            if self._closed:
                self._shut()
            else:
                connection.matching.wake(self._now())
        if connection.broken is not None:
            self._lose(connection.broken, by_itself=False)

    def _look(self, now: float) -> None:
        """Read bytes that no request expects, or the end of the connection, before sending."""
        connection = self._connection
        while self._port.has_input() and not connection.broken:
            connection.take(self._port.receive(), now)
            if connection.is_flooded:
                self._port.discard_input()
                return

    def _wait(self, now: float, until: float) -> bool:
        """Wait for a time, to send the rest, or for bytes; return True if there are bytes."""
        port = self._port
        if port.resume_at is not None:
            until = min(until, port.resume_at)
        if not self._connection.in_flight and until - now < SLEPT_S:
            self.waker.sleep(max(0.0, until - now))
            return False
        if port.has_unsent:
            self.waker.wait(port.descriptor, READ | WRITE, until)
            return bool(port.has_input())
        return self.waker.is_ready(until - now)

    def _finish_sending(self) -> None:
        """Send the rest: an answer may come while RTS is set, as on a pseudo-terminal."""
        while (at := self._port.resume_at) is not None:
            self.waker.sleep(max(0.0, at - self._now()))
            self._port.go_on(self._now())

    def _lose(self, error: ModbusConnectionError, *, by_itself: bool) -> None:
        self._port.close()
        self._connection.lost(error, self._now(), by_itself=by_itself)

    def _connect(self) -> None:
        connection, life, now = self._connection, self._life, self._now()
        until = connection.begin_connecting(now)
        if until is None:
            if connection.matching.alarm > now:
                self.waker.wait(-1, READ, connection.matching.alarm)
            now = self._now()
            if connection.matching.alarm <= now:
                connection.tick(now)
            connection.settle(now)
            return
        self._notices.give()
        try:
            run(self._port.opening(until), self.waker)
        except ModbusConnectionError as error:
            connection.failed(error, self._now())
        else:
            self.waker.watch(self._port.descriptor)
            connection.opened(self._now())
        finally:
            if life.state is State.CONNECTING:
                self._port.close()
                life.given_up()


class ClosingDriver(BlockingDriver):
    """Closes a connection that has been idle for `idle_close`: in `wait_until`, before requests."""

    def wait_until(self, at: float) -> bool:
        while (until := self._connection.idle_until(self._now())) < at:
            if not super().wait_until(until):
                return False
            with self.lock:
                self._end_idle()
                self._notices.give()
        return super().wait_until(at)

    def run(self, job: Call | Batch) -> Any:
        with self.lock:
            if not self._is_busy:
                self._end_idle()
            return super().run(job)

    def _end_idle(self) -> None:
        self._connection.end_idle(self._now())
        if self._connection.broken is not None:
            self._lose(self._connection.broken, by_itself=False)


def make_driver(port: Port, connection: Transactions) -> BlockingDriver:
    """Return the driver of a connection."""
    return (BlockingDriver if connection.idle_close is None else ClosingDriver)(port, connection)
