"""
A timer of an event loop that may ring too early, but never too late.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

__all__ = ["Alarm"]


class Alarm:
    """
    A timer that is replaced only when an earlier time is set, because most timers are not needed.

    Args:
        ring: is called in the loop; it sets the alarm again if there is more to wait for.

    Attributes:
        at: when the alarm rings, by the clock of the loop in seconds; infinite if it is not set.
    """

    def __init__(self, ring: Callable[[], object]) -> None:
        self.at: float = math.inf
        self._ring = ring
        self._timer: asyncio.TimerHandle | None = None

    def set(self, at: float, loop: asyncio.AbstractEventLoop) -> None:
        """Ring at this time, or earlier if the alarm is set for an earlier time."""
        if at < self.at:
            self.cancel()
            self.at = at
            self._timer = loop.call_at(at, self._rings)

    def cancel(self) -> None:
        """Clear the alarm; it can be set again."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self.at = None, math.inf

    def _rings(self) -> None:
        self._timer, self.at = None, math.inf
        self._ring()
