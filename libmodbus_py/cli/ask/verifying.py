"""
write --verify: reads back what was written, and compares.
"""

from __future__ import annotations

from typing import Any

from ...client.blocking import Context
from ...protocol import pdu
from .items import Item

__all__ = ["verified"]


def verified(context: Context, request: pdu.Request[Any], item: Item) -> list[str]:
    """
    Read what a request wrote; return what differs, a line for each cell.

    Raises:
        ModbusError: it cannot be read.
    """
    read, written, masks = _expected(request)
    cells = context.execute(read)
    if isinstance(read, pdu.ReadFileRecords):
        cells = cells[0]
    first = item.first + (getattr(request, "address", item.address) - item.address)
    return [
        f"{item.word} {first + at}: wrote {int(wanted)}, reads {int(found)}"
        for at, (wanted, found, mask) in enumerate(zip(written, cells, masks, strict=False))
        if (int(wanted) ^ int(found)) & mask
    ]


def _expected(request: Any) -> tuple[pdu.Request[Any], list[int], list[int]]:
    """Return the request that reads back, the cells that it should read, and their bits."""
    if isinstance(request, pdu.WriteCoil | pdu.WriteCoils):
        values = [request.value] if isinstance(request, pdu.WriteCoil) else [*request.values]
        read: pdu.Request[Any] = pdu.ReadCoils(request.address, len(values))
        return read, [int(each) for each in values], [1] * len(values)
    if isinstance(request, pdu.WriteFileRecords):
        ((file, address, records),) = request.records
        read = pdu.ReadFileRecords(((file, address, len(records)),))
        return read, [*records], [0xFFFF] * len(records)
    if isinstance(request, pdu.MaskWriteRegister):
        # A bit of the AND mask keeps what was there, which is not known.
        read = pdu.ReadHoldingRegisters(request.address, 1)
        return read, [request.or_mask], [~request.and_mask & 0xFFFF]
    is_both = isinstance(request, pdu.ReadWriteRegisters)
    first: int = request.write_address if is_both else request.address
    is_one = isinstance(request, pdu.WriteRegister)
    registers: list[int] = [request.value] if is_one else [*request.values]
    read = pdu.ReadHoldingRegisters(first, len(registers))
    return read, registers, [0xFFFF] * len(registers)
