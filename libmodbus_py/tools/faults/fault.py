"""
A fault: a mistake in answers of a server, the requests concerned, and its frequency; and the switch
of one running server, whose users do not undo each other.

`server` counts the requests of a server, and makes the fault that is due happen.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Literal, get_args

from ...device.access import Touched
from ...protocol.checks import integer, number, seconds
from ...protocol.mistakes import WrongType, WrongValue, named_arguments
from ...protocol.tables import TABLE_SIZE, TABLES, Table

__all__ = ["KINDS", "OPTIONAL", "PLACES", "Fault", "FaultSwitch", "FaultsByUnit"]

KINDS: dict[str, str | None] = {
    "delay": "seconds",
    "no_answer": None,
    "exception": "code",
    "wrong_check": None,
    "wrong_transaction": None,
    "wrong_unit": None,
    "trickle": "seconds",
    "truncate": "length",
    "disconnect": None,
    "garbage": None,
}
"""Kind of fault -> the one setting that it needs."""

OPTIONAL: dict[str, tuple[str, ...]] = {
    "disconnect": ("length",),
    "garbage": ("data", "length", "place"),
}
"""Kind of fault -> the settings that it can have."""

Place = Literal["before", "instead", "behind"]

PLACES: tuple[Place, ...] = get_args(Place)
"""The places of garbage relative to the answer."""

LONGEST = 512
"""More bytes than any frame has."""


def _data(name: str, value: object) -> None:
    if not isinstance(value, bytes):
        raise WrongType(name, f"must be bytes, not {type(value).__name__}")
    if len(value) > LONGEST:
        raise WrongValue(name, f"must have 0..{LONGEST} bytes, not {len(value)}")


def _one_of(choices: Iterable[str]) -> Callable[[str, object], None]:
    def check(name: str, value: object) -> None:
        if not isinstance(value, str) or value not in choices:
            raise WrongValue(name, f"must be one of {', '.join(choices)}, not {value!r}")

    return check


def _whole(low: int, high: int) -> Callable[[str, object], object]:
    return lambda name, value: integer(name, value, low, high)


SETTINGS: dict[str, Callable[[str, object], object]] = {
    "seconds": seconds,
    "code": _whole(1, 0xFF),
    "length": _whole(0, LONGEST),
    "data": _data,
    "place": _one_of(PLACES),
}
"""Setting that only some kinds have -> its check."""

WHICH: dict[str, Callable[[str, object], object]] = {
    "function": _whole(1, 0x7F),
    "table": _one_of(TABLES),
    "address": _whole(0, TABLE_SIZE - 1),
    "count": _whole(1, TABLE_SIZE),
    "every": _whole(1, 1_000_000_000),
    "probability": lambda name, value: number(name, value, 0, 1),
    "seed": _whole(0, (1 << 64) - 1),
}
"""Attribute that selects requests -> its check."""


@named_arguments
@dataclass(frozen=True)
class Fault:
    """
    A fault in the responses of a unit, and how often it happens.

    A fault counts the answered requests of its unit, function and address range, from all clients
    on all endpoints together. If several faults are due for a request, those of the unit come
    before those of all units, and earlier ones before later ones. The request is executed
    whatever happens to its response; only "exception" executes nothing.

    Attributes:
        kind: what goes wrong:

            * "delay": the response, and those after it on the connection, come `seconds` later;
            * "no_answer": no response is sent;
            * "exception": the request is refused with the exception `code`;
            * "wrong_check": the CRC or LRC is wrong; on TCP, the length in the header is 0;
            * "wrong_transaction": the response has the transaction id of the previous
              request; never on lines, which have none;
            * "wrong_unit": the response has the address of another unit;
            * "trickle": its bytes are sent one by one, `seconds` apart; over UDP as datagrams;
            * "truncate": only the first `length` bytes of the frame are sent, never all;
            * "disconnect": the first `length` bytes of the response are sent, none by default,
              then the connection is closed, and later requests of the client are not executed.
              On serial ports and UDP only the rest of the response is missing;
            * "garbage": `data`, or `length` random bytes, are sent at `place`; over UDP in the
              datagram of the response.

        function: the function code whose requests have the fault, 1..127; None for all.
        every: the fault happens to every n-th request, n = 1 or more; None for 1.
        probability: the probability that the fault happens to a request, 0..1, in place of
            `every`.
        seed: makes `probability` select the same requests in each run, and makes random bytes
            the same; 0..2^64 - 1.
        seconds: for "delay" and "trickle", 0.001..86400.
        code: for "exception", 1..255.
        length: a number of bytes, 0..512.
        table: the fault happens only to requests that read or write this table: "coils",
            "discrete_inputs", "holding_registers", "input_registers"; None for all tables.
        address: the fault happens only to requests that touch one of `count` addresses starting
            here, 0..65535; None for all addresses.
        count: 1..65536; None for 1.
        data: for "garbage", 0..512 bytes.
        place: "before" the response, "instead" of it or "behind" it; None for before.

    Raises:
        TypeError, ValueError: an attribute is of the wrong type or range, or missing, or does not
            apply to the kind.
    """

    kind: str
    function: int | None = None
    every: int | None = None
    probability: float | None = None
    seed: int | None = None
    seconds: float | None = None
    code: int | None = None
    length: int | None = None
    table: Table | None = None
    address: int | None = None
    count: int | None = None
    data: bytes | None = None
    place: Place | None = None

    def __post_init__(self) -> None:
        _one_of(KINDS)("kind", self.kind)
        needed = KINDS[self.kind]
        allowed = WHICH.keys() | {needed, *OPTIONAL.get(self.kind, ())}
        for name, check in (SETTINGS | WHICH).items():
            if (value := getattr(self, name)) is None:
                if name == needed:
                    raise WrongValue(name, f"is missing, which {self.kind} needs")
            elif name not in allowed:
                raise WrongValue(name, f"does not apply to {self.kind}")
            else:
                check(name, value)
        if self.kind == "garbage" and (self.data is None) == (self.length is None):
            raise WrongValue("data", "or length is missing, and garbage needs one of them")
        if self.count is not None and self.address is None:
            raise WrongValue("count", "cannot be given without address")
        if self.every is not None and self.probability is not None:
            raise WrongValue("probability", "cannot be given together with every")
        if self.seed is not None and self.probability is None and not self.has_random_bytes:
            raise WrongValue("seed", "cannot be given without probability")

    @property
    def has_random_bytes(self) -> bool:
        """True for garbage of which only the length is given."""
        return self.kind == "garbage" and self.length is not None

    @property
    def is_everywhere(self) -> bool:
        """True if the fault happens to requests of all addresses."""
        return self.table is None and self.address is None

    def hits(self, touched: Touched) -> bool:
        """Return True if the fault happens to a request with these accesses."""
        first = 0 if self.address is None else self.address
        stop = TABLE_SIZE if self.address is None else first + (self.count or 1)
        return any(
            access.table == self.table or (self.table is None and access.table in TABLES)
            for access in (*touched.writes, *touched.reads)
            if access.address < stop and first < access.address + access.count
        )


FaultsByUnit = dict[int | None, list[Fault]]
"""Unit 0..255 -> the faults of its answers; None is every unit."""

_numbers = count()


@dataclass(eq=False, slots=True)
class FaultState:
    """One fault of a server, which is on or off."""

    unit: int | None  # None for every unit
    fault: Fault
    is_given: bool  # to the server itself, not switched on
    is_on: bool = True
    number: int = field(default_factory=lambda: next(_numbers))  # greater than of earlier ones


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

    def switch_on(self, *faults: Fault, unit: int | None = None) -> _Switched:
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
        made = [FaultState(unit, fault, is_given=False) for fault in faults]
        with self._changing:
            self._change([*made, *self._states])
        return _Switched(self, made)

    def states(self) -> list[FaultState]:
        """Return all faults, on or off: those switched on last come first, the given ones last."""
        with self._changing:
            return list(self._states)

    def turn(self, state: FaultState, *, is_on: bool) -> None:
        """
        Switch one fault of `states` on or off; it stays in its place among them.

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
            states = [each for each in self._states if not each.is_given]
            for unit, given in faults.items():
                states += [FaultState(unit, fault, is_given=True) for fault in given]
            yield _that_are_on(states)
            self._states = states

    def remove(self, states: list[FaultState]) -> None:
        """Remove faults that were switched on; may be called any number of times."""
        with self._changing:
            self._change([each for each in self._states if each not in states])

    def _change(self, states: list[FaultState]) -> None:
        self._apply(_that_are_on(states))
        self._states = states


def _that_are_on(states: list[FaultState]) -> FaultsByUnit:
    faults: FaultsByUnit = {}
    for each in states:
        if each.is_on:
            faults.setdefault(each.unit, []).append(each.fault)
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
