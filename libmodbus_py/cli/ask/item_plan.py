"""
The requests that read items, as few as possible, and the cells of each item.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...maps.plan import Plan
from ...protocol import pdu
from ...protocol.errors import ModbusError
from .items import REGISTERS, Item

__all__ = ["ItemPlan"]

Cells = list[int] | ModbusError

# The byte count of an answer goes to 245 (section 6.14), although 251 would fit: longer requests
# are sent only for a count that asks for them.
USUAL_RECORDS = 121


class ItemPlan:
    """
    The requests that read items, as `Plan` has them, and those of files and queues.

    Args:
        items: what is read.

    Attributes:
        plan: reads the items of the four tables.
        requests: those of the other items.

    Raises:
        ValueError: a count or address out of range.
    """

    def __init__(self, items: Sequence[Item]) -> None:
        self._count = len(items)
        self.plan: Plan = _CellPlan(
            {at: item.read for at, item in enumerate(items) if item.table not in OTHERS}
        )
        self._others = {
            at: OTHERS[item.table](item) for at, item in enumerate(items) if item.table in OTHERS
        }
        self.requests: list[pdu.Request[Any]] = [
            each for requests in self._others.values() for each in requests
        ]

    def cells(self, answers: Sequence[Any], others: Sequence[Any]) -> list[Cells]:
        """Return the cells of each item, or the error in place of them."""
        found: dict[int, Cells] = self.plan.results(answers)
        given = iter(others)
        for at, requests in self._others.items():
            found[at] = _joined([next(given) for _ in requests])
        return [found[at] for at in range(self._count)]


class _CellPlan(Plan):
    """A plan whose results are cells; a formatter decodes them."""

    def _decoded(self, name: Any, cells: list[Any]) -> Any:
        return [int(cell) for cell in cells]


def _joined(answers: list[Any]) -> Cells:
    cells: list[int] = []
    for answer in answers:
        if isinstance(answer, ModbusError):
            return answer
        cells += answer[0] if answer and isinstance(answer[0], list) else answer
    return cells


def _of_file(item: Item) -> list[pdu.Request[Any]]:
    """Return requests that divide no value, because its halves could be of different age."""
    most = REGISTERS["file"][0]
    if item.kind is not None and item.size > most:
        raise ValueError(f"{item.kind.name} takes {item.size} registers, and a request {most}")
    if item.count < 1:
        raise ValueError(f"count must be 1 or more, not {item.count}")
    step = max(USUAL_RECORDS // item.size, 1) * item.size if item.cells > most else item.cells
    stop = item.address + item.cells
    return [
        pdu.ReadFileRecords(((item.file, at, min(step, stop - at)),))
        for at in range(item.address, stop, step)
    ]


def _of_queue(item: Item) -> list[pdu.Request[Any]]:
    if item.count != 1:
        raise ValueError("fifo takes no count: a queue is always read as a whole")
    return [pdu.ReadFifoQueue(item.address)]


OTHERS = {"file": _of_file, "fifo_queue": _of_queue}
"""Item outside the four tables -> function that returns its requests."""
