"""
Values that move by themselves: counters, waves, random walks, copies.

A value is computed from the time since the start, in the moment it is read: a
simulator that nobody asks does nothing.
"""

from __future__ import annotations

import math
import random
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from ..device.mapping import Mapping
from ..protocol.checks import integer, seconds
from ..protocol.errors import ServerDeviceFailure
from ..protocol.tables import TABLES
from ..protocol.values import ValueType

__all__ = ["BEHAVIOURS", "BIT", "Behaviour", "Clockwork", "Copy", "Counter", "RandomWalk", "Run"]
__all__ += ["Sine"]

Number = int | float

# Computes the value with an index in its run at a time, in seconds since the start.
Compute = Callable[[int, float], Any]

# A week without a read must not cost a million moves at the next one.
MOST_MOVES = 1000

# Each copy of a copy is computed when the last one is read.
MOST_COPIES = 8

# So that sums and products of them are numbers, too.
LARGEST = 1e100


# --- values --------------------------------------------------------------------------


def _pack_bit(name: str, value: object) -> bytes:
    if value not in (0, 1) or isinstance(value, float):
        raise ValueError(f"{name} must be true or false, not {value!r}")
    return bytes([0, value == 1])


BIT = ValueType("bit", 1, _pack_bit, lambda data: data[1], limits=(0, 1))
"""What coils and discrete inputs hold: True and False, or 1 and 0."""


def _fitting(kind: ValueType, value: Any) -> Any:
    """Give the number of this kind that is nearest; 0 for nan. What is no number fits."""
    if kind.limits is None:
        return value
    if value != value:  # nan; math.isnan cannot take the largest integers
        return 0
    low, high = kind.limits
    nearest = min(max(value, low), high)
    return round(nearest) if isinstance(low, int) else float(nearest)


@dataclass(frozen=True, slots=True)
class Run:
    """
    Values of one kind, one after the other in a table.

    Attributes:
        table: its name, as in `Mapping`.
        first: the address where the first value begins, 0..65535.
        count: how many values.
        kind: what they are.
        behaviour: how they move; None if they do not.
    """

    table: str
    first: int
    count: int
    kind: ValueType
    behaviour: Behaviour | None = None

    @property
    def stop(self) -> int:
        """The address behind the last value."""
        return self.first + self.count * self.kind.registers

    def place(self, index: int) -> slice:
        """The addresses of one value."""
        start = self.first + index * self.kind.registers
        return slice(start, start + self.kind.registers)


# --- behaviours ----------------------------------------------------------------------


class Behaviour(Protocol):
    """How the values of a run move. TypeError, ValueError: an attribute that cannot be."""

    def begin(self, run: Run, clockwork: Clockwork) -> Compute:
        """
        Say how the values of a run are computed.

        Raises:
            ValueError: this does not go with what the run's values are.
        """
        ...


