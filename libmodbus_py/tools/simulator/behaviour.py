"""
Values that move by themselves: counters, waves, random walks, copies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...protocol.checks import integer, seconds
from ...protocol.checks import number as check_number
from ...protocol.mistakes import WrongValue
from ...protocol.tables import TABLES
from .clockwork import Behaviour, Clockwork, Compute, SimulatedPoint

__all__ = ["BEHAVIOURS", "Copy", "Counter", "RandomWalk", "Sine"]

Number = int | float

# More waves would make a walk longer than any clock runs.
MOST_WAVES = 16

# Reading the last copy computes all copies before it.
MOST_COPIES = 8

# Bounded, so that sums and products are finite, too.
LARGEST = 1e100


def _number(name: str, value: object) -> None:
    check_number(name, value, -LARGEST, LARGEST)


def _check_between(low: Number, high: Number) -> None:
    _number("low", low)
    _number("high", high)
    if low >= high:
        raise WrongValue("high", f"must be above low, which is {low}, not {high}")


def _limits(simulated: SimulatedPoint, **numbers: Number) -> tuple[Number, Number]:
    """Return the limits of a point's values; raise WrongValue for a named number outside."""
    point = simulated.point
    low, high = point.limits
    if low is None or high is None:
        raise ValueError(f"only numbers can move by themselves, not {point.type_name}")
    for name, number in numbers.items():
        if not low <= number <= high:
            raise WrongValue(name, f"must be in {low}..{high} for {point.type_name}, not {number}")
    return low, high


