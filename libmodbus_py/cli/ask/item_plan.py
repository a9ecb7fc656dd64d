"""
The plan of several items, or of points of a map: few requests, and what a device refuses is left
out. No I/O.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from ...maps.items import Borders
from ...maps.plan import Plan
from ...maps.refusals import Refusals, carried_out, reading
from ...protocol.errors import ModbusError
from .items import Item, cells_of, requests_of


class ItemPlan(Plan):
    """A plan whose results are cells; files and queues are read by themselves, behind all else."""

    def __init__(
        self,
        items: Sequence[Item],
        borders: Borders,
        max_registers: int,
        refusals: Refusals | None = None,
    ) -> None:
        others = [at for at, item in enumerate(items) if item.table in ("file", "fifo_queue")]
        self._others = {at: (items[at], requests_of(items[at], max_registers)) for at in others}
        reads = {at: item.read for at, item in enumerate(items) if at not in others}
        super().__init__(reads, borders=borders, max_registers=max_registers)
        self._limits = borders, max_registers
        self._refusals = Refusals() if refusals is None else refusals

    def of(self, items: Sequence[Item]) -> ItemPlan:
        """Return a plan of some of the items, which knows what the device refuses."""
        return ItemPlan(items, *self._limits, self._refusals)

    def cells(self, ask: Callable[[Sequence[Any]], list[Any]], connects: int) -> dict[int, Any]:
        """Return the cells of each item by its index, or the error of the item."""
        steps = reading(self.blocks, self._refusals, time.monotonic(), connects)
        cells: dict[int, Any] = self.results(carried_out(steps, ask))
        answers = iter(
            ask([request for _, requests in self._others.values() for request in requests])
        )
        for at, (item, requests) in self._others.items():
            cells[at] = cells_of(item, [next(answers) for _ in requests])
        return cells

    def _values(self, name: Any, answers: list[Any]) -> Any:
        cells = self._cells(name, answers)
        return cells if isinstance(cells, ModbusError) else [int(cell) for cell in cells]
