"""
The requests of an item that is read by itself, and its cells. No I/O.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...protocol import pdu
from ...protocol.errors import ModbusError
from ...protocol.tables import TABLES, checked_values
from .items import Item

__all__ = ["cells_of", "requests_of"]

RECORDS = 121
"""Records of a file that one request reads: the byte count of the answer goes to 245."""


def requests_of(item: Item, max_registers: int) -> list[pdu.Request[Any]]:
    """Return the requests for an item, none of which divides a value; of a queue there is one."""
    if item.table == "fifo_queue":
        if item.count != 1:
            raise ValueError("fifo takes no count: a queue is always read as a whole")
        return [pdu.ReadFifoQueue(item.address)]
    end = item.address + item.count * item.size
    if item.table == "file":
        step = max(RECORDS // item.size, 1) * item.size
        firsts = range(item.address, max(end, item.address + 1), step)
        return [pdu.ReadFileRecords(((item.file, at, min(step, end - at)),)) for at in firsts]
    checked_values(item.address, item.count, item.size)
    rules = TABLES[item.table]
    step = rules.most_read if rules.is_bits else max_registers // item.size * item.size
    if item.kind is not None and not step:
        raise ValueError(
            f"{item.kind.name} takes {item.size} registers, which is more than max_registers,"
            f" {max_registers}"
        )
    return [rules.read(at, min(step, end - at)) for at in range(item.address, end, step)]


def cells_of(item: Item, answers: Sequence[Any]) -> Any:
    """Return the cells of an item in the answers to its requests, or the first error of them."""
    cells: list[int] = []
    for answer in answers:
        if isinstance(answer, ModbusError):
            return answer
        (part,) = answer if item.table == "file" else (answer,)
        cells += map(int, part)
    return cells
