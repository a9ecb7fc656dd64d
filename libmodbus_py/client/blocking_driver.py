"""
The driver of blocking clients: it waits, reads and sends for a conversation.

It deals with threads, forks, signals and the lock. The conversation decides what is sent, and what
received bytes mean; `shortcut` carries out single requests without the conversation.
"""

from __future__ import annotations

import errno
import threading
import weakref
from collections.abc import Callable
from functools import update_wrapper
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple

from ..ports.forking import abandoned_in_children
from ..ports.waiting import READ, WRITE, Woken, run
from ..protocol.errors import ModbusConnectionError
from ..protocol.pdu import Request
from .batch import Batch, encoded
from .plain_answers import KNOWN
from .reconnecting import FORKED, State
from .shortcut import Shortcut

if TYPE_CHECKING:
    from ..ports.waiting import Waker
    from .options import Parts
    from .timeouts import Timeouts

__all__ = ["BlockingDriver"]

# How long `close` waits for another thread to leave a connection that it was told to leave.
LEAVING = 1.0

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")

# Shorter waits are slept, because silences on a line are shorter than the milliseconds of poll().
SLEPT = 0.005


def _alone(
    carry: Callable[[BlockingDriver, threading.RLock, *Arguments], Result],
) -> Callable[[BlockingDriver, *Arguments], Result]:
    """
    Decorate a method so that it runs while no other request is under way.

    The method returns outcomes. If it raises an exception, it is unknown how far it got: the
    connection is given up, and everything that was to be sent is dropped.

    The method raises RuntimeError when it is called from within a request of the same thread.
    """

    def method(self: BlockingDriver, /, *arguments: *Arguments) -> Result:
        lock = self._lock
        with lock:
            if self._is_busy:
                raise RuntimeError(
                    "a request of this thread is in progress on the same connection; a signal "
                    "handler or a callback must not send another one"
                )
            if self._is_left or self._closed:
                self._tidy()
            # From here to the end, nothing may be left undone by a Ctrl-C.
            try:
                self._is_busy = self._is_left = True
                outcome = carry(self, lock, *arguments)
                self._is_left = False
                return outcome
            except BaseException:
                self._interrupt()
                raise
            finally:
                self._is_busy = False
                if self._closed:
                    self._shut()
                if self._notices.waiting:
                    self._notices.give()

    return update_wrapper(method, carry)


