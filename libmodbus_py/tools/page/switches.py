"""
Faults, on and off: what the server was given, and what was added here.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, fields
from typing import Any

from ...server.faults.fault import Fault
from ...server.server import Server

__all__ = ["Switches"]

MOST_FAULTS = 200


@dataclass
class Switch:
    """One fault of a unit; None is every unit."""

    unit: int | None
    fault: Fault
    is_on: bool = True

    def as_json(self, number: int) -> list[Any]:
        return [number, self.unit, self.fault.kind, _words(self.fault), self.is_on]


def _words(fault: Fault) -> str:
    """All but the kind, such as ``seconds 1.5, function 3``."""
    given = {each.name: getattr(fault, each.name) for each in fields(fault) if each.name != "kind"}
    return ", ".join(
        f"{name} {value.hex(' ') if isinstance(value, bytes) else value}"
        for name, value in given.items()
        if value is not None
    )


class Switches:
    """
    The faults of a server, from any thread.

    Somebody else may change them, too: then what the server has is what there is.

    Attributes:
        version: another number whenever anything has changed.
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self._lock = threading.Lock()
        self._given: object = None
        self._all: list[Switch] = []
        self.version: int = 0

    def as_json(self) -> list[list[Any]]:
        with self._lock:
            self._follow()
            return [each.as_json(number) for number, each in enumerate(self._all)]

    def follow(self) -> int:
        """Look at what the server has; give the version."""
        with self._lock:
            self._follow()
            return self.version

    def switch(self, number: int, kind: str, *, is_on: bool) -> None:
        """
        Args:
            kind: of that fault, for there may be others by now.

        Raises:
            ValueError: there is no such fault any more.
        """
        with self._lock:
            self._follow()
            if not (0 <= number < len(self._all) and self._all[number].fault.kind == kind):
                raise ValueError("there is no such fault any more")
            self._all[number].is_on = is_on
            self._put()

    def add(self, unit: int | None, fault: Fault) -> None:
        """
        Raises:
            ValueError: there are too many.
        """
        with self._lock:
            self._follow()
            if len(self._all) >= MOST_FAULTS:
                raise ValueError(f"there are {MOST_FAULTS} faults, as many as can be")
            self._all.append(Switch(unit, fault))
            self._put()

    def _follow(self) -> None:
        given = self._server.faults
        if given is not self._given:
            self._given = given
            self._all = [Switch(unit, each) for unit, found in given.items() for each in found]
            self.version += 1

    def _put(self) -> None:
        by_unit: dict[int | None, list[Fault]] = {}
        for each in self._all:
            if each.is_on:
                by_unit.setdefault(each.unit, []).append(each.fault)
        self._server.replace(self._server.devices, by_unit)
        self._given = self._server.faults
        self.version += 1
