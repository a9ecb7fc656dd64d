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
from collections.abc import Callable, Iterable, Iterator
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

# Computes the values with these indices in their run at a time, in seconds since the start.
Compute = Callable[[range, float], list[Any]]

# With more of them a walk would go on for longer than any clock.
MOST_WAVES = 16

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

    def place(self, indices: range) -> slice:
        """The addresses from the first of these values to the last."""
        width = self.kind.registers
        return slice(self.first + indices[0] * width, self.first + (indices[-1] + 1) * width)


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

        def compute(indices: range, now: float) -> list[Number]:
            way = self.step * int(now / self.interval)
            # Both have the sign of the step.
            value = self.start + (way if wrap is None else way % (wrap - self.start))
            return [value] * len(indices)

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

        def compute(indices: range, now: float) -> list[Number]:
            share = (1 + math.sin(math.tau * now / self.period)) / 2
            return [self.low * (1 - share) + self.high * share] * len(indices)

        return compute


@dataclass(frozen=True)
class RandomWalk:
    """
    Moves by chance, from the middle on, and turns round at its limits.

    Attributes:
        low, high: the lowest and the highest value.
        step: the longest move up or down.
        interval: seconds from one move to the next, 0.001..86400.
        seed: makes every start walk the same way, whenever it is read; each value of a
            run its own.
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
        seed = random.getrandbits(64) if self.seed is None else self.seed
        low, high, span = self.low, self.high, self.high - self.low
        waves = [self.step * 3 / 8]
        while waves[-1] < span and len(waves) < MOST_WAVES:
            waves.append(4 * waves[-1])

        def compute(indices: range, now: float) -> list[Number]:
            moves = int(now / self.interval)
            ways = [span / 2 + _way(_mixed(seed, index), moves, waves) for index in indices]
            # At the limits it turns round, as often as it must.
            turned = [low + abs((way + span) % (2 * span) - span) for way in ways]
            return [min(max(value, low), high) for value in turned]

        return compute


def _way(seed: int, moves: int, waves: list[float]) -> float:
    """
    How far a walk has come after so many moves, counted from the start.

    Random points, joined by straight lines: in the first wave one at each move, and in each
    next one, which is four times as high, one at every 16th of those before. So it gets four
    times as far in 16 times the moves, as a walk of single steps does; no move is longer than
    8/3 of the first wave, and it costs the same however long nobody looked.
    """
    way = 0.0
    for wave, height in enumerate(waves):
        point, rest = divmod(moves, 1 << 4 * wave)
        here = _point(seed, wave, point)
        if rest:
            here += (_point(seed, wave, point + 1) - here) * rest / (1 << 4 * wave)
        way += height * here
    return way


def _point(seed: int, wave: int, at: int) -> float:
    """A number in -1..1; 0 at the start."""
    return _mixed(seed + wave, at) / (1 << 63) - 1 if at else 0.0


def _mixed(seed: int, number: int) -> int:
    """Make a random number of 64 bits of two numbers: SplitMix64."""
    bits = (seed + (number + 1) * 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF
    bits = (bits ^ bits >> 30) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
    bits = (bits ^ bits >> 27) * 0x94D049BB133111EB & 0xFFFFFFFFFFFFFFFF
    return bits ^ bits >> 31


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
        self._check(run, clockwork)

        def compute(indices: range, now: float) -> list[Any]:
            values: list[Any] = []
            for source, places in self._sources(indices, clockwork):
                found = clockwork.values(source, places, now)
                is_number = source.kind.limits is not None
                values += [value * self.scale for value in found] if is_number else found
            return values

        return compute

    def _check(self, run: Run, clockwork: Clockwork) -> None:
        for source, _ in self._sources(range(run.count), clockwork):
            is_number = source.kind.limits is not None and run.kind.limits is not None
            if not is_number and (source.kind.name != run.kind.name or self.scale != 1):
                raise ValueError(
                    f"{source.kind.name} cannot become {run.kind.name}; what is no number is copied"
                    " to its own type, without scale"
                )
        self._check_row(range(run.count), clockwork, 1)

    def _check_row(self, indices: range, clockwork: Clockwork, copies: int) -> None:
        if copies > MOST_COPIES:
            raise ValueError(f"more than {MOST_COPIES} copies in a row, or a circle of them")
        for source, places in self._sources(indices, clockwork):
            if isinstance(source.behaviour, Copy):
                source.behaviour._check_row(places, clockwork, copies + 1)

    def _sources(self, indices: range, clockwork: Clockwork) -> Iterator[tuple[Run, range]]:
        """
        Find the values that some of the run follow: runs, and indices in them.

        Raises:
            ValueError: there is none.
        """
        first = clockwork.find(self.table, self.address)
        width = first.kind.registers if first is not None else 1
        while indices:
            address = self.address + indices[0] * width
            source = clockwork.find(self.table, address)
            if source is None or (address - source.first) % source.kind.registers:
                raise ValueError(f"in {self.table} no value begins at {address}")
            at = (address - source.first) // source.kind.registers
            stride, rest = divmod(indices.step * width, source.kind.registers)
            # In another rhythm than that of these values only the first is sure to be one.
            end = at + 1 if rest else source.count
            places = range(at, end, stride or 1)[: len(indices)]
            yield source, places
            indices = indices[len(places) :]


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
            self._refresh(run, range(first, last + 1), now)
            at += 1

    def values(self, run: Run, indices: range, now: float) -> list[Any]:
        """Give some values, at a time since the start."""
        self._refresh(run, indices, now)
        width = run.kind.registers
        cells = list(map(int, self._table(run)[run.place(indices)]))
        if indices.step > 1:
            starts = range(0, len(cells), width * indices.step)
            cells = [cell for start in starts for cell in cells[start : start + width]]
        try:
            return run.kind.decode_many(cells)
        except ValueError as error:
            raise ServerDeviceFailure(str(error)) from None

    def _refresh(self, run: Run, indices: range, now: float) -> None:
        compute = self._moving.get((run.table, run.first))
        if compute is None:
            return
        values = [_fitting(run.kind, value) for value in compute(indices, now)]
        if indices.step == 1:
            self._table(run)[run.place(indices)] = run.kind.encode_many(values)
        else:
            for index, value in zip(indices, values, strict=True):
                self._table(run)[run.place(range(index, index + 1))] = run.kind.encode(value)

    def _table(self, run: Run) -> Any:
        return getattr(self._mapping, run.table)
