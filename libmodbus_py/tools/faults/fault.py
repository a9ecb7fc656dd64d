"""
A fault: a mistake in answers of a server, the requests concerned, and its frequency; and the faults
of one running server, switched by several users who do not undo each other.

`server` counts the requests of a server, and makes the fault that is due happen.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Literal, Self, get_args

from ...device.access import Touched
from ...protocol.checks import integer, number, seconds
from ...protocol.mistakes import WrongType, WrongValue, named_arguments
from ...protocol.tables import TABLE_SIZE, TABLES, Table

__all__ = [
    "KINDS",
    "PLACES",
    "Fault",
    "FaultSwitch",
    "FaultsByUnit",
]

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
    if not 1 <= len(value) <= LONGEST:
        raise WrongValue(name, f"must have 1..{LONGEST} bytes, not {len(value)}")


def _one_of(choices: tuple[str, ...]) -> Callable[[str, object], None]:
    def check(name: str, value: object) -> None:
        if value not in choices:
            raise WrongValue(name, f"must be one of {', '.join(choices)}, not {value!r}")

    return check


SETTINGS: dict[str, Callable[[str, object], object]] = {
    "seconds": seconds,
    "code": lambda name, value: integer(name, value, 1, 0xFF),
    "length": lambda name, value: integer(name, value, 1, LONGEST),
    "data": _data,
    "place": _one_of(PLACES),
}


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

            * "delay": the response is sent `seconds` later, and so are those after it on
              that connection;
            * "no_answer": no response is sent;
            * "exception": the request is refused with the exception `code`;
            * "wrong_check": the CRC or LRC is wrong; on TCP, which has none, the length in
              the header is 0;
            * "wrong_transaction": the response has the transaction id of the previous
              request; this never happens on serial lines, which have none;
            * "wrong_unit": the response has the address of another unit;
            * "trickle": the bytes of the response are sent one by one, `seconds` apart; over
              UDP, each byte is a datagram;
            * "truncate": only the first `length` bytes of the frame are sent, and never all
              of them;
            * "disconnect": the first `length` bytes of the response are sent (none if it is
              not given, all of a shorter response). Then the connection is closed, over TLS
              with close_notify, and later requests of the client are not executed. Serial
              ports and UDP have no connection: there only the rest of the response is
              missing;
            * "garbage": bytes that are not part of the response are sent at `place`: those of
              `data`, or `length` random ones; over UDP in the same datagram.

        function: the function code whose requests have the fault, 1..127; None for all.
        every: the fault happens to every n-th request, n = 1 or more; None for 1.
        probability: the probability that the fault happens to a request, 0..1, in place of
            `every`.
        seed: makes `probability` select the same requests in each run, and makes random bytes
            the same; 0..2^64 - 1.
        seconds: for "delay" and "trickle", 0.001..86400.
        code: for "exception", 1..255.
        length: a number of bytes, 1..512; for "disconnect" 0..512.
        table: the fault happens only to requests that read or write this table: "coils",
            "discrete_inputs", "holding_registers", "input_registers"; None for all tables.
        address: the fault happens only to requests that touch one of `count` addresses starting
            here, 0..65535; None for all addresses.
        count: 1..65536; None for 1.
        data: for "garbage", 1..512 bytes.
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
        if not isinstance(self.kind, str) or self.kind not in KINDS:
            raise WrongValue("kind", f"must be one of {', '.join(KINDS)}, not {self.kind!r}")
        for name, check in SETTINGS.items():
            self._check_setting(name, check)
        if self.kind == "garbage" and (self.data is None) == (self.length is None):
            raise WrongValue(
                "data", "or length is missing, and garbage needs one of them, not both"
            )
        if self.function is not None:
            integer("function", self.function, 1, 0x7F)
        self._check_where()
        self._check_how_often()

    def _check_setting(self, name: str, check: Callable[[str, object], object]) -> None:
        value = getattr(self, name)
        if value is None:
            if name == KINDS[self.kind]:
                raise WrongValue(name, f"is missing, which {self.kind} needs")
        elif name != KINDS[self.kind] and name not in OPTIONAL.get(self.kind, ()):
            raise WrongValue(name, f"does not apply to {self.kind}")
        elif (self.kind, name) == ("disconnect", "length"):
            integer(name, value, 0, LONGEST)
        else:
            check(name, value)

    def _check_where(self) -> None:
        if self.table is not None:
            _one_of(tuple(TABLES))("table", self.table)
        if self.address is not None:
            integer("address", self.address, 0, TABLE_SIZE - 1)
        if self.count is not None:
            if self.address is None:
                raise WrongValue("count", "cannot be given without address")
            integer("count", self.count, 1, TABLE_SIZE)

    def _check_how_often(self) -> None:
        if self.every is not None:
            integer("every", self.every, 1, 1_000_000_000)
            if self.probability is not None:
                raise WrongValue("probability", "cannot be given together with every")
        if self.probability is not None:
            number("probability", self.probability, 0, 1)
        if self.seed is not None:
            is_random = self.kind == "garbage" and self.length is not None
            if self.probability is None and not is_random:
                raise WrongValue("seed", "cannot be given without probability")
            integer("seed", self.seed, 0, (1 << 64) - 1)

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


# --- switched on and off --------------------------------------------------------------------------


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
    """

    def __init__(self, apply: Callable[[FaultsByUnit], object]) -> None:
        self._apply = apply
        self._given: list[FaultState] = []
        self._switched: list[_Switched] = []
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
        with self._changing:
            made = _Switched(self, unit, faults)
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

    def remove(self, switched: _Switched) -> None:
        """Remove faults that were switched on; may be called any number of times."""
        with self._changing:
            self._change([each for each in self._switched if each is not switched])

    def _change(self, switched: list[_Switched]) -> None:
        self._apply(_that_are_on(self._states(switched, self._given)))
        self._switched = switched

    def _states(self, switched: list[_Switched], given: list[FaultState]) -> list[FaultState]:
        return [state for each in switched for state in each.states] + given


def _that_are_on(states: Iterable[FaultState]) -> FaultsByUnit:
    faults: FaultsByUnit = {}
    for each in states:
        if each.is_on:
            faults.setdefault(each.unit, []).append(each.fault)
    return faults


class _Switched:
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
