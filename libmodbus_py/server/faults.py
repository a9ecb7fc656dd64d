"""
Faults in the answers of a server: which one is due for a request, and the switch of a running
server, whose users do not undo each other.

The faults themselves, with their bytes, come from the caller (`ServerFault`).
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import NamedTuple, Protocol, runtime_checkable

from ..protocol.checks import integer
from ..protocol.framing import Frame, Framer


class Fragment(NamedTuple):
    """Bytes to send, and the seconds to wait after the previous fragment."""

    wait: float
    data: bytes
    is_last: bool = False  # the connection is closed after this fragment
    traced: tuple[tuple[bytes, Frame | None], ...] = ()  # None for bytes that are no frame


@runtime_checkable
class ServerFault(Protocol):
    """A mistake in answers, such as `Fault`; one that replaces an equal one goes on counting."""

    @property
    def code(self) -> int | None:
        """The exception that refuses the request; None to execute it."""

    def concerns(self, request: Frame, *, has_transaction: bool) -> bool:
        """Return True if the fault counts a request, which may have a transaction id."""
        ...

    def counter(self) -> FaultCounter:
        """Return a new counter of its requests."""
        ...

    def fragments(self, answer: Frame, framer: Framer) -> list[Fragment]:
        """Return the bytes to be sent instead of an answer."""
        ...


class FaultCounter(Protocol):
    """Counts the requests that a fault concerns."""

    def is_due(self) -> bool:
        """Count a request, and return True if the fault happens to it."""
        ...

    def happening(self) -> ServerFault:
        """Return the fault as it happens this time."""
        ...


class CountedFault(NamedTuple):
    """A fault, and its count of requests."""

    fault: ServerFault
    counter: FaultCounter


class Faults:
    """The faults of a server by unit or alias; those equal to faults of `before` go on counting."""

    def __init__(
        self,
        faults: Mapping[int | None, Iterable[ServerFault]],
        before: Faults | None = None,
        aliases: Mapping[int, int] | None = None,
    ) -> None:
        self._by_unit: dict[int | None, list[CountedFault]] = {}
        for unit, given_faults in faults.items():
            key = None if unit is None else integer("faults: unit", unit, 0, 255)
            others = [] if before is None else list(before._by_unit.get(key, ()))
            self._by_unit[key] = [_counted(fault, others) for fault in given_faults]
        for alias, unit in (aliases or {}).items():
            if unit in self._by_unit:
                self._by_unit.setdefault(alias, self._by_unit[unit])

    def __bool__(self) -> bool:
        return any(self._by_unit.values())

    def concerns(self, unit: int) -> bool:
        """Return True if answers of a unit may have faults."""
        return bool(self._by_unit.get(unit) or self._by_unit.get(None))

    def due(self, request: Frame, *, has_transaction: bool) -> ServerFault | None:
        """Count a request that is going to be answered, and return its fault, or None."""
        due = [
            entry
            for entry in (*self._by_unit.get(request.unit, ()), *self._by_unit.get(None, ()))
            if entry.fault.concerns(request, has_transaction=has_transaction)
            and entry.counter.is_due()
        ]
        return due[0].counter.happening() if due else None


def _counted(fault: object, others: list[CountedFault]) -> CountedFault:
    """Return the known counter of an equal fault, each once, or a new one."""
    if not isinstance(fault, ServerFault):
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {fault!r}")
    for at, other in enumerate(others):
        if other.fault == fault:
            return others.pop(at)
    return CountedFault(fault, fault.counter())


# --- faults that are switched on and off ----------------------------------------------------------

FaultsByUnit = dict[int | None, list[ServerFault]]
"""Unit 0..255 -> the faults of its answers; None is every unit."""

_numbers = count()


@dataclass(eq=False, slots=True)
class FaultState:
    """One fault of a server, which is on or off."""

    unit: int | None  # None for every unit
    fault: ServerFault
    is_given: bool  # True if it was passed to the server, and not switched on later
    is_on: bool = True
    number: int = field(default_factory=lambda: next(_numbers))  # later faults have greater ones


class FaultSwitch:
    """
    Switches faults of one server on and off, from any thread.

    Each server has one, `Server.fault_switch`. It keeps the faults that were given to the server
    and, before them, those that each user has switched on. A user can remove only its own faults,
    and `Server.replace` only those that were given to the server.

    Args:
        apply: called with all faults that are on; if it raises an exception, nothing has changed.
    """

    def __init__(self, apply: Callable[[FaultsByUnit], object]) -> None:
        self._apply = apply
        self._states: list[FaultState] = []
        # Reentrant, because a signal handler may switch faults in the middle of a change.
        self._changing = threading.RLock()

    def switch_on(self, *faults: ServerFault, unit: int | None = None) -> _Switched:
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
        states = [FaultState(unit, fault, is_given=False) for fault in faults]
        with self._changing:
            self._change([*states, *self._states])
        return _Switched(self, states)

    def states(self) -> list[FaultState]:
        """Return all faults, on or off: those switched on last come first, the given ones last."""
        with self._changing:
            return list(self._states)

    def turn(self, state: FaultState, *, is_on: bool) -> None:
        """
        Switch one fault of `states` on or off; it keeps its position.

        Raises:
            ValueError: the server does not have this fault any more.
        """
        with self._changing:
            if state not in self._states:
                raise ValueError(f"the server does not have the fault {state.fault} any more")
            state.is_on = is_on
            self._change(self._states)

    @contextlib.contextmanager
    def giving(self, faults: FaultsByUnit) -> Iterator[FaultsByUnit]:
        """Replace the faults given to the server if the block applies all that are on then."""
        with self._changing:
            states = [state for state in self._states if not state.is_given]
            for unit, unit_faults in faults.items():
                states += [FaultState(unit, fault, is_given=True) for fault in unit_faults]
            yield _that_are_on(states)
            self._states = states

    def remove(self, states: list[FaultState]) -> None:
        """Remove faults that were switched on; may be called any number of times."""
        with self._changing:
            self._change([state for state in self._states if state not in states])

    def _change(self, states: list[FaultState]) -> None:
        self._apply(_that_are_on(states))
        self._states = states


def _that_are_on(states: list[FaultState]) -> FaultsByUnit:
    faults: FaultsByUnit = {}
    for state in states:
        if state.is_on:
            faults.setdefault(state.unit, []).append(state.fault)
    return faults


class _Switched(contextlib.AbstractContextManager["_Switched"]):
    """Faults that one user has switched on, until they are switched off."""

    def __init__(self, switch: FaultSwitch, states: list[FaultState]) -> None:
        self.states: list[FaultState] = states
        self._switch = switch

    def __exit__(self, *_: object) -> None:
        self.switch_off()

    def switch_off(self) -> None:
        """Remove the faults again. May be called repeatedly."""
        self._switch.remove(self.states)