class BlockingDriver:
    """
    Runs the batches of one connection, one at a time, for any thread.

    Args:
        parts: the parts of the client.
        native: True if C may carry out requests for which the shortcut is allowed.
        is_short: True if the shortcut is allowed for any request.

    Attributes:
        waker: waits, on the clock of the port.
    """

    def __init__(self, parts: Parts, native: bool, is_short: bool) -> None:
        self._port = parts.port
        self._conversation = parts.conversation
        self._connection = parts.connection
        self._notices = parts.notices
        self.waker = _waker(parts)
        self._now = self.waker.now
        self._shortcut = Shortcut(parts, native, self.waker) if is_short else None
        self._closed = False
        self._pauses: set[Waker] = set()
        self._start_anew()
        abandoned_in_children(self)
        weakref.finalize(self, parts.port.close)

    def _start_anew(self) -> None:
        # Reentrant, so that a signal handler that sends a request during another one gets an error
        # and does not wait forever.
        self._lock = threading.RLock()
        self._is_busy = False
        self._is_left = False

    def now(self) -> float:
        """Return the time by which timeouts are measured."""
        return self._now()

    def wait_until(self, at: float) -> bool:
        """
        Wait until a time; other threads may send requests. Return False if `close` was called.

        Raises:
            OSError: the process has no descriptor left.
        """
        waker = self._port.waker()
        try:
            self._pauses.add(waker)  # before `_closed` is read: `close` sets it, then wakes
            while not self._closed and self._now() < at:
                try:
                    waker.wait(-1, READ, at)
                except Woken:
                    waker.clear()
            return not self._closed
        finally:
            self._pauses.discard(waker)
            waker.close()

    @property
    def lock(self) -> threading.RLock:
        """The lock of the connection: while a thread holds it, only that thread can send."""
        return self._lock

    @property
    def closed(self) -> bool:
        """True once `close` was called."""
        return self._closed

    @_alone
    def run(self, lock: threading.RLock, batch: Batch) -> None:
        """Send the requests of a batch; returns when it is settled."""
        self._conversation.add(batch, self._now())
        self._drive(batch, lock)

    def ask(self, unit: int, request: Request[Any], timeouts: Timeouts, is_broadcast: bool) -> Any:
        """
        Send a single request, with the shortcut if that is allowed, and return its result.

        Raises:
            ModbusError: the outcome of the request.
            TypeError, ValueError: nothing was sent.
        """
        pdu = encoded(request, "request", 0, is_broadcast)
        if self._shortcut is None or is_broadcast or pdu[:1] not in KNOWN:
            is_known = False
        else:
            is_known = request.expects_response
        if is_known:
            outcome = self._ask_shortly(unit, request, pdu, timeouts)
        else:
            batch = Batch(unit, [request], timeouts, is_broadcast=is_broadcast, pdus=[pdu])
            self.run(batch)
            outcome = batch.outcomes[0]
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    @_alone
    def _ask_shortly(
        self,
        lock: threading.RLock,
        unit: int,
        request: Request[Any],
        pdu: bytes,
        timeouts: Timeouts,
    ) -> Any:
        """Return the outcome of a request, with the shortcut if that is possible now."""
        if self._shortcut is not None and self._conversation.is_plain:
            batch, outcome = self._shortcut.ask(unit, request, pdu, timeouts, self.waker.descriptor)
            if batch is None:
                return outcome
            if outcome is not None:
                self._lose(outcome, by_itself=True)
        else:
            batch = Batch(unit, [request], timeouts, pdus=[pdu])
            self._conversation.add(batch, self._now())
        self._drive(batch, lock)
        return batch.outcomes[0]

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
        if self._lock.acquire(timeout=LEAVING):
            try:
                if not self._is_busy:
                    self._shut()
                    self._notices.give()
            finally:
                self._lock.release()

    def abandon(self) -> None:
        """Forget the connection in a forked child: it belongs to the parent."""
        self._port.abandon()
        self.waker.renew()
        self._start_anew()
        gone = ModbusConnectionError(FORKED, errno=errno.EBADF)
        self._conversation.interrupted(gone, self._now())
        if self._closed:
            self.waker.close()

    def _shut(self) -> None:
        self._port.close()
        closed = ModbusConnectionError("this client is closed", errno=errno.EBADF)
        self._conversation.closed(closed, self._now())
        self.waker.close()

    # --- one batch ------------------------------------------------------------------------

    def _drive(self, batch: Batch, lock: threading.RLock) -> None:
        try:
            while not batch.is_done:
                if lock is not self._lock:  # a callback or a signal handler forked
                    raise ModbusConnectionError(FORKED, errno=errno.EBADF, unit=batch.unit)
                try:
                    self._step(batch)
                except Woken:
                    self._wake()
                self._notices.give()
            self._turn_line()
        except Woken:
            self._shut()

    def _wake(self) -> None:
        """
        Go on after a wait that was ended because timeouts have changed.

        Raises:
            Woken: the wait was ended by `close`.
        """
        self.waker.clear()  # before `_closed` is read: `close` sets it, then wakes
        if self._closed:
            raise Woken
        self._conversation.change_timeout(self._now())

    def _tidy(self) -> None:
        """Finish what remains of an earlier request, if the end of that was interrupted."""
        if self._is_left:
            self._interrupt()
        if self._closed and self._connection.state is not State.CLOSED:
            self._shut()

    def _interrupt(self) -> None:
        """Leave the connection, because it is unknown what was sent, and forget all requests."""
        self._port.close()
        if self._shortcut is not None:
            self._shortcut.interrupt()
        interrupted = ModbusConnectionError("interrupted", errno=errno.EINTR)
        self._conversation.interrupted(interrupted, self._now())
        self._is_left = False

    def _step(self, batch: Batch) -> None:
        """Connect; or send requests that may be sent, wait for bytes, and process them."""
        conversation = self._conversation
        now = self._now()
        if not self._connection.is_open:
            self._connect(batch, now)
            return
        try:
            if not conversation.in_flight and self._port.has_input():
                self._look(now)
            self._send(now)
            if conversation.is_wanted:
                self._send(now)
            if self._notices.waiting:
                self._notices.give()  # the sent frames are traced before the wait for answers
            if not (batch.is_done or conversation.broken):
                self._wait(now)
        except ModbusConnectionError as error:
            self._lose(error, by_itself=True)
        if conversation.broken is not None:
            self._lose(conversation.broken, by_itself=False)

    def _turn_line(self) -> None:
        """Finish sending, because an answer may come while RTS is set, as on a pseudo-terminal."""
        while self._port.resume_at is not None:
            now = self._now()
            self.waker.sleep(max(0.0, self._port.resume_at - now))
            self._port.go_on(self._now())

    def _send(self, now: float) -> None:
        if adus := self._conversation.start(now):
            self._port.send(adus, now)

    def _look(self, now: float) -> None:
        """Read bytes that no request expects, or the end of the connection, before sending."""
        conversation = self._conversation
        while self._port.has_input() and not conversation.broken:
            conversation.take(self._port.receive(), now)
            if conversation.is_flooded:
                self._port.discard_input()
                return

    def _wait(self, now: float) -> None:
        conversation, port = self._conversation, self._port
        until = conversation.alarm
        if port.resume_at is not None:
            until = min(until, port.resume_at)
        if not conversation.in_flight and until - now < SLEPT:
            self.waker.sleep(max(0.0, until - now))
        elif port.has_unsent:
            self.waker.wait(port.descriptor, READ | WRITE, until)
            if port.has_input():
                self._receive()
        elif self.waker.is_ready(until - now):
            self._receive()
        now = self._now()
        if port.has_unsent or (port.resume_at is not None and port.resume_at <= now):
            port.go_on(now)
        if conversation.alarm <= now:
            conversation.tick(now)
        conversation.settle(now)

    def _receive(self) -> None:
        conversation, port = self._conversation, self._port
        now = self._now()
        # Sent before the replies are decoded, so that the server has work meanwhile.
        adus = conversation.start(now) if conversation.take(port.receive(), now) else []
        if adus:  # sending also acknowledges received bytes
            port.send(adus, now)
        elif conversation.in_flight:
            port.acknowledge()

    def _lose(self, error: ModbusConnectionError, *, by_itself: bool) -> None:
        self._port.close()
        self._conversation.lost(error, self._now(), by_itself=by_itself)

    # --- connecting -------------------------------------------------------------------------

    def _connect(self, batch: Batch, now: float) -> None:
        deadline = batch.wait_until
        refusal = self._connection.refusal(now, deadline)
        if refusal is not None:
            self._conversation.refuse(refusal)
            return
        if self._connection.next_attempt > now:
            self.waker.wait(-1, READ, self._connection.next_attempt)
        self._connection.connecting()
        self._notices.give()
        try:
            run(self._port.opening(deadline), self.waker)
        except ModbusConnectionError as error:
            self._conversation.failed(error, self._now())
        else:
            self.waker.watch(self._port.descriptor)
            self._conversation.opened(self._now())
        finally:
            if self._connection.state is State.CONNECTING:
                self._port.close()
                self._connection.given_up()


def _waker(parts: Parts) -> Waker:
    try:
        return parts.port.waker()
    except OSError as error:
        raise ModbusConnectionError(
            f"cannot make a client of {parts.endpoint}: {error.strerror}", errno=error.errno
        ) from error
