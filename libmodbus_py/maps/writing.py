"""
Few requests that write values to points; all values are checked before the first is sent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ..protocol import pdu
from ..protocol.tables import TABLES
from .point import Point

__all__ = ["encoded_changes", "write_requests"]

# Table -> the requests that write one cell, and several.
_WRITES: dict[str, tuple[Any, Any]] = {
    "coils": (pdu.WriteCoil, pdu.WriteCoils),
    "holding_registers": (pdu.WriteRegister, pdu.WriteRegisters),
}


@dataclass
class _Run:
    """Consecutive cells that one request writes."""

    table: str
    address: int
    cells: list[Any]

    @property
    def stop(self) -> int:
        return self.address + len(self.cells)

    def takes(self, other: _Run) -> bool:
        most = TABLES[self.table].most_written
        touches = (other.table, other.address) == (self.table, self.stop)
        return touches and len(self.cells) + len(other.cells) <= most

    def request(self, multiple: bool) -> pdu.Request[None]:
        one, many = _WRITES[self.table]
        if len(self.cells) == 1 and not multiple:
            return one(self.address, self.cells[0])  # type: ignore[no-any-return]
        return many(self.address, self.cells)  # type: ignore[no-any-return]


def write_requests(changes: Iterable[tuple[Point, Any]], multiple: bool) -> list[pdu.Request[None]]:
    """
    Return the requests that write values to points, in their order.

    Points that lie directly behind each other are written with one request.

    Raises:
        TypeError, ValueError: a value does not fit its point or a request, or points share cells.
            The message names the points.
    """
    runs: list[_Run] = []
    for point, cells in encoded_changes(changes):
        for piece in _pieces(point, cells):
            if runs and runs[-1].takes(piece):
                runs[-1].cells += piece.cells
            else:
                runs.append(piece)
    return [run.request(multiple) for run in runs]


def encoded_changes(changes: Iterable[tuple[Point, Any]]) -> list[tuple[Point, list[Any]]]:
    """
    Return points with the cells of their new values.

    Raises:
        TypeError, ValueError: a value does not fit its point, or points share cells. The message
            names the points.
    """
    encoded = [(point, point.encode(value)) for point, value in changes]
    _check_overlaps([point for point, _ in encoded])
    return encoded


def _pieces(point: Point, cells: list[Any]) -> Iterator[_Run]:
    """Yield cells that must stay together: a whole point if one request holds it, else a value."""
    most, size = TABLES[point.table].most_written, point.read.size
    if size > most:
        raise ValueError(
            f"{point.name}: {point.type} takes {size} registers, a write at most {most}"
        )
    step = len(cells) if len(cells) <= most else size
    for at in range(0, len(cells), step):
        yield _Run(point.table, point.address + at, cells[at : at + step])


def _check_overlaps(points: list[Point]) -> None:
    ordered = sorted(points, key=lambda point: (point.table, point.address))
    for first, second in pairwise(ordered):
        if first.table == second.table and second.address < first.cells.stop:
            raise ValueError(
                f"{first.name} and {second.name} share {first.table} {second.address}:"
                " write one of them"
            )
