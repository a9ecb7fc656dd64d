"""
The points of simulated devices, and the values of those that move.

A moving value is computed from the time since the start when it is read, so an idle simulator takes
no processor time.
"""

from __future__ import annotations

import math
import random
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ...device.mapping import Mapping
from ...maps.meaning import NoValue
from ...maps.point import Point
from ...protocol.checks import integer, number, seconds
from ...protocol.errors import ServerDeviceFailure
from ...protocol.mistakes import Path, WrongValue, inside
from ...protocol.tables import TABLES

Compute = Callable[[int, float], Any]
"""Function that returns the value with this index in a point, at seconds since the start."""


@dataclass(frozen=True)
class SimulatedPoint:
    """A point of a simulated device, or some records of a file."""

    path: Path  # in the device file
    point: Point  # of records, its address is the first one, and its table has no meaning
    value: Any = None  # at first; None for zeros
    behaviour: tuple[str, dict[str, Any]] | None = None  # key of `BEHAVIOURS`, and arguments
    source: Path = ()  # of the key with the value or the behaviour
    file: int = 0  # the number of the file that contains these records
    is_mapped: bool = False  # the point comes from a register map
    cells: tuple[int, ...] = ()  # with its first value, and those of others that share them

    @property
    def table(self) -> str:
        """Its table, or "file"."""
        return "file" if self.file else self.point.table

    @property
    def area(self) -> tuple[str, int]:
        """Its table, or "file", and the number of the file."""
        return self.table, self.file

    @property
    def span(self) -> range:
        """The addresses of all its cells, or records."""
        return self.point.cells

    def slice_of(self, index: int) -> slice:
        first = self.span.start + index * self.point.read.size
        return slice(first, first + self.point.read.size)

    @property
    def identity(self) -> tuple[object, ...]:
        """The key by which points compare equal that have the same meaning and initial values."""
        point = self.point
        scale = (point.scale, point.offset, point.scale_from, point.scale_as)
        names = (point.missing, point.bit, point.byte, str(point.states), str(point.bits))
        meaning = (point.type, point.order, point.time_zone, *scale, *names)
        return (self.area, self.span, meaning, self.behaviour and self.behaviour[0], self.cells)