@dataclass(frozen=True)
class Counter:
    """
    Increases (or decreases) by a step at each interval.

    Attributes:
        step: the change at each interval; may be negative.
        interval: seconds from one step to the next, 0.001..86400.
        start: the first value.
        wrap: the value, never reached, at which it restarts from `start`; the excess of the
            last step over it is kept. None is the end of the type; a float then stays at its end.
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
            raise WrongValue("step", "must not be 0")
        if self.wrap is not None:
            _number("wrap", self.wrap)
            if (self.wrap - self.start) * self.step <= 0:
                side = "above" if self.step > 0 else "below"
                raise WrongValue("wrap", f"must be {side} start, which is {self.start}")

    def begin(self, point: SimulatedPoint, others: Clockwork) -> Compute:
        low, high = _limits(point, start=self.start)
        wrap, beyond = self.wrap, point.point.step
        if wrap is None and beyond:
            wrap = high + beyond if self.step > 0 else low - beyond
        elif wrap is not None and not low - (beyond or 1) <= wrap <= high + (beyond or 1):
            span = f"{low - (beyond or 1)}..{high + (beyond or 1)} for {point.point.type_name}"
            raise WrongValue("wrap", f"must be in {span}, not {wrap}")

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

    def begin(self, point: SimulatedPoint, others: Clockwork) -> Compute:
        _limits(point, low=self.low, high=self.high)

        def compute(index: int, now: float) -> Number:
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
            raise WrongValue("step", f"must be {span}, not {self.step}")
        seconds("interval", self.interval)
        if self.seed is not None:
            integer("seed", self.seed, 0, (1 << 64) - 1)

    def begin(self, point: SimulatedPoint, others: Clockwork) -> Compute:
        _limits(point, low=self.low, high=self.high)
        origin = _mixed(list(TABLES).index(point.table), point.span.start)
        low, high, span = self.low, self.high, self.high - self.low
        waves = [self.step * 3 / 8]
        while waves[-1] < span and len(waves) < MOST_WAVES:
            waves.append(4 * waves[-1])

        def compute(index: int, now: float) -> Number:
            seed = _mixed(others.seed, origin) if self.seed is None else self.seed
            way = span / 2 + _way(_mixed(seed, index), int(now / self.interval), waves)
            # It turns round at the limits, as often as necessary.
            return min(max(low + abs((way + span) % (2 * span) - span), low), high)

        return compute


def _way(seed: int, moves: int, waves: list[float]) -> float:
    """
    Return the distance of a walk from its start after a number of moves.

    Random points, joined by straight lines: in the first wave one at each move, and in each
    next one, which is four times as high, one at every 16th of those before. So it gets four
    times as far in 16 times the moves, as a walk of single steps does; no move is longer than
    8/3 of the first wave, and the cost does not depend on the time since the last read.
    """
    way = 0.0
    for wave, height in enumerate(waves):
        at, rest = divmod(moves, 1 << 4 * wave)
        here = _height(seed + wave, at)
        if rest:
            here += (_height(seed + wave, at + 1) - here) * rest / (1 << 4 * wave)
        way += height * here
    return way


def _height(seed: int, at: int) -> float:
    """Return a random number in -1..1; 0 at the start."""
    return _mixed(seed, at) / (1 << 63) - 1 if at else 0.0


def _mixed(seed: int, number: int) -> int:
    """Return a random number of 64 bits made of two numbers: SplitMix64."""
    bits = (seed + (number + 1) * 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF
    bits = (bits ^ bits >> 30) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
    bits = (bits ^ bits >> 27) * 0x94D049BB133111EB & 0xFFFFFFFFFFFFFFFF
    return bits ^ bits >> 31


@dataclass(frozen=True)
class Copy:
    """
    Follows other values: each value of the point is a copy of one of them.

    The number is rounded, and limited to the range of its type. Function 23 reads copies of
    the values before its own write.

    Attributes:
        address: the address of the first of the other values, 0..65535.
        table: the table of the other values: "coils", "discrete_inputs", "holding_registers",
            "input_registers".
        scale: the factor by which the other value is multiplied.
    """

    address: int
    table: str
    scale: Number = 1

    def __post_init__(self) -> None:
        integer("address", self.address, 0, 0xFFFF)
        if self.table not in TABLES:
            raise WrongValue("table", f"must be one of {', '.join(TABLES)}, not {self.table!r}")
        _number("scale", self.scale)

    def begin(self, point: SimulatedPoint, others: Clockwork) -> Compute:
        sources = [self._source(index, others) for index in range(point.point.count)]
        for source, at in sources:
            self._check(source, at, point, others)

        def compute(index: int, now: float) -> Any:
            source, at = sources[index]
            value = others.value(source, at, now)
            return value if source.point.limits[0] is None else value * self.scale

        return compute

    def _check(
        self, source: SimulatedPoint, at: int, own: SimulatedPoint, others: Clockwork
    ) -> None:
        names = source.point.type_name, own.point.type_name
        are_numbers = source.point.limits[0] is not None and own.point.limits[0] is not None
        if not are_numbers and (names[0] != names[1] or self.scale != 1):
            raise ValueError(
                f"{names[0]} cannot be copied to {names[1]}: values that are not"
                " numbers need the same type on both sides, and no scale"
            )
        for _ in range(MOST_COPIES - 1):
            if not isinstance(source.behaviour, Copy):
                return
            source, at = source.behaviour._source(at, others)
        if isinstance(source.behaviour, Copy):
            raise ValueError(f"more than {MOST_COPIES} copies in a row, or a circle of them")

    def _source(self, index: int, others: Clockwork) -> tuple[SimulatedPoint, int]:
        """Return the point that one value of this point follows, and the index in it."""
        first = others.find(self.table, self.address)
        address = self.address + index * (1 if first is None else first.point.read.size)
        source = others.find(self.table, address)
        if source is not None:
            at, rest = divmod(address - source.span.start, source.point.read.size)
            if not rest:
                return source, at
        raise ValueError(f"in {self.table} no value begins at {address}")


BEHAVIOURS: dict[str, Callable[..., Behaviour]] = {
    "counter": Counter,
    "sine": Sine,
    "random_walk": RandomWalk,
    "copy": Copy,
}
"""Name -> class."""
