"""
Doubts about a register map that is valid, but may not be what its author meant.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from ....maps.point import Point
from .drafts import Contents

__all__ = ["remarks"]

# Table -> how references to it begin (PI-MBUS-300): a 5-digit one is an address, too.
_REFERENCES = {"holding_registers": range(40001, 50000), "input_registers": range(30001, 40000)}


def remarks(contents: Contents) -> Iterator[str]:
    """Yield each doubt about the content of a file as a line."""
    if contents.ignored:
        yield f"columns that mean nothing here: {', '.join(contents.ignored)}"
    yield from _references(list(contents.points.values()))
    yield from _overlaps(contents)
    for name, point in contents.points.items():
        if point.scale < 0 and point.scale == int(point.scale):
            place = contents.place(name)
            yield f"{place}: {name} is multiplied by {point.scale}: no power of ten is meant?"


def _references(points: list[Point]) -> Iterator[str]:
    for table, span in _REFERENCES.items():
        addresses = [point.address for point in points if point.table == table]
        if addresses and all(address in span for address in addresses):
            yield (
                f"all addresses of {table} are in {span.start}..{span.stop - 1}: if these are"
                f" references, {span.start} for address 0, leave out the column with the table"
            )


def _overlaps(contents: Contents) -> Iterator[str]:
    ordered = sorted(contents.points.values(), key=lambda point: (point.table, point.address))
    for first, second in pairwise(ordered):
        if first.is_part and second.is_part:  # which may be different bits
            continue
        if first.table == second.table and second.address < first.cells.stop:
            place = contents.place(second.name)
            yield f"{place}: {second.name} overlaps {first.name} at {second.table} {second.address}"
