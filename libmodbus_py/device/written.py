"""
The values of a device that are not its first ones.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from .state_lines import Run

__all__ = ["FirstValues", "changes"]

# Cells that are compared at once.
BLOCK = 64


class FirstValues(NamedTuple):
    """
    The first values of some cells; those of all other cells are 0.

    Attributes:
        table: "coils" and so on, or "file".
        file: the number of the file.
        address: the address of the first value.
        values: the values.
        is_computed: True if the device computes the values: what is there was not written.
    """

    table: str
    file: int
    address: int
    values: array[int]
    is_computed: bool = False


def changes(
    table: str, file: int, start: int, cells: array[int], first: Iterable[FirstValues] = ()
) -> list[Run]:
    """
    Return the runs of values that are not the first ones.

    Args:
        table, file: as of a `Run`.
        start: the address of the first of the cells.
        cells: the present values.
        first: the first values in this table or file.
    """
    before = array(cells.typecode, bytes(len(cells) * cells.itemsize))
    for each in first:
        at = each.address - start
        end = at + len(each.values)
        before[at:end] = cells[at:end] if each.is_computed else array(cells.typecode, each.values)
    return [Run(table, file, start + at, values) for at, values in _runs(cells, before)]


def _runs(cells: array[int], before: array[int]) -> Iterator[tuple[int, list[int]]]:
    """Yield the runs of cells that differ: their index, and their values."""
    run: list[int] = []
    for block in range(0, len(cells), BLOCK):
        if not run and cells[block : block + BLOCK] == before[block : block + BLOCK]:
            continue
        for at in range(block, min(block + BLOCK, len(cells))):
            if cells[at] != before[at]:
                run.append(cells[at])
            elif run:
                yield at - len(run), run
                run = []
    if run:
        yield len(cells) - len(run), run
