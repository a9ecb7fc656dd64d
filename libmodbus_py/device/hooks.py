"""
The functions of the application that a device calls, and how long they take.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TypeVar

__all__ = ["SLOW", "timed"]

logger: logging.Logger = logging.getLogger(__name__)

SLOW = 0.1
"""Seconds that no function of the application should take: no client is answered meanwhile."""

Given = TypeVar("Given")
Result = TypeVar("Result")


def timed(name: str, call: Callable[[Given], Result]) -> Callable[[Given], Result]:
    """Give the same function, which says once when it took long; `name` is what it is for."""
    is_known = False

    def measured(given: Given) -> Result:
        nonlocal is_known
        start = time.monotonic()
        try:
            return call(given)
        finally:  # one that fails may have taken long, too
            took = time.monotonic() - start
            if took >= SLOW and not is_known:
                is_known = True
                own_name = getattr(call, "__qualname__", None) or repr(call)
                logger.warning(
                    "%s (%s) took %.3g s, and held up all clients of the server meanwhile; "
                    "this is said once",
                    name,
                    own_name,
                    took,
                )

    return measured
