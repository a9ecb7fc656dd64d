"""
Calls of user functions, delayed until the state of a client is consistent again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from ..protocol.checks import finished, log_failure

if TYPE_CHECKING:
    from ..protocol.errors import ModbusError
    from .reconnecting import OnState, State

__all__ = ["Notices"]


class Notices:
    """
    Pending calls of callbacks about changes of state and traced ADUs, in the order of these events.

    A driver makes the calls between two steps, so that a callback that uses the client, or raises
    an exception, never interrupts a change.
    """

    def __init__(self) -> None:
        self.waiting: deque[tuple[str, Callable[[], object]]] = deque()
        self._is_giving = False

    def add(self, name: str, call: Callable[[], object]) -> None:
        """Make a call later; `name` is the name of the callback in the log."""
        self.waiting.append((name, call))

    def delaying(self, on_state: OnState) -> OnState:
        """Return a function that adds a call of `on_state`."""

        def note(state: State, error: ModbusError | None) -> None:
            self.add(f"on_state({state.name})", partial(on_state, state, error))

        return note

    def give(self) -> None:
        """
        Make the calls. An Exception that a callback raises is logged. Any other BaseException is
        raised, and the remaining calls are made the next time.
        """
        if self._is_giving:  # a callback uses the client; the other calls are made after it
            return
        self._is_giving = True
        try:
            while self.waiting:
                name, call = self.waiting.popleft()
                try:
                    finished(name, call())
                except Exception:
                    log_failure(__name__, "%s failed", name)
        finally:
            self._is_giving = False
