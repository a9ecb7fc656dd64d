"""
What a request touches: for hooks, which see tables and values instead of function codes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..protocol import pdu
from .mapping import Mapping

__all__ = ["ACCESSES", "Access", "Touched"]


@dataclass(frozen=True, slots=True)
class Access:
    """
    One run of items that a client reads or writes.

    Attributes:
        table: "coils", "discrete_inputs", "holding_registers", "input_registers",
            "fifo" or "file".
        address: the first one, 0-based; the first record of a file.
        count: how many.
        values: what is to be written, or was; empty for reads.
        file: the number of the file, else 0.
        unit: who was asked.
        peer: who asks: "192.0.2.7:51234", or the serial port.
        role: what their certificate says of them; None for nothing, or without TLS.
    """

    table: str
    address: int
    count: int
    values: tuple[Any, ...] = ()
    file: int = 0
    unit: int = 0
    peer: str = ""
    role: str | None = None


class Touched(NamedTuple):
    """What one request writes and reads; it writes first."""

    writes: tuple[Access, ...] = ()
    reads: tuple[Access, ...] = ()


def _reads(table: str) -> Callable[[Any, Mapping], Touched]:
    return lambda request, _: Touched(reads=(Access(table, request.address, request.count),))


def _write(table: str) -> Callable[[Any, Mapping], Touched]:
    return lambda request, _: Touched((Access(table, request.address, 1, (request.value,)),))


def _writes(table: str) -> Callable[[Any, Mapping], Touched]:
    return lambda request, _: Touched(
        (Access(table, request.address, len(request.values), request.values),)
    )


def _mask_write(request: pdu.MaskWriteRegister, mapping: Mapping) -> Touched:
    registers = mapping.holding_registers
    current = registers[request.address] if registers.has(request.address) else 0
    value = current & request.and_mask | request.or_mask & ~request.and_mask & 0xFFFF
    return Touched((Access("holding_registers", request.address, 1, (value,)),))


def _read_write(request: pdu.ReadWriteRegisters, _: Mapping) -> Touched:
    values = request.values
    return Touched(
        (Access("holding_registers", request.write_address, len(values), values),),
        (Access("holding_registers", request.read_address, request.read_count),),
    )


def _read_files(request: pdu.ReadFileRecords, _: Mapping) -> Touched:
    return Touched(
        reads=tuple(
            Access("file", record, length, file=file) for file, record, length in request.records
        )
    )


def _write_files(request: pdu.WriteFileRecords, _: Mapping) -> Touched:
    return Touched(
        tuple(
            Access("file", record, len(values), values, file=file)
            for file, record, values in request.records
        )
    )


def _read_fifo(request: pdu.ReadFifoQueue, _: Mapping) -> Touched:
    return Touched(reads=(Access("fifo", request.address, 1),))


ACCESSES: dict[type[pdu.Request[Any]], Callable[[Any, Mapping], Touched]] = {
    pdu.ReadCoils: _reads("coils"),
    pdu.ReadDiscreteInputs: _reads("discrete_inputs"),
    pdu.ReadHoldingRegisters: _reads("holding_registers"),
    pdu.ReadInputRegisters: _reads("input_registers"),
    pdu.WriteCoil: _write("coils"),
    pdu.WriteRegister: _write("holding_registers"),
    pdu.WriteCoils: _writes("coils"),
    pdu.WriteRegisters: _writes("holding_registers"),
    pdu.MaskWriteRegister: _mask_write,
    pdu.ReadWriteRegisters: _read_write,
    pdu.ReadFileRecords: _read_files,
    pdu.WriteFileRecords: _write_files,
    pdu.ReadFifoQueue: _read_fifo,
}
"""Request class -> what it touches."""
