"""
A port or a connection that is lost and comes back: when to open it again, and what the log says.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from ..protocol.errors import ModbusConnectionError, ModbusError
from ..protocol.logs import HarmlessLogger

__all__ = ["REOPEN_AFTER", "Outage"]

# Seconds between two attempts to open a port that is gone.
REOPEN_AFTER = 1.0


class Outage:
    """
    Logs once that something was lost, and once that it is open again.

    Args:
        log: of the part that uses it.
        name: of the port or the connection, for the log.

    Attributes:
        is_on: True while it is lost.
    """

    def __init__(self, log: logging.Logger | HarmlessLogger, name: object) -> None:
        self.is_on: bool = False
        self._log = log
        self._name = name

    def begin(self, error: ModbusError) -> None:
        """Note that it was lost, or could not be opened."""
        if not self.is_on:
            self.is_on = True
            self._log.warning("%s: %s; trying again", self._name, error)

    def end(self) -> None:
        """Note that it is open."""
        if self.is_on:
            self.is_on = False
            self._log.warning("%s: open again", self._name)

    def try_to_end(self, reopen: Callable[[], object]) -> bool:
        """Open it again; return False if it is still gone. Call it every `REOPEN_AFTER` seconds."""
        try:
            reopen()
        except ModbusConnectionError:
            return False
        self.end()
        return True
