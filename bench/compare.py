"""
Two states of the package side by side.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bench.cells import SERVER, Key, before
from bench.report import grid, number

Cell = dict[str, Any]
"""A cell as it stands in the JSON."""

# Ratios below this are marked.
SLOWER = 0.95


def saved(file: Path) -> list[Cell]:
    """Return the cells of a run that was saved."""
    cells: list[Cell] = json.loads(file.read_text())["cells"]
    return cells


def taken_turns(cells: list[Cell]) -> list[Cell]:
    """Return the cells of the state before, under the names of those after."""
    names = {before(cell["name"]): cell["name"] for cell in cells}
    return [cell | {"name": names[cell["name"]]} for cell in cells if cell["name"] in names]


def side_by_side(earlier: list[Cell], later: list[Cell]) -> str:
    """Return a table of the cells that both results have without a failure."""
    was = {key_of(cell): cell for cell in sound(earlier)}
    rows = [row(was[key_of(cell)], cell) for cell in sound(later) if key_of(cell) in was]
    head = ["after / before", "before", "after", "ratio", "us before", "us after", "ratio", ""]
    return grid(head, rows)


def sound(cells: Iterable[Cell]) -> Iterable[Cell]:
    return (cell for cell in cells if not cell["note"] and cell["rate"])


def key_of(cell: Cell) -> Key:
    return Key(cell["section"], cell["variant"], cell["name"])


def row(was: Cell, now: Cell) -> list[str]:
    side = "server_us" if now["section"] == SERVER else "client_us"
    ratio = now["rate"] / was["rate"]
    return [
        ", ".join(key_of(now)),
        number(was["rate"]),
        number(now["rate"]),
        number(ratio, ".2f"),
        number(was[side], ".1f"),
        number(now[side], ".1f"),
        number(now[side] / was[side] if was[side] else None, ".2f"),
        "SLOWER" if ratio < SLOWER else "",
    ]
