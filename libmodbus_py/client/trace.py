"""
Every ADU that a client sends and receives, for whoever wants to see it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

__all__ = ["OnTraced", "Trace", "Traced"]

logger: logging.Logger = logging.getLogger(__name__)
wire: logging.Logger = logging.getLogger("libmodbus_py.wire")


class Traced(NamedTuple):
    """
    One ADU that passed.

    Attributes:
        time: seconds since the epoch (time.time).
        endpoint: URL of the connection.
        direction: "sent" or "received".
        adu: all its bytes, or those that are no frame.
        unit, function: what it says; None for bytes that are no frame.
    """

    time: float
    endpoint: str
    direction: Literal["sent", "received"]
    adu: bytes
    unit: int | None
    function: int | None

    def __str__(self) -> str:
        arrow = ">" if self.direction == "sent" else "<"
        what = "" if self.unit is None else f"unit {self.unit}, function {self.function}: "
        return f"{self.endpoint} {arrow} {what}{self.adu.hex(' ')}"


OnTraced = Callable[[Traced], object]


class Trace:
    """
    Tells a callback, and the logger ``libmodbus_py.wire`` at DEBUG.

    A callback that fails is logged, and harms no request.
    """

    def __init__(self, endpoint: str, callback: OnTraced | None) -> None:
        self._endpoint = endpoint
        self._callback = callback

    @property
    def is_on(self) -> bool:
        return self._callback is not None or wire.isEnabledFor(logging.DEBUG)

    def tell(
        self,
        direction: Literal["sent", "received"],
        adu: bytes,
        unit: int | None = None,
        function: int | None = None,
    ) -> None:
        traced = Traced(time.time(), self._endpoint, direction, adu, unit, function)
        wire.debug("%s", traced)
        if self._callback is not None:
            try:
                self._callback(traced)
            except Exception:
                logger.exception("trace(%s) failed", traced)
