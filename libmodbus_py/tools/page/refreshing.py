"""
Lets devices compute values that are computed when they are read.
"""

from __future__ import annotations

import time

from ...device.device import Device
from ...protocol.errors import ExceptionResponse
from ...protocol.logs import HarmlessLogger

__all__ = ["Refreshing"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds between two attempts. A device may refuse because it is busy; if it refuses all cells,
# each cell costs a call.
RETRY = 10.0


class Refreshing:
    """
    Lets a device compute values before they are shown.

    Ranges that the device refuses are tried in halves, and the refused cells are not tried again
    for `RETRY` seconds.
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
        """Return the parts of a range that were computed."""
        if not run:
            return []
        try:
            self._device.refresh(table, run.start, len(run))
        except ExceptionResponse:
            middle = len(run) // 2
            parts = [run[:middle], run[middle:]] if middle else []
            return [each for part in parts for each in self._refreshed(table, part)]
        except BaseException:  # a hook may raise it to end a server, but must not end the page
            if not self._has_failed:
                self._has_failed = True
                logger.exception("%s %s: before_read failed", table, run)
        return [run]
