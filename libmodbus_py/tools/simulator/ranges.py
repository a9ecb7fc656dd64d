"""
Ranges of a device file: where they lie, what is in them, and what they are called.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from ...maps.point import Point
from ...protocol.pdu import RECORDS_PER_FILE
from ...protocol.tables import TABLES
from ...protocol.values import ValueType, value_type
from ..files.maps.drafts import MAX_POINTS
from .checks import DeviceFileError, checked, inside
from .keys import CONTENT, DEFAULTS, MOVES, NAMES, RANGES, SCALE, TYPE
from .runs import BIT, Kind, Run, ScaledType

__all__ = ["Budget", "Range", "check_overlaps", "defaults_of", "ranges"]

# Eight units with full tables that are not 0; more would take seconds and memory to write.
MAX_CELLS = 1 << 19

# How many cells a value with a scale counts as: it is computed exactly.
SCALED_CELLS = 16


class Budget:
    """What cells and points a file may still have."""

    def __init__(self) -> None:
        self._cells = MAX_CELLS
        self._points = MAX_POINTS

    def spend(self, where: str, cells: int) -> None:
        self._cells -= cells
        if self._cells < 0:
            raise DeviceFileError(f"{where}: more than {MAX_CELLS} cells in one file")

    def spend_points(self, where: str, points: int) -> None:
        self._points -= points
        if self._points < 0:
            raise DeviceFileError(f"{where}: more than {MAX_POINTS} points in one file")


@dataclass(frozen=True)
class Range:
    """
    One range, as given: where in the device file, and what. `cells` may be repeated.

    Attributes:
        told: what its point has besides its place, as keys of `Point`.
        is_named: whether it has a name of its own.
        is_mapped: whether it is of a register map, which has its points.
    """

    where: str
    run: Run
    cells: array[int]
    access: str
    behaviour: str = ""
    file: int = 0
    told: dict[str, Any] = field(default_factory=dict)
    is_mapped: bool = False

    @property
    def place(self) -> tuple[str, int]:
        return self.run.table, self.file

    @property
    def all_cells(self) -> array[int]:
        return self.cells * ((self.run.stop - self.run.first) // len(self.cells))

    @property
    def identity(self) -> tuple[object, ...]:
        """What is the same as long as it means the same, and begins with the same."""
        run = self.run
        kind = (run.kind.name, run.kind.order, run.kind.limits)
        return (*self.place, run.first, run.stop, kind, self.behaviour, self.cells.tobytes())

    def point(self, name: str) -> Point:
        """
        Give the point that it is, under its own name or this one.

        Raises:
            TypeError, ValueError: it can be none.
        """
        run = self.run
        can_be_written = TABLES[run.table].most_written > 0
        access = self.access if can_be_written else "read"
        place = {"table": run.table, "address": run.first, "count": run.count, "access": access}
        return Point(**{"name": name, **place, **self.told})


def ranges(
    where: str, table: str, unit: Mapping[str, Any], defaults: dict[str, Any], budget: Budget
) -> list[Range]:
    """Make the ranges of one table of a unit."""
    return [
        _range(f"{where}{table}[{at}]", table, given, defaults, budget)
        for at, given in enumerate(unit.get(table, ()))
    ]


def check_overlaps(found: Iterable[Range]) -> None:
    """
    Raises:
        DeviceFileError: two of them share something.
    """
    in_order = sorted(found, key=lambda each: (*each.place, each.run.first))
    for before, after in pairwise(in_order):
        if before.place == after.place and after.run.first < before.run.stop:
            taken = f"{before.where} ({before.run.first}..{before.run.stop - 1})"
            raise DeviceFileError(f"{after.where} begins at {after.run.first}, within {taken}")


def defaults_of(where: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Check what ranges have unless they say something else."""
    found = checked(f"{where}defaults.", given.get("defaults", {}), DEFAULTS)
    options = {key: value for key, value in found.items() if key in TYPE and key != "type"}
    with inside(f"{where}defaults."):
        value_type(found.get("type", "string:1"), **options)
    return found


