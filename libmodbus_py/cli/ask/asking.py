"""
The requests that read some items, as few as there need be, and whose answers are whose.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...maps.plan import Plan
from ...protocol import pdu
from ...protocol.errors import ModbusError
from .items import REGISTERS, Item

__all__ = ["Question"]

Cells = list[int] | ModbusError

# The answer's byte count goes to 245 (section 6.14), though 251 would fit: only who asks for that
# many in so many words gets them.
USUAL_RECORDS = 121


class Question:
    """
    What to ask for items.

    Attributes:
        items: in their order.
        requests: those of the four tables first, merged where they touch.

    Raises:
        ValueError: a count or address out of range.
    """

    def __init__(self, items: Sequence[Item]) -> None:
        self.items = items
        self._plan = _CellPlan(
            {at: item.read for at, item in enumerate(items) if item.table not in OTHERS}
        )
        self._others = {
            at: OTHERS[item.table](item) for at, item in enumerate(items) if item.table in OTHERS
        }
        self.requests: list[pdu.Request[Any]] = list(self._plan.requests)
        for requests in self._others.values():
            self.requests += requests

    def cells(self, answers: Sequence[Any]) -> list[Cells]:
        """Give the cells of each item, or why there are none."""
        given = iter(answers[len(self._plan.requests) :])
        found: dict[int, Cells] = self._plan.results(answers[: len(self._plan.requests)])
        for at, requests in self._others.items():
            found[at] = _joined([next(given) for _ in requests])
        return [found[at] for at in range(len(self.items))]


class _CellPlan(Plan):
    """Gives cells as they are: how they are shown is decided elsewhere."""

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
    """No value is torn: half of it would be older than the other."""
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
        raise ValueError("fifo has no count: a queue is read whole")
    return [pdu.ReadFifoQueue(item.address)]


OTHERS = {"file": _of_file, "fifo_queue": _of_queue}
"""What is no table of cells -> its requests."""
