"""
Timeouts and retries of a request.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..protocol.checks import integer, seconds

__all__ = ["Timeouts"]


@dataclass(slots=True)
class Timeouts:
    """
    The timeout of a request, and its retries.

    Attributes:
        timeout: the seconds that one request may take.
        retries: how often it is sent again if there was no response or a damaged one, or if the
            connection was lost.
        busy_retries: how often it is sent again if the device refused it because it is busy.
    """

    timeout: float
    retries: int
    busy_retries: int

    def but(self, timeout: float | None, retries: int | None) -> Timeouts:
        """Return a copy with the values that are not None."""
        timeouts = self
        if timeout is not None:
            timeouts = replace(timeouts, timeout=seconds("timeout", timeout))
        if retries is not None:
            timeouts = replace(timeouts, retries=integer("retries", retries, 0, 100))
        return timeouts