def _number(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{name} must be a number, not {type(value).__name__}")
    if not -LARGEST <= value <= LARGEST:
        raise ValueError(f"{name} must be in {-LARGEST:g}..{LARGEST:g}, not {value}")


def _check_between(low: Number, high: Number) -> None:
    _number("low", low)
    _number("high", high)
    if low >= high:
        raise ValueError(f"high must be above low, which is {low}, not {high}")


def _numeric(run: Run, **numbers: Number) -> tuple[Number, Number]:
    """Give the limits of a run's values; the numbers, which are named, must keep them."""
    if run.kind.limits is None:
        raise ValueError(f"only numbers can move by themselves, not {run.kind.name}")
    low, high = run.kind.limits
    for name, number in numbers.items():
        if not low <= number <= high:
            raise ValueError(f"{name} must be in {low}..{high} for {run.kind.name}, not {number}")
    return run.kind.limits


@dataclass(frozen=True)
class Counter:
    """
    Goes up (or down) by a step at each interval.

    Attributes:
        step: how far; may be negative.
        interval: seconds from one step to the next, 0.001..86400.
        start: the first value.
        wrap: where it begins again at `start`, which it never reaches; what
            the last step goes beyond it is kept. None is the end of the type;
            a float then stays at its end.
    """

    step: Number = 1
    interval: float = 1.0
    start: Number = 0
    wrap: Number | None = None

    def __post_init__(self) -> None:
        _number("step", self.step)
        seconds("interval", self.interval)
        _number("start", self.start)
        if self.step == 0:
            raise ValueError("step must not be 0")
        if self.wrap is not None:
            _number("wrap", self.wrap)
            if (self.wrap - self.start) * self.step <= 0:
                side = "above" if self.step > 0 else "below"
                raise ValueError(f"wrap must be {side} start, which is {self.start}")

    def begin(self, run: Run, clockwork: Clockwork) -> Compute:
        low, high = _numeric(run, start=self.start)
        wrap = self.wrap
        if wrap is None and isinstance(high, int):
            wrap = high + 1 if self.step > 0 else low - 1
        elif wrap is not None and not low - 1 <= wrap <= high + 1:
            span = f"{low - 1}..{high + 1} for {run.kind.name}"
            raise ValueError(f"wrap must be in {span}, not {wrap}")

        def compute(index: int, now: float) -> Number:
            way = self.step * int(now / self.interval)
            # Both have the sign of the step.
            return self.start + (way if wrap is None else way % (wrap - self.start))

        return compute


@dataclass(frozen=True)
class Sine:
    """
    Swings between two values, from the middle upwards at first.

    Attributes:
        low, high: the lowest and the highest value.
        period: seconds from one top to the next, 0.001..86400.
    """

    low: Number
    high: Number
    period: float

    def __post_init__(self) -> None:
        _check_between(self.low, self.high)
        seconds("period", self.period)

    def begin(self, run: Run, clockwork: Clockwork) -> Compute:
        _numeric(run, low=self.low, high=self.high)

        def compute(index: int, now: float) -> float:
            share = (1 + math.sin(math.tau * now / self.period)) / 2
            return self.low * (1 - share) + self.high * share

        return compute


@dataclass(frozen=True)
class RandomWalk:
    """
    Moves by chance, from the middle on, and turns round at its limits.

    Attributes:
        low, high: the lowest and the highest value.
        step: the longest move up or down.
        interval: seconds from one move to the next, 0.001..86400. When nobody
            read for more than 1000 of them, 1000 moves are made.
        seed: makes every start walk the same way; each value of a run its own.
    """

    low: Number
    high: Number
    step: Number
    interval: float = 1.0
    seed: int | None = None

    def __post_init__(self) -> None:
        _check_between(self.low, self.high)
        _number("step", self.step)
        if not 0 < self.step <= self.high - self.low:
            span = f"more than 0 and up to {self.high - self.low}"
            raise ValueError(f"step must be {span}, not {self.step}")
        seconds("interval", self.interval)
        if self.seed is not None:
            integer("seed", self.seed, 0, (1 << 64) - 1)

    def begin(self, run: Run, clockwork: Clockwork) -> Compute:
        _numeric(run, low=self.low, high=self.high)
        walks: dict[int, _Walk] = {}

        def compute(index: int, now: float) -> float:
            if index not in walks:
                walks[index] = _Walk(self, index)
            return walks[index].at(int(now / self.interval))

        return compute


class _Walk:
    """One value on its way."""

    def __init__(self, rules: RandomWalk, index: int) -> None:
        self._rules = rules
        self._random = random.Random(None if rules.seed is None else f"{rules.seed}/{index}")
        self._value = (rules.low + rules.high) / 2
        self._moves = 0

    def at(self, moves: int) -> float:
        """Give the value after so many moves, counted from the start."""
        for _ in range(min(moves - self._moves, MOST_MOVES)):
            self._move()
        self._moves = max(moves, self._moves)
        return self._value

    def _move(self) -> None:
        low, high, step = self._rules.low, self._rules.high, self._rules.step
        value = self._value + self._random.uniform(-step, step)
        # No step is longer than the way between the limits: one turn will do.
        if value > high:
            value = 2 * high - value
        elif value < low:
            value = 2 * low - value
        self._value = min(max(value, low), high)


@dataclass(frozen=True)
class Copy:
    """
    Follows other values, one for each of the run.

    The number is rounded, and stops at the ends of its type. Function 23 reads the
    copies of what was there before it wrote.

    Attributes:
        address: where the first of the other values begins, 0..65535.
        table: where it is: "coils", "discrete_inputs", "holding_registers",
            "input_registers".
        scale: what the other value is multiplied with.
    """

    address: int
    table: str
    scale: Number = 1

    def __post_init__(self) -> None:
        integer("address", self.address, 0, 0xFFFF)
        if self.table not in TABLES:
            raise ValueError(f"table must be one of {', '.join(TABLES)}, not {self.table!r}")
        _number("scale", self.scale)

    def begin(self, run: Run, clockwork: Clockwork) -> Compute:
        for index in range(run.count):
            self._check(run, index, clockwork)

        def compute(index: int, now: float) -> Any:
            source, at = self.source(index, clockwork)
            value = clockwork.value(source, at, now)
            return value if source.kind.limits is None else value * self.scale

        return compute

    def source(self, index: int, clockwork: Clockwork) -> tuple[Run, int]:
        """
        Find the value that one of the run follows: a run, and an index in it.

        Raises:
            ValueError: there is none.
        """
        address = self.address
        first = clockwork.find(self.table, address)
        if first is not None:
            address += index * first.kind.registers
        source = clockwork.find(self.table, address)
        if source is None or (address - source.first) % source.kind.registers:
            raise ValueError(f"in {self.table} no value begins at {address}")
        return source, (address - source.first) // source.kind.registers

    def _check(self, run: Run, index: int, clockwork: Clockwork) -> None:
        source, at = self.source(index, clockwork)
        is_number = source.kind.limits is not None and run.kind.limits is not None
        if not is_number and (source.kind.name != run.kind.name or self.scale != 1):
            raise ValueError(
                f"{source.kind.name} cannot become {run.kind.name}; what is no number is copied"
                " to its own type, without scale"
            )
        for _ in range(MOST_COPIES):
            if not isinstance(source.behaviour, Copy):
                return
            source, at = source.behaviour.source(at, clockwork)
        raise ValueError(f"more than {MOST_COPIES} copies in a row, or a circle of them")


BEHAVIOURS: dict[str, Callable[..., Behaviour]] = {
    "counter": Counter,
    "sine": Sine,
    "random_walk": RandomWalk,
    "copy": Copy,
}
"""Name -> class."""


class Clockwork:
    """
    Keeps the moving values of a mapping up to date: those that are looked at.

    Args:
        mapping: holds the values.
        runs: all values of it, which do not overlap.
        clock: gives seconds; the time of the call is the start.
    """

    def __init__(
        self, mapping: Mapping, runs: Iterable[Run], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._mapping = mapping
        self._clock = clock
        self._start = clock()
        self._runs: dict[str, list[Run]] = {table: [] for table in TABLES}
        for run in sorted(runs, key=lambda run: run.first):
            self._runs[run.table].append(run)
        self._moving: dict[tuple[str, int], Compute] = {}

    def start(self, run: Run) -> None:
        """
        Let the values of a run move, if they have a behaviour.

        Raises:
            ValueError: the behaviour does not go with them.
        """
        if run.behaviour is not None:
            self._moving[run.table, run.first] = run.behaviour.begin(run, self)

    def find(self, table: str, address: int) -> Run | None:
        """Give the run that has an address."""
        runs = self._runs[table]
        at = bisect_right(runs, address, key=lambda run: run.first) - 1
        return runs[at] if at >= 0 and address < runs[at].stop else None

    def refresh(self, table: str, address: int, count: int) -> None:
        """
        Compute what is about to be read.

        Raises:
            ServerDeviceFailure: what is copied is no value of its type.
        """
        if not self._moving:
            return
        now = self._clock() - self._start
        stop = address + count
        runs = self._runs[table]
        at = max(bisect_right(runs, address, key=lambda run: run.first) - 1, 0)
        while at < len(runs) and runs[at].first < stop:
            run = runs[at]
            first = max(address - run.first, 0) // run.kind.registers
            last = (min(stop, run.stop) - run.first - 1) // run.kind.registers
            for index in range(first, last + 1):
                self._refresh(run, index, now)
            at += 1

    def value(self, run: Run, index: int, now: float) -> Any:
        """Give one value, at a time since the start."""
        self._refresh(run, index, now)
        cells = map(int, self._table(run)[run.place(index)])
        try:
            return run.kind.decode(cells)
        except ValueError as error:
            raise ServerDeviceFailure(str(error)) from None

    def _refresh(self, run: Run, index: int, now: float) -> None:
        compute = self._moving.get((run.table, run.first))
        if compute is not None:
            fitting = _fitting(run.kind, compute(index, now))
            self._table(run)[run.place(index)] = run.kind.encode(fitting)

    def _table(self, run: Run) -> Any:
        return getattr(self._mapping, run.table)
