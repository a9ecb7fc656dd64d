"""
The faults of one running server, switched by several users who do not undo each other.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import count
from typing import Self

from .fault import Fault

__all__ = ["FaultSwitch", "FaultsByUnit", "Switched"]

FaultsByUnit = dict[int | None, list[Fault]]
"""Unit 0..255 -> the faults of its answers; None is every unit."""

_numbers = count()


class FaultState:
    """
    One fault of a server, which is on or off.

    Attributes:
        unit: the unit whose responses have the fault, 0..255; None for every unit.
        fault: the fault.
        number: a number that no other fault of the program has; later ones have greater ones.
        is_on: True if the fault is on; `FaultSwitch.turn` changes this.
    """

    __slots__ = ("fault", "is_on", "number", "unit")

    def __init__(self, unit: int | None, fault: Fault) -> None:
        self.unit: int | None = unit
        self.fault: Fault = fault
        self.number: int = next(_numbers)
        self.is_on: bool = True


class FaultSwitch:
    """
    Switches faults of one server on and off, from any thread.

    Each server has one, `Server.fault_switch`. It keeps the faults that were given to the server
    and, before them, those that each user has switched on. A user can remove only its own faults,
    and `Server.replace` only those that were given to the server.

    Args:
        apply: called with all faults that are on; if it raises an exception, nothing has changed.

    Attributes:
        version: a number that grows with every change.
    """

    def __init__(self, apply: Callable[[FaultsByUnit], object]) -> None:
        self._apply = apply
        self._given: list[FaultState] = []
        self._switched: list[Switched] = []
        # Reentrant, because a signal handler may switch faults in the middle of a change.
        self._changing = threading.RLock()
        self.version: int = 0

    def switch_on(self, *faults: Fault, unit: int | None = None) -> Switched:
        """
        Switch faults on.

        Args:
            faults: the faults; they come before those that exist already.
            unit: the unit whose responses have the faults, 0..255; None for every unit.

        Returns:
            An object that switches the faults off again; it does so by itself at the end of a
            ``with`` block.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing has changed.
        """
        with self._changing:
            made = Switched(self, unit, faults)
            self._change([made, *self._switched])
        return made

    def states(self) -> list[FaultState]:
        """Return all faults, on or off: those switched on last come first, the given ones last."""
        with self._changing:
            return self._states(self._switched, self._given)

    def turn(self, state: FaultState, *, is_on: bool) -> None:
        """
        Switch one fault of `states` on or off; it stays in its place among them.

        Raises:
            ValueError: the server does not have this fault any more.
        """
        with self._changing:
            if not any(each is state for each in self.states()):
                raise ValueError(f"the server does not have the fault {state.fault} any more")
            state.is_on = is_on
            self._change(self._switched)

    @contextlib.contextmanager
    def giving(self, faults: Mapping[int | None, Iterable[Fault]]) -> Iterator[FaultsByUnit]:
        """
        Replace the faults that were given to the server while the ``with`` block runs.

        The block gets all faults that are on then, and applies them. If it raises an exception,
        nothing has changed.
        """
        with self._changing:
            given = [FaultState(unit, each) for unit, found in faults.items() for each in found]
            yield _that_are_on(self._states(self._switched, given))
            self._given = given
            self.version += 1

    def remove(self, switched: Switched) -> None:
        """Remove faults that were switched on; may be called any number of times."""
        with self._changing:
            self._change([each for each in self._switched if each is not switched])

    def _change(self, switched: list[Switched]) -> None:
        self._apply(_that_are_on(self._states(switched, self._given)))
        self._switched = switched
        self.version += 1

    def _states(self, switched: list[Switched], given: list[FaultState]) -> list[FaultState]:
        return [state for each in switched for state in each.states] + given


def _that_are_on(states: Iterable[FaultState]) -> FaultsByUnit:
    faults: FaultsByUnit = {}
    for each in states:
        if each.is_on:
            faults.setdefault(each.unit, []).append(each.fault)
    return faults


class Switched:
    """
    Faults that one user has switched on, until they are switched off.

    Attributes:
        unit: the unit whose responses have the faults, 0..255; None for every unit.
        faults: the faults.
        states: the same faults, as `FaultSwitch.states` lists them.
    """

    def __init__(self, switch: FaultSwitch, unit: int | None, faults: tuple[Fault, ...]) -> None:
        self.unit: int | None = unit
        self.faults: tuple[Fault, ...] = faults
        self.states: tuple[FaultState, ...] = tuple(FaultState(unit, each) for each in faults)
        self._switch = switch

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.switch_off()

    def switch_off(self) -> None:
        """Remove the faults again. May be called repeatedly."""
        self._switch.remove(self)
