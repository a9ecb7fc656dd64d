"""
The life of a connection: opened when somebody wants it, lost, opened again.
"""

from __future__ import annotations

import asyncio
import enum
import errno
import logging
import random
from collections.abc import Callable

from ..protocol.errors import ModbusConnectionError, ModbusError
from .flight import Statistics
from .transport import Transport

__all__ = ["Connection", "State"]

logger = logging.getLogger(__name__)

FIRST_PAUSE = 0.1
LONGEST_PAUSE = 30.0


class State(enum.Enum):
    """Where the connection of an `AsyncClient` stands."""

    DISCONNECTED = "disconnected"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    CLOSED = "closed"


class Connection:
    """
    Opens a transport when it is wanted, once for all who want it.

    After an attempt that failed, or a connection that ended before it was any good,
    the next attempt waits: 0.1 s, doubled each time up to 30 s, and up to a fifth less
    at random, for a hundred clients should not come back at once.

    Args:
        timeout: seconds for one attempt.
        on_state: told of every change of `state`.

    Attributes:
        opened, failed, readable: what to call; set by the owner.
    """

    opened: Callable[[], None]
    failed: Callable[[ModbusConnectionError], None]
    readable: Callable[[], None]

    def __init__(
        self,
        transport: Transport,
        timeout: float,
        statistics: Statistics,
        on_state: Callable[[State, ModbusError | None], object] | None,
    ) -> None:
        self.state = State.DISCONNECTED
        self.timeout = timeout
        self._transport = transport
        self._statistics = statistics
        self._on_state = on_state
        self._attempt: asyncio.Task[None] | None = None
        self._retry: asyncio.TimerHandle | None = None
        self._fruitless = 0
        self._next_attempt = 0.0
        self._last_failure: ModbusConnectionError | None = None

    @property
    def is_open(self) -> bool:
        return self.state is State.CONNECTED

    def want(self, loop: asyncio.AbstractEventLoop) -> None:
        """Have it opened, now or when the next attempt is due."""
        self._loop = loop
        if self.state is not State.DISCONNECTED or self._retry is not None:
            return
        if self._next_attempt > loop.time():
            self._retry = loop.call_at(self._next_attempt, self._start)
        else:
            self._start()

    def refusal(self, deadline: float) -> ModbusConnectionError | None:
        """Say why there will be no connection before the deadline, if that is known."""
        last = self._last_failure
        if self.state is not State.DISCONNECTED or last is None or self._next_attempt <= deadline:
            return None
        wait = self._next_attempt - self._loop.time()
        return _because_of(last, f"{last.args[0]}; next attempt in {wait:.1f} s")

    def not_in_time(self) -> ModbusConnectionError:
        """Tell somebody who has waited for too long, with what is known of the reason."""
        reason = f"no connection to {self._transport} within {self.timeout:g} s"
        last = self._last_failure
        if last is None:
            return ModbusConnectionError(reason, errno=errno.ETIMEDOUT)
        return _because_of(last, f"{reason}; {last.args[0]}")

    def prove(self) -> None:
        """Something good came over it."""
        self._fruitless = 0
        self._last_failure = None

    def lose(self, error: ModbusConnectionError, *, by_itself: bool = True) -> None:
        """Close it; it may be opened again. With backoff if it went away and was no good."""
        self._statistics.lost += 1
        self._shut()
        if by_itself and self._fruitless:
            self._back_off(error)
        self._change(State.DISCONNECTED, error)

    def close(self) -> asyncio.Task[None] | None:
        """Close it for good; gives the attempt that is being cancelled."""
        if self.state is State.CLOSED:
            return None
        if self._retry is not None:
            self._retry.cancel()
        self._shut()
        self._change(State.CLOSED)
        if self._attempt is not None:
            self._attempt.cancel()
        return self._attempt

    def _shut(self) -> None:
        if self.is_open:
            self._loop.remove_reader(self._transport.descriptor)
            self._transport.close()

    def _start(self) -> None:
        self._retry = None
        self._change(State.CONNECTING)
        self._attempt = self._loop.create_task(self._open())

    async def _open(self) -> None:
        self._fruitless += 1
        try:
            async with asyncio.timeout(self.timeout):
                await self._transport.open(self.timeout)
            self._loop.add_reader(self._transport.descriptor, self.readable)
        except OSError as error:
            self._transport.close()
            self._fail(error)
        except asyncio.CancelledError:
            self._transport.close()
            raise
        else:
            self._attempt = None
            self._statistics.connects += 1
            self._change(State.CONNECTED)
            self.opened()

    def _fail(self, cause: OSError) -> None:
        error = cause
        if not isinstance(error, ModbusConnectionError):
            late = isinstance(cause, TimeoutError)
            reason = f"not within {self.timeout:g} s" if late else cause.strerror or str(cause)
            number = errno.ETIMEDOUT if late else cause.errno
            error = ModbusConnectionError(
                f"cannot connect to {self._transport}: {reason}", errno=number
            )
            error.__cause__ = cause
        self._attempt = None
        self._statistics.failed_connects += 1
        self._back_off(error)
        self._change(State.DISCONNECTED, error)
        self.failed(error)

    def _back_off(self, error: ModbusConnectionError) -> None:
        pause = min(LONGEST_PAUSE, FIRST_PAUSE * 2 ** min(self._fruitless - 1, 20))
        self._next_attempt = self._loop.time() + pause * random.uniform(0.8, 1.0)
        self._last_failure = error

    def _change(self, state: State, error: ModbusError | None = None) -> None:
        self.state = state
        if self._on_state is not None:
            try:
                self._on_state(state, error)
            except Exception:
                logger.exception("on_state(%s) failed", state.name)


def _because_of(cause: ModbusConnectionError, reason: str) -> ModbusConnectionError:
    error = ModbusConnectionError(reason, errno=cause.errno)
    error.__cause__ = cause.__cause__
    return error
