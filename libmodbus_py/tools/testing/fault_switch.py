"""
Faults that are switched on and off while a server serves.
"""

from __future__ import annotations

import threading
from typing import Self

from ...server.faults.fault import Fault
from ...server.server import Server

__all__ = ["FaultSwitch", "Switched"]


class FaultSwitch:
    """Switches faults of one server, from any thread."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._given = {unit: list(faults) for unit, faults in server.faults.items()}
        self._on: list[Switched] = []
        self._changing = threading.Lock()

    def switch_on(self, *faults: Fault, unit: int | None = None) -> Switched:
        """
        Have something go wrong from now on.

        Args:
            faults: they come before those that are there already.
            unit: 0..255, whose answers; None for every unit.

        Returns:
            What switches them off again, by itself at the end of a ``with`` block.

        Raises:
            TypeError, ValueError: an argument is something else; nothing has changed.
        """
        made = Switched(self, unit, faults)
        with self._changing:
            self._replace([made, *self._on])
        return made

    def _switch_off(self, switched: Switched) -> None:
        with self._changing:
            self._replace([each for each in self._on if each is not switched])

    def _replace(self, on: list[Switched]) -> None:
        faults: dict[int | None, list[Fault]] = {}
        for each in on:
            faults.setdefault(each.unit, []).extend(each.faults)
        for unit, given in self._given.items():
            faults.setdefault(unit, []).extend(given)
        self._server.replace(self._server.devices, faults)
        self._on = on


class Switched:
    """Faults that are on, until they are switched off."""

    def __init__(self, switch: FaultSwitch, unit: int | None, faults: tuple[Fault, ...]) -> None:
        self.unit = unit
        self.faults = faults
        self._switch = switch

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.switch_off()

    def switch_off(self) -> None:
        """Have them happen no more; any number of times."""
        self._switch._switch_off(self)
