"""
Cells and scales of points, as they are now or after some writes.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping as MappingABC
from typing import Any

from ..maps.point import Point
from .access import Access
from .mapping import Mapping

__all__ = ["NOTHING", "Written", "cells_after", "source_after", "written_by"]

Written = MappingABC[tuple[str, int], Any]
"""Table and address -> the value that is written there."""

NOTHING: Written = {}


def written_by(writes: Iterable[Access]) -> Written:
    """Return what the accesses of a request write."""
    return {
        (write.table, address): value
        for write in writes
        for address, value in enumerate(write.values, write.address)
    }


def cells_after(point: Point, mapping: Mapping, written: Written = NOTHING) -> list[Any]:
    """
    Return the cells that a point will have.

    Raises:
        IndexError: the mapping lacks some of them.
    """
    table, cells = point.table, point.cells
    found: list[Any] = getattr(mapping, table)[cells.start : cells.stop]
    if not written:
        return found
    places = zip(cells, found, strict=True)
    return [written.get((table, address), value) for address, value in places]


def source_after(
    point: Point, points: MappingABC[str, Point], mapping: Mapping, written: Written = NOTHING
) -> Any:
    """
    Return the value that the point of `scale_from` will have; None for no value, or without one.

    Args:
        points: all points of the device, by name.

    Raises:
        IndexError: the mapping lacks cells of it.
        KeyError: there is no such point.
        ValueError: the cells will hold no value of its type.
    """
    if point.scale_from is None:
        return None
    source = points[point.scale_from]
    cells = cells_after(source, mapping, written)
    return source.decode(cells, source=source_after(source, points, mapping, written))
