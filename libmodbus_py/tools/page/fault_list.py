"""
The faults of a server, which a page lists and switches on and off.
"""

from __future__ import annotations

import threading
from dataclasses import fields
from itertools import count
from typing import Any

from ..faults.fault import Fault
from ..faults.switch import FaultState, FaultSwitch

__all__ = ["MOST_FAULTS", "FaultList"]

MOST_FAULTS = 200


class FaultList:
    """
    The faults of one server, each with a number that does not change. Safe from any thread.

    Args:
        switch: the fault switch of the server, which other programs may use, too.
    """

    def __init__(self, switch: FaultSwitch) -> None:
        self._switch = switch
        self._lock = threading.Lock()
        self._numbers = count()
        self._states: dict[int, FaultState] = {}

    @property
    def version(self) -> int:
        """A number that increases with every change."""
        return self._switch.version

    def as_json(self) -> list[list[Any]]:
        """Return number, unit, kind, settings and state of each fault, the oldest first."""
        with self._lock:
            self._follow()
            return [_as_json(number, each) for number, each in self._states.items()]

    def turn(self, number: int, *, is_on: bool) -> None:
        """
        Switch a fault on or off.

        Raises:
            ValueError: the server does not have this fault any more.
        """
        with self._lock:
            self._follow()
            if number not in self._states:
                raise ValueError("this fault no longer exists")
            self._switch.turn(self._states[number], is_on=is_on)

    def add(self, unit: int | None, fault: Fault) -> None:
        """
        Add a fault and switch it on; `unit` is None for every unit.

        Raises:
            ValueError: there are `MOST_FAULTS` already.
        """
        with self._lock:
            self._follow()
            if len(self._states) >= MOST_FAULTS:
                raise ValueError(f"there are {MOST_FAULTS} faults already, which is the maximum")
            self._switch.switch_on(fault, unit=unit)

    def _follow(self) -> None:
        now = self._switch.states()
        known = {id(each): number for number, each in self._states.items()}
        numbered = {
            known[id(each)] if id(each) in known else next(self._numbers): each for each in now
        }
        self._states = dict(sorted(numbered.items()))


def _as_json(number: int, state: FaultState) -> list[Any]:
    return [number, state.unit, state.fault.kind, _settings(state.fault), state.is_on]


def _settings(fault: Fault) -> str:
    """Return all settings except the kind, such as ``seconds 1.5, function 3``."""
    given = {each.name: getattr(fault, each.name) for each in fields(fault) if each.name != "kind"}
    return ", ".join(
        f"{name} {value.hex(' ') if isinstance(value, bytes) else value}"
        for name, value in given.items()
        if value is not None
    )
