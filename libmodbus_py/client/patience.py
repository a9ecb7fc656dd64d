"""
How long a caller waits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..protocol.checks import integer, seconds

__all__ = ["Patience"]


@dataclass(slots=True)
class Patience:
    """
    How long to wait, and how often to ask again.

    Attributes:
        timeout: seconds for one request.
        retries: after no answer, a damaged one, or a connection lost meanwhile.
        busy_retries: after a refusal because the device is busy.
    """

    timeout: float
    retries: int
    busy_retries: int

    def but(self, timeout: float | None, retries: int | None) -> Patience:
        """Give one like it, with what is not None in place of its own."""
        patience = self
        if timeout is not None:
            patience = replace(patience, timeout=seconds("timeout", timeout))
        if retries is not None:
            patience = replace(patience, retries=integer("retries", retries, 0, 100))
        return patience