def _range(
    where: str, table: str, raw: dict[str, object], defaults: dict[str, Any], budget: Budget
) -> Range:
    needs = ("number", "record") if table == "file" else ("address",)
    given = checked(f"{where}.", raw, RANGES[table], needs)
    sources = [key for key in given if key in CONTENT or key in MOVES]
    if len(sources) > 1:
        raise DeviceFileError(f"{where}.{sources[1]} means nothing beside {sources[0]}")
    behaviour = sources[0] if sources and sources[0] in MOVES else ""
    if behaviour and given.get("access", "read") != "read":
        # What a client wrote would be gone at the next read.
        raise DeviceFileError(f"{where}.access must be read for what moves by itself")
    given = _fitting(table, behaviour, defaults) | given
    kind = _kind(where, table, given)
    first = given["record" if table == "file" else "address"]
    run = Run(table, first, _count(where, given), kind, given[behaviour] if behaviour else None)
    end = RECORDS_PER_FILE if table == "file" else 0x10000
    if run.stop > end:
        raise DeviceFileError(f"{where} ends at {run.stop - 1}, after {end - 1}")
    if isinstance(kind, ScaledType):
        budget.spend(where, SCALED_CELLS * len(given.get("values", "1")))
    cells = array("H", _cells(where, given, kind))
    access = given.get("access", "read" if behaviour else "read_write")
    told = {key: value for key, value in given.items() if key in NAMES | SCALE | TYPE}
    found = Range(where, run, cells, access, behaviour, given.get("number", 0), told)
    if any(key in given for key in NAMES | SCALE):
        budget.spend_points(where, 1)
        with inside(f"{where}."):
            found.point("unnamed")
    return found


def _fitting(table: str, behaviour: str, defaults: dict[str, Any]) -> dict[str, Any]:
    """Those that a range of this table can have."""
    without = {"access"} if behaviour else set()
    return {key: value for key, value in defaults.items() if key in RANGES[table].keys() - without}


def _kind(where: str, table: str, given: dict[str, Any]) -> Kind:
    if table in ("coils", "discrete_inputs"):
        return BIT
    name, *_ = [key for key in given if key in TYPE] or [""]
    if name and "type" not in given:
        raise DeviceFileError(f"{where}.{name} means nothing without type")
    options = {key: value for key, value in given.items() if key in TYPE and key != "type"}
    with inside(f"{where}."):
        kind = value_type(given.get("type", "uint16"), **options)
        if given.get("scale", 1) == 1 and given.get("offset", 0) == 0:
            return kind
        return ScaledType.of(kind, given.get("scale", 1), given.get("offset", 0))


def _count(where: str, given: dict[str, Any]) -> int:
    """How many values there are."""
    if "values" not in given:
        return int(given.get("count", 1))
    if "count" in given:
        raise DeviceFileError(f"{where}.count means nothing beside values")
    if not given["values"]:
        raise DeviceFileError(f"{where}.values must hold at least one")
    return len(given["values"])


def _cells(where: str, given: dict[str, Any], kind: Kind) -> list[int]:
    """What they are at first; one of them, if all are the same."""
    if "values" in given:
        cells: list[int] = []
        for at, value in enumerate(given["values"]):
            cells += _encoded(f"{where}.values[{at}]", kind, value)
        return cells
    if "value" in given:
        return _encoded(f"{where}.value", kind, given["value"])
    is_text = isinstance(kind, ValueType) and kind.is_text
    return kind.encode("") if is_text else [0] * kind.registers


def _encoded(where: str, kind: Kind, value: object) -> list[int]:
    try:
        return kind.encode(value)
    except (TypeError, ValueError) as error:
        # The message begins with the name that the value has there.
        raise DeviceFileError(f"{where}{str(error).removeprefix('value')}") from None
