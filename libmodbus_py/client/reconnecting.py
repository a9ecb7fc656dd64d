"""
When to connect again: the state of a connection, the pause after a failure, and notices.

No socket, no clock; times are seconds of any steady clock.
"""

from __future__ import annotations

import enum
import errno
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from ..protocol.checks import finished, log_failure
from ..protocol.errors import ModbusConnectionError, ModbusError

if TYPE_CHECKING:
    from .statistics import Statistics

__all__ = ["FORKED", "IDLE", "Notices", "OnState", "Reconnecting", "State"]

FIRST_PAUSE_S = 0.1

IDLE = ModbusConnectionError("closed, because no request came for `idle_close`")
"""The reason of an end that is no failure, and is not reported: no request needs the connection."""

FORKED = "this process was forked off"


class State(enum.Enum):
    """
    The state of a client's connection.

    Attributes:
        DISCONNECTED: there is no connection; the next request opens one.
        CONNECTING: the connection is being established.
        CONNECTED: the connection is established.
        CLOSED: the client was closed.
    """

    DISCONNECTED = "disconnected"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    CLOSED = "closed"


OnState: TypeAlias = Callable[[State, ModbusError | None], object]


class Notices:
    """Calls of callbacks, which a driver makes between two steps, to interrupt no change."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[str, Callable[[], object]]] = deque()
        self._is_giving = False

    def add(self, name: str, call: Callable[[], object]) -> None:
        """Make a call later; `name` is that of the callback in the log."""
        self.waiting.append((name, call))

    def give(self) -> None:
        """Make the calls, and log each Exception; nested ones wait until the first has ended."""
        if self._is_giving:  # a callback uses the client; the other calls are made after it
            return
        self._is_giving = True
        try:
            self._give_all()
        finally:
            self._is_giving = False

    def _give_all(self) -> None:
        while self.waiting:
            name, call = self.waiting.popleft()
            try:
                finished(name, call())
            except Exception:
                log_failure(__name__, "%s failed", name)


class Reconnecting:
    """
    The state of a connection, and the pauses before attempts to connect again.

    After an attempt that failed, or a connection that ended before a response came over it, there
    is a pause of 0.1 s, doubled each time up to `max_pause`, and shortened by up to a fifth at
    random, so that a hundred clients do not connect again at the same moment. `place` is the other
    side, for messages.
    """

    def __init__(
        self,
        place: str,
        max_pause: float,
        statistics: Statistics,
        notices: Notices,
        on_state: OnState | None,
    ) -> None:
        self.state: State = State.DISCONNECTED
        self.is_open: bool = False
        self.next_attempt: float = 0.0
        self._place = place
        self._max_pause = max_pause
        self._statistics = statistics
        self._notices = notices
        self._on_state = on_state
        self.fruitless: int = 0  # connections in a row that were attempted and brought no answer
        self._last_failure: ModbusConnectionError | None = None
        self._uniform: Callable[[float, float], float] | None = None
        if max_pause:  # not at the first failure, when no descriptor may be left for an import
            import random

            self._uniform = random.uniform

    def refusal(self, now: float, deadline: float) -> ModbusConnectionError | None:
        """Return why there will be no connection before the deadline; None if there may be one."""
        if self.state is State.CLOSED:
            return ModbusConnectionError("this client is closed", errno=errno.EBADF)
        last = self._last_failure
        if self.state is not State.DISCONNECTED or last is None or self.next_attempt <= deadline:
            return None
        return _because_of(last, f"{last.args[0]}; next attempt in {self.next_attempt - now:.1f} s")

    def not_in_time(self, timeout: float) -> ModbusConnectionError:
        """Return the error for a caller that has waited too long, with its reason if known."""
        reason = f"no connection to {self._place} within {timeout:g} s"
        last = self._last_failure
        if last is None:
            return ModbusConnectionError(reason, errno=errno.ETIMEDOUT)
        return _because_of(last, f"{reason}; {last.args[0]}")

    def connecting(self) -> None:
        """Note that an attempt begins."""
        self.fruitless += 1
        self._change(State.CONNECTING)

    def opened(self) -> None:
        """Note that an attempt succeeded."""
        self._statistics.connects += 1
        self._change(State.CONNECTED)

    def failed(self, error: ModbusConnectionError, now: float) -> None:
        """Note that an attempt failed."""
        self._statistics.failed_connects += 1
        self._back_off(error, now)
        self._change(State.DISCONNECTED, error)

    def given_up(self) -> None:
        """Note that an attempt was cancelled, from which nothing follows about the device."""
        self.fruitless -= 1
        self._change(State.DISCONNECTED)

    def prove(self) -> None:
        """Note that an answer was received over the connection."""
        self.fruitless = 0
        self._last_failure = None

    def lost(self, error: ModbusConnectionError, now: float, *, by_itself: bool) -> None:
        """Note that the connection ended; pause if it ended by itself and brought no answer."""
        if error is IDLE:
            self._change(State.DISCONNECTED)
            return
        self._statistics.lost += 1
        if by_itself and self.fruitless:
            self._back_off(error, now)
        self._change(State.DISCONNECTED, error)

    def close(self) -> None:
        """Close the connection permanently."""
        if self.state is not State.CLOSED:
            self._change(State.CLOSED)

    def _back_off(self, error: ModbusConnectionError, now: float) -> None:
        pause = min(self._max_pause, FIRST_PAUSE_S * 2 ** min(self.fruitless - 1, 20))
        if self._uniform is not None:
            pause *= self._uniform(0.8, 1.0)
        self.next_attempt = now + pause
        self._last_failure = error

    def _change(self, state: State, error: ModbusError | None = None) -> None:
        if self.state is State.CLOSED:
            return
        self.state = state
        self.is_open = state is State.CONNECTED
        if self._on_state is not None:
            call = partial(self._on_state, state, error)
            self._notices.add(f"on_state({state.name})", call)


def _because_of(cause: ModbusConnectionError, reason: str) -> ModbusConnectionError:
    error = ModbusConnectionError(reason, errno=cause.errno)
    error.__cause__ = cause.__cause__
    return error
