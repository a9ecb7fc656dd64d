"""
Values that a device computes when they are looked at.
"""

from __future__ import annotations

import logging
import time

from ...device.device import Device
from ...protocol.errors import ExceptionResponse

__all__ = ["Refreshing"]

logger: logging.Logger = logging.getLogger(__name__)

# A device may refuse because it is busy. Who refuses each cell costs a call for each.
RETRY = 10.0


class Refreshing:
    """
    Has values computed before they are looked at.

    What a device refuses to compute is tried in halves, and left alone for `RETRY` seconds.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._runs: dict[tuple[str, range], list[range]] = {}
        self._until = 0.0
        self._has_failed = False

    def refresh(self, table: str, addresses: range) -> None:
        if (now := time.monotonic()) >= self._until:
            self._until = now + RETRY
            self._runs.clear()
        key = table, addresses
        runs = self._runs.get(key, [addresses])
        good = [each for run in runs for each in self._refreshed(table, run)]
        if good != [addresses]:
            self._runs[key] = good

    def _refreshed(self, table: str, run: range) -> list[range]:
        """Give the parts of it that could be."""
        if not run:
            return []
        try:
            self._device.refresh(table, run.start, len(run))
        except ExceptionResponse:
            middle = len(run) // 2
            parts = [run[:middle], run[middle:]] if middle else []
            return [each for part in parts for each in self._refreshed(table, part)]
        except BaseException:  # it may mean to end a server, but here is none
            if not self._has_failed:
                self._has_failed = True
                logger.exception("%s %s: before_read failed", table, run)
        return [run]