class Movements:
    """Keeps the moving values of a mapping up to date, as far as they are read."""

    def __init__(
        self,
        mapping: Mapping,
        points: Iterable[SimulatedPoint],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._mapping = mapping
        self._clock = clock
        self._start = clock()
        self.seed: int = random.getrandbits(64)  # of random moves without a seed of their own
        self._points: dict[str, list[SimulatedPoint]] = {table: [] for table in TABLES}
        for point in sorted(points, key=lambda point: point.span.start):
            self._points[point.table].append(point)
        self._moving: dict[tuple[str, range], tuple[SimulatedPoint, Compute]] = {}
        self._holds: set[tuple[str, range]] = set()
        for point in [point for points in self._points.values() for point in points]:
            if point.behaviour is not None:
                with inside(*point.source):
                    if (source := point.point.scale_from) is not None:
                        raise ValueError(f"a point that {source} scales does not move")
                    kind, settings = point.behaviour
                    compute = BEHAVIOURS[kind](point, self, **settings)
                    self._moving[point.table, point.span] = point, compute

    def take_state_of(self, before: Movements) -> None:
        """Continue with the start, the seed and the held values of those before."""
        self._start, self.seed = before._start, before.seed
        self._holds = before._holds & self._moving.keys()

    def find(self, table: str, address: int) -> SimulatedPoint | None:
        points = self._points[table]
        at = bisect_right(points, address, key=lambda point: point.span.start)
        return next((point for point in points[at - 1 :: -1] if at and address in point.span), None)

    def _with(self, table: str, cells: range) -> set[tuple[str, range]]:
        """Return the keys of the moving points that have some of these cells."""
        return {
            (each_table, span)
            for each_table, span in self._moving
            if each_table == table and span.start < cells.stop and cells.start < span.stop
        }

    def movement(self, table: str, cells: range) -> bool | None:
        """Return True if a value with some of these cells moves, False if all are held, or None."""
        points = self._with(table, cells)
        return bool(points - self._holds) if points else None

    def hold(self, table: str, cells: range, *, is_on: bool) -> None:
        """Hold the moving values that have some of these cells, or let them move again."""
        if is_on:
            self._holds |= self._with(table, cells)
        else:
            self._holds -= self._with(table, cells)

    def refresh(self, table: str, address: int, count: int) -> None:
        """Compute the values that are about to be read."""
        now, stop = self._clock() - self._start, address + count
        for key in self._with(table, range(address, stop)):
            point, _ = self._moving[key]
            size, start = point.point.read.size, point.span.start
            first = max(address - start, 0) // size
            for index in range(first, (min(stop, point.span.stop) - start - 1) // size + 1):
                self._refresh(point, index, now)

    def value(self, point: SimulatedPoint, index: int, now: float) -> Any:
        """Return one value of a point, nan for none, or raise ServerDeviceFailure."""
        self._refresh(point, index, now)
        cells = getattr(self._mapping, point.table)[point.slice_of(index)]
        numbers = list(map(int, cells))
        (raw,) = point.point.meaning.raws_in(numbers)
        if isinstance(raw, NoValue):
            raise ServerDeviceFailure(str(raw))
        (value,) = point.point.values_in(numbers)
        return math.nan if value is None else value

    def _refresh(self, point: SimulatedPoint, index: int, now: float) -> None:
        key = point.table, point.span
        if key in self._moving and key not in self._holds:
            value = _nearest(point.point, self._moving[key][1](index, now))
            table = getattr(self._mapping, point.table)
            table[point.slice_of(index)] = point.point.cells_for([value])


def _nearest(point: Point, value: Any) -> Any:
    """Return the value of a point that is nearest to a number; 0 for nan."""
    low, high = point.limits
    if low is None or high is None:
        return value
    if value != value:  # nan; math.isnan cannot take the largest integers
        return 0
    nearest = min(max(value, low), high)
    is_scaled = (point.scale, point.offset) != (1, 0)
    return round(nearest) if point.step and not is_scaled else nearest


# --- how values move -------------------------------------------------------------------------

Number = int | float

# Bounded, so that sums and products are finite, too.
LARGEST = 1e100


def _limits(simulated_point: SimulatedPoint, **numbers: Number) -> tuple[Number, Number]:
    """Return the limits of a point's values; raise WrongValue for a named number outside."""
    point = simulated_point.point
    low, high = point.limits
    if low is None or high is None:
        raise ValueError(f"only numbers can move by themselves, not {point.type_name}")
    for name, limit in numbers.items():
        number(name, limit, -LARGEST, LARGEST)
        if not low <= limit <= high:
            raise WrongValue(name, f"must be in {low}..{high} for {point.type_name}, not {limit}")
    return low, high


def _check_span(point: SimulatedPoint, low: Number, high: Number) -> None:
    _limits(point, low=low, high=high)
    if low >= high:
        raise WrongValue("high", f"must be above low, which is {low}, not {high}")


def counter(
    point: SimulatedPoint,
    others: Movements,
    step: Number = 1,
    interval: float = 1.0,
    start: Number = 0,
    wrap: Number | None = None,
) -> Compute:
    """Count by a step at each interval of seconds, up to `wrap`, or to the end of the type."""
    number("step", step, -LARGEST, LARGEST)
    seconds("interval", interval)
    if step == 0:
        raise WrongValue("step", "must not be 0")
    low, high = _limits(point, start=start)
    low, high = low - (point.point.step or 1), high + (point.point.step or 1)
    if wrap is None and point.point.step:
        wrap = high if step > 0 else low
    if wrap is not None:
        number("wrap", wrap, -LARGEST, LARGEST)
        first, last = (start, high) if step > 0 else (low, start)
        if not first <= wrap <= last or wrap == start:
            raise WrongValue("wrap", f"must be in {first}..{last} but not {start}, not {wrap}")

    def compute(index: int, now: float) -> Number:
        way = step * int(now / interval)
        # Both have the sign of the step.
        return start + (way if wrap is None else way % (wrap - start))

    return compute


def sine(
    point: SimulatedPoint, others: Movements, low: Number, high: Number, period: float
) -> Compute:
    """Swing between two values in a period of seconds, from the middle upwards at first."""
    _check_span(point, low, high)
    seconds("period", period)

    def compute(index: int, now: float) -> Number:
        share = (1 + math.sin(math.tau * now / period)) / 2
        return low * (1 - share) + high * share

    return compute


def random_walk(
    point: SimulatedPoint,
    others: Movements,
    low: Number,
    high: Number,
    step: Number,
    interval: float = 1.0,
    seed: int | None = None,
) -> Compute:
    """Move by chance, by at most a step in each interval of seconds."""
    _check_span(point, low, high)
    number("step", step, -LARGEST, LARGEST)
    if not 0 < step <= high - low:
        raise WrongValue("step", f"must be more than 0 and up to {high - low}, not {step}")
    seconds("interval", interval)
    if seed is not None:
        integer("seed", seed, 0, (1 << 64) - 1)
    origin = _mixed(list(TABLES).index(point.table), point.span.start)
    middle, deviation = low / 2 + high / 2, step / 4
    reach = (high - low) / 2 - deviation
    moves_of_line = math.ceil(min(4 * reach / step, 1e15)) or 1

    # In straight lines from one random value to the next, with a random deviation at each move;
    # each makes up half of the step. So a value depends on nothing but the time and the seed.
    def compute(index: int, now: float) -> Number:
        own = _mixed(_mixed(others.seed, origin) if seed is None else seed, index)
        move = int(now / interval)
        line, step = divmod(move, moves_of_line)
        here, there = _share(own, line), _share(own, line + 1)
        way = here + (there - here) * step / moves_of_line
        return min(max(middle + reach * way + deviation * _share(own + 1, move), low), high)

    return compute


def _share(seed: int, at: int) -> float:
    """Return a random number in -1..1; 0 at the start."""
    return _mixed(seed, at) / (1 << 63) - 1 if at else 0.0


def _mixed(seed: int, number: int) -> int:
    """Return a random number of 64 bits made of two numbers: SplitMix64."""
    bits = (seed + (number + 1) * 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF
    bits = (bits ^ bits >> 30) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
    bits = (bits ^ bits >> 27) * 0x94D049BB133111EB & 0xFFFFFFFFFFFFFFFF
    return bits ^ bits >> 31


def copy(
    point: SimulatedPoint, others: Movements, address: int, table: str, scale: Number = 1
) -> Compute:
    """Follow the values from an address on, each times `scale`, in the range of the type."""
    number("scale", scale, -LARGEST, LARGEST)
    sources = [_source(others, index, address, table) for index in range(point.point.count)]
    own = point.point
    for source, _ in sources:
        names = source.point.type_name, own.type_name
        are_numbers = source.point.limits[0] is not None and own.limits[0] is not None
        if not are_numbers and (names[0] != names[1] or scale != 1):
            raise ValueError(
                f"{names[0]} cannot be copied to {names[1]}: values that are not"
                " numbers need the same type on both sides, and no scale"
            )
        if source.behaviour is not None and source.behaviour[0] == "copy":
            raise ValueError("a copy cannot follow another copy")

    def compute(index: int, now: float) -> Any:
        source, at = sources[index]
        value = others.value(source, at, now)
        return value if source.point.limits[0] is None else value * scale

    return compute


def _source(others: Movements, index: int, address: int, table: str) -> tuple[SimulatedPoint, int]:
    """Return the point that one value of a copy follows, and the index in it."""
    integer("address", address, 0, 0xFFFF)
    if table not in TABLES:
        raise WrongValue("table", f"must be one of {', '.join(TABLES)}, not {table!r}")
    first = others.find(table, address)
    address += index * (1 if first is None else first.point.read.size)
    source = others.find(table, address)
    if source is not None:
        at, rest = divmod(address - source.span.start, source.point.read.size)
        if not rest:
            return source, at
    raise ValueError(f"in {table} no value begins at {address}")


BEHAVIOURS: dict[str, Callable[..., Compute]] = {
    "counter": counter,
    "sine": sine,
    "random_walk": random_walk,
    "copy": copy,
}
"""The key of a movement -> begins it; its keys are arguments behind point and movements."""
