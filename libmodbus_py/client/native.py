"""
The requests that libmodbus carries itself: one row, one call each.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..binding.library import check, ffi, lib
from ..protocol import pdu
from ..protocol.errors import InvalidResponse

__all__ = ["NATIVE", "Call"]

# (modbus_t, request) -> result; raises what `check` raises.
Call = Callable[[Any, Any], Any]


def _read_bits(name: str) -> Call:
    def call(context: Any, request: Any) -> list[bool]:
        cells = ffi.new("uint8_t[]", request.count)
        check(getattr(lib, name)(context, request.address, request.count, cells))
        return [cell != 0 for cell in ffi.unpack(cells, request.count)]

    return call


def _read_registers(name: str) -> Call:
    def call(context: Any, request: Any) -> list[int]:
        cells = ffi.new("uint16_t[]", request.count)
        check(getattr(lib, name)(context, request.address, request.count, cells))
        values: list[int] = ffi.unpack(cells, request.count)
        return values

    return call


def _write_coil(context: Any, request: pdu.WriteCoil) -> None:
    check(lib.modbus_write_bit(context, request.address, request.value))


def _write_register(context: Any, request: pdu.WriteRegister) -> None:
    check(lib.modbus_write_register(context, request.address, request.value))


def _write_coils(context: Any, request: pdu.WriteCoils) -> None:
    values = request.values
    check(lib.modbus_write_bits(context, request.address, len(values), bytes(values)))


def _write_registers(context: Any, request: pdu.WriteRegisters) -> None:
    values = request.values
    check(lib.modbus_write_registers(context, request.address, len(values), values))


def _mask_write_register(context: Any, request: pdu.MaskWriteRegister) -> None:
    check(
        lib.modbus_mask_write_register(context, request.address, request.and_mask, request.or_mask)
    )


def _read_write_registers(context: Any, request: pdu.ReadWriteRegisters) -> list[int]:
    cells = ffi.new("uint16_t[]", request.read_count)
    check(
        lib.modbus_write_and_read_registers(
            context,
            request.write_address,
            len(request.values),
            request.values,
            request.read_address,
            request.read_count,
            cells,
        )
    )
    values: list[int] = ffi.unpack(cells, request.read_count)
    return values


def _report_server_id(context: Any, request: pdu.ReportServerId) -> pdu.ServerId:
    data = ffi.new("uint8_t[]", pdu.MAX_PDU)
    size = check(lib.modbus_report_slave_id(context, pdu.MAX_PDU, data))
    if size < 2:
        raise InvalidResponse(f"answered with {size} bytes of data")
    return pdu.ServerId.split(bytes(ffi.buffer(data, size)))


NATIVE: dict[type[pdu.Request[Any]], Call] = {
    pdu.ReadCoils: _read_bits("modbus_read_bits"),
    pdu.ReadDiscreteInputs: _read_bits("modbus_read_input_bits"),
    pdu.ReadHoldingRegisters: _read_registers("modbus_read_registers"),
    pdu.ReadInputRegisters: _read_registers("modbus_read_input_registers"),
    pdu.WriteCoil: _write_coil,
    pdu.WriteRegister: _write_register,
    pdu.WriteCoils: _write_coils,
    pdu.WriteRegisters: _write_registers,
    pdu.ReportServerId: _report_server_id,
    pdu.MaskWriteRegister: _mask_write_register,
    pdu.ReadWriteRegisters: _read_write_registers,
}
"""Request class -> call."""
