"""
The cells that masters read and write, by name: their values with a register map, or a new map.

A point is decoded when its last cell is read or written. Its other cells, and the point that
scales it, have the values that were heard last; before all its cells were heard it has none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ...device.access import touched
from ...device.mapping import Mapping
from ...maps.meaning import DecodedValue
from ...maps.point import Point
from ...maps.register_map import AnyMap, RegisterMap, map_of
from ...protocol import pdu
from ...protocol.mistakes import named_parameters
from ...protocol.tables import TABLES
from .transaction import Transaction

HEARD = ("answered", "late", "broadcast")
"""The kinds of transactions whose cells have values, if there is no error."""


class NamedValue(NamedTuple):
    """
    A value of a point that a master read or wrote.

    Attributes:
        time: the time of the transaction, in seconds since the epoch.
        unit: 0..255.
        name: the name of the point.
        value: as `Point.decode` returns it; None if there is none.
        units: the units of the value, such as "V".
        is_written: True if the master wrote it.
        quality, reason: those of `Point.judge`.
    """

    time: float
    unit: int
    name: str
    value: Any
    units: str
    is_written: bool
    quality: str
    reason: str


class _Cells(NamedTuple):
    """Cells of one table that a request reads or writes; without values if these are unknown."""

    table: str
    addresses: range
    values: Sequence[Any]
    is_written: bool


def _cells_of(transaction: Transaction, mapping: Mapping | None = None) -> Iterator[_Cells]:
    """Yield the cells of a request; `mapping` has the register that a masked write changes."""
    is_heard = transaction.error is None and transaction.kind in HEARD
    is_masked = isinstance(transaction.request, pdu.MaskWriteRegister)
    accesses = touched(transaction.request, mapping=mapping)
    for access in accesses.writes:
        values = access.values if is_heard and not (is_masked and mapping is None) else ()
        addresses = range(access.address, access.address + access.count)
        yield _Cells(access.table, addresses, values, True)
    for access in accesses.reads:
        values = (is_heard and transaction.response) or ()
        addresses = range(access.address, access.address + access.count)
        yield _Cells(access.table, addresses, values, False)


class MapDecoder:
    """
    Decodes the points of a register map in the transactions of a `Listener`.

    A point is decoded when its last cell is read or written. Its other cells, and the point that
    scales it, have the values that were heard last; as long as a cell was never heard, the point
    is left out. Values of a write are those of the request, once the unit has confirmed it, or of
    a broadcast.

    Args:
        map: a `RegisterMap`, or the path of its file.

    Raises:
        TypeError: `map` is neither.
        MapError: as for `load_map`.
    """

    @named_parameters
    def __init__(self, map: AnyMap) -> None:
        self.map: RegisterMap = map_of(map)
        self._points_at_end: dict[tuple[str, int], list[Point]] = {}
        self._point_cells: set[tuple[str, int]] = set()
        for point in self.map.values():
            self._points_at_end.setdefault((point.table, point.cells[-1]), []).append(point)
            self._point_cells.update((point.table, address) for address in point.cells)
        # Unit, table and address -> the value that was heard last.
        self._last_values: dict[tuple[int, str, int], Any] = {}

    def decode(self, transaction: Transaction) -> list[NamedValue]:
        """Return the values that a transaction completes, those that it writes first."""
        unit, values = transaction.unit or 0, list[NamedValue]()
        for cells in _cells_of(transaction, self._masked(unit, transaction.request)):
            pairs = list(zip(cells.addresses, cells.values, strict=False))
            for address, value in pairs:
                if (cells.table, address) in self._point_cells:
                    self._last_values[unit, cells.table, address] = value
            for address, _ in pairs:
                for point in self._points_at_end.get((cells.table, address), ()):
                    judgement = self._judged(unit, point)
                    if judgement is None or not (cells.is_written or point.is_readable):
                        continue
                    whose = transaction.time, unit, point.name, judgement.value, point.units
                    values.append(NamedValue(*whose, cells.is_written, *judgement[1:]))
        return values

    def _masked(self, unit: int, request: object) -> Mapping | None:
        """Return the register that a masked write changes; None if it is not known."""
        if not isinstance(request, pdu.MaskWriteRegister):
            return None
        before = self._last_values.get((unit, "holding_registers", request.address))
        return None if before is None else Mapping(holding_registers={request.address: [before]})

    def _judged(self, unit: int, point: Point) -> DecodedValue | None:
        cells = [self._last_values.get((unit, point.table, address)) for address in point.cells]
        if None in cells:
            return None
        source = None if point.scale_from is None else self.map[point.scale_from]
        scale = None if source is None else self._judged(unit, source)
        if TABLES[point.table].is_bits:
            cells = [bool(cell) for cell in cells]
        return point.judge(cells, source=None if scale is None else scale.value)


@dataclass
class _Cell:
    """The use that masters make of a cell, and the bounds of its values."""

    is_read: bool = False
    is_written: bool = False
    lowest: int | None = None
    highest: int | None = None

    def add_value(self, value: int) -> None:
        self.lowest = value if self.lowest is None else min(self.lowest, value)
        self.highest = value if self.highest is None else max(self.highest, value)

    @property
    def rights(self) -> Any:
        return "_".join(["read"] * self.is_read + ["write"] * self.is_written)

    @property
    def description(self) -> str:
        if self.lowest is None:
            return "no value heard"
        return f"{self.lowest}" if self.lowest == self.highest else f"{self.lowest}..{self.highest}"


class LearnedMap:
    """The cells that masters read and write, also those that no unit answers."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, str, int], _Cell] = {}

    def add_transaction(self, transaction: Transaction) -> None:
        for table, addresses, values, is_written in _cells_of(transaction):
            if table not in TABLES:
                continue
            for address in addresses:
                cell = self._cells.setdefault((transaction.unit or 0, table, address), _Cell())
                cell.is_written |= is_written
                cell.is_read |= not is_written
            for address, value in zip(addresses, values, strict=False):
                self._cells[transaction.unit or 0, table, address].add_value(int(value))

    def points(self) -> list[Point]:
        """Return a point for each cell, whose group is its unit; its description, its values."""
        return [
            Point(
                f"unit_{unit}_{table}_{address}",
                table,  # type: ignore[arg-type]
                address,
                access=cell.rights,
                group=f"unit {unit}",
                description=cell.description,
            )
            for (unit, table, address), cell in sorted(self._cells.items())
        ]
