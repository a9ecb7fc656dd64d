"""
The points of a simulated device: their initial values, and how these move.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

from ...maps.point import Point, Rights
from ...protocol.mistakes import Path

__all__ = ["Behaviour", "Compute", "DeviceValues", "SimulatedPoint", "fitting"]

# Function that returns the values with these indices in a point, at seconds since the start.
Compute = Callable[[range, float], list[Any]]


@dataclass(frozen=True)
class SimulatedPoint:
    """
    A point of a simulated device, or some records of a file.

    Attributes:
        path: path of the point in the device file.
        point: its place, and the meaning of its cells. For records its table has no meaning, and
            its address is the number of the first record.
        cells: its initial cells; those of one value if all values are the same.
        behaviour: how its values move; None if they do not.
        moved_by: path of the behaviour in the device file.
        file: the number of the file that contains these records; 0 for a table.
        is_named: True if the point has its own name, False if it is named after its place.
        is_mapped: True if it comes from a register map.
    """

    path: Path
    point: Point
    cells: array[int]
    behaviour: Behaviour | None = None
    moved_by: Path = ()
    file: int = 0
    is_named: bool = False
    is_mapped: bool = False

    @cached_property
    def table(self) -> str:
        """Its table, or "file"."""
        return "file" if self.file else self.point.table

    @cached_property
    def first(self) -> int:
        """The address where its first value begins."""
        return self.point.address

    @cached_property
    def stop(self) -> int:
        """The address after the last value."""
        return self.point.cells.stop

    @cached_property
    def size(self) -> int:
        """The cells of one value."""
        return self.point.read.size

    @property
    def access(self) -> Rights | None:
        """The access that clients have: "read", "write" or "read_write"."""
        # A moving value written by a client would be lost at the next read.
        return "read" if self.behaviour else self.point.access

    @property
    def place(self) -> tuple[str, int]:
        """Its table, or "file", and the number of the file."""
        return self.table, self.file

    @property
    def all_cells(self) -> array[int]:
        """The initial content of all its cells."""
        return self.cells * (len(self.point.cells) // len(self.cells))

    @property
    def identity(self) -> tuple[object, ...]:
        """The key by which points compare equal that have the same meaning and initial values."""
        point = self.point
        scale = (point.scale, point.offset, point.scale_from, point.scale_as)
        names = (point.missing, point.bit, point.byte, str(point.states), str(point.bits))
        meaning = (point.type, point.order, point.time_zone, *scale, *names)
        moves = type(self.behaviour).__name__
        return (*self.place, self.first, self.stop, meaning, moves, self.cells.tobytes())

    def slice_of(self, indices: range) -> slice:
        """Return the addresses from the first of some values to the last."""
        return slice(
            self.first + indices[0] * self.size, self.first + (indices[-1] + 1) * self.size
        )


def fitting(point: Point, value: Any) -> Any:
    """Return the value of a point that is nearest to a number; 0 for nan."""
    low, high = point.limits
    if low is None or high is None:
        return value
    if value != value:  # nan; math.isnan cannot take the largest integers
        return 0
    nearest = min(max(value, low), high)
    is_scaled = (point.scale, point.offset) != (1, 0)
    return round(nearest) if point.step and not is_scaled else nearest


class DeviceValues(Protocol):
    """All values of a device, for points that follow others; `Clockwork` is one."""

    @property
    def seed(self) -> int:
        """The seed of random moves without a seed of their own."""
        ...

    def find(self, table: str, address: int) -> SimulatedPoint | None:
        """Return the point that has an address."""
        ...

    def values(self, point: SimulatedPoint, indices: range, now: float) -> list[Any]:
        """Return some values of a point, at a time since the start."""
        ...


class Behaviour(Protocol):
    """The movement of a point's values. TypeError, ValueError: an attribute is wrong."""

    def begin(self, point: SimulatedPoint, others: DeviceValues) -> Compute:
        """
        Return the function that computes the values of a point.

        Raises:
            ValueError: the values of the point cannot move this way.
        """
        ...
