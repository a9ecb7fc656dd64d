"""Writes of coils and registers: functions 5, 6, 15, 16, 22 and 23, which reads as well."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Self, TypeVar

from ..checks import integer
from .request import (
    MAX_WRITTEN,
    REGISTERS,
    EchoedWrite,
    LengthRule,
    Request,
    WordRequest,
    checked_bit,
    checked_bits,
    checked_register,
    checked_registers,
    checked_span,
    counted,
    encode_registers,
    fixed,
    pack_bits,
    pack_registers,
    store,
    unpack_bits,
    unpack_registers,
)

Value = TypeVar("Value", bool, int)


@dataclass(frozen=True, slots=True)
class _WriteOne(EchoedWrite, WordRequest[None], Generic[Value]):
    address: int
    value: Value

    request_length: ClassVar[LengthRule] = fixed(5)
    response_length: ClassVar[LengthRule] = fixed(5)
    echoed = 5
    _check: ClassVar[Any]

    def __post_init__(self) -> None:
        value = type(self)._check("value", self.value)
        store(self, value=value, address=checked_span("address", self.address, "", 1))


class WriteCoil(_WriteOne[bool]):
    """Function 5, section 6.5: write one coil; `value` is True, False, 1 or 0."""

    __slots__ = ()
    function: ClassVar[int] = 0x05
    wire_values: ClassVar[dict[int, bool]] = {0x0000: False, 0xFF00: True}
    _check = staticmethod(checked_bit)

    def encode(self) -> bytes:
        return struct.pack(">BHH", self.function, self.address, 0xFF00 if self.value else 0)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        address, value = struct.unpack(">HH", pdu[1:])
        if value not in cls.wire_values:
            raise ValueError(f"value must be 0000 or FF00, not {value:04X}")
        return cls(address, cls.wire_values[value])


class WriteRegister(_WriteOne[int]):
    """Function 6, section 6.6: write one holding register; `value` is 0..65535."""

    __slots__ = ()
    function: ClassVar[int] = 0x06
    _check = staticmethod(checked_register)


@dataclass(frozen=True, slots=True)
class _WriteSeveral(EchoedWrite, Generic[Value]):
    address: int
    values: tuple[Value, ...]

    limit: ClassVar[int]
    request_length: ClassVar[LengthRule] = counted(6, at=5)
    response_length: ClassVar[LengthRule] = fixed(5)
    echoed = 5
    _check: ClassVar[Any]
    _pack: ClassVar[Any]

    def __post_init__(self) -> None:
        values = type(self)._check("values", self.values, self.limit)
        address = checked_span("address", self.address, "len(values)", len(values))
        store(self, values=values, address=address)

    def encode(self) -> bytes:
        data: bytes = type(self)._pack(self.values)
        head = struct.pack(">BHHB", self.function, self.address, len(self.values), len(data))
        return head + data


class WriteCoils(_WriteSeveral[bool]):
    """Function 15, section 6.11: write 1..1968 coils from `address` on."""

    __slots__ = ()
    function: ClassVar[int] = 0x0F
    limit: ClassVar[int] = MAX_WRITTEN["coils"]
    _check, _pack = staticmethod(checked_bits), staticmethod(pack_bits)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        address, count, size = struct.unpack(">HHB", pdu[1:6])
        if not 1 <= count <= cls.limit or size != (count + 7) // 8:
            raise ValueError(f"byte count {size} does not fit {count} coils (1..{cls.limit})")
        return cls(address, tuple(unpack_bits(pdu[6:], count)))


class WriteRegisters(_WriteSeveral[int]):
    """Function 16, section 6.12: write 1..123 holding registers from `address` on."""

    __slots__ = ()
    function: ClassVar[int] = 0x10
    limit: ClassVar[int] = MAX_WRITTEN["holding_registers"]
    _check, _pack = staticmethod(checked_registers), staticmethod(pack_registers)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        address, count, size = struct.unpack(">HHB", pdu[1:6])
        if size != 2 * count:
            raise ValueError(f"byte count {size} does not fit {count} registers (1..{cls.limit})")
        return cls(address, unpack_registers(pdu[6:]))


@dataclass(frozen=True, slots=True)
class MaskWriteRegister(EchoedWrite, WordRequest[None]):
    """
    Function 22, section 6.16: set one holding register to
    (current AND `and_mask`) OR (`or_mask` AND NOT `and_mask`).
    """

    address: int
    and_mask: int
    or_mask: int

    function: ClassVar[int] = 0x16
    request_length: ClassVar[LengthRule] = fixed(7)
    response_length: ClassVar[LengthRule] = fixed(7)
    echoed = 7

    def __post_init__(self) -> None:
        and_mask = checked_register("and_mask", self.and_mask)
        or_mask = checked_register("or_mask", self.or_mask)
        address = checked_span("address", self.address, "", 1)
        store(self, and_mask=and_mask, or_mask=or_mask, address=address)


@dataclass(frozen=True, slots=True)
class ReadWriteRegisters(Request[list[int]]):
    """
    Function 23, section 6.17: write 1..121 holding registers, then read 1..125.

    The write is executed first, so that registers in both ranges are read with their new values.
    """

    read_address: int
    read_count: int
    write_address: int
    values: tuple[int, ...]

    function: ClassVar[int] = 0x17
    repeatable = True
    request_length: ClassVar[LengthRule] = counted(10, at=9)
    response_length: ClassVar[LengthRule] = counted(2, at=1)

    def __post_init__(self) -> None:
        count = integer("read_count", self.read_count, 1, 125)
        values = checked_registers("values", self.values, 121)
        start = checked_span("read_address", self.read_address, "read_count", count)
        address = checked_span("write_address", self.write_address, "len(values)", len(values))
        store(self, read_address=start, read_count=count, write_address=address, values=values)

    def encode(self) -> bytes:
        data = pack_registers(self.values)
        where = self.read_address, self.read_count, self.write_address
        return struct.pack(">BHHHHB", self.function, *where, len(self.values), len(data)) + data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        read_address, read_count, write_address, count, size = struct.unpack(">HHHHB", pdu[1:10])
        if size != 2 * count:
            raise ValueError(f"byte count {size} does not fit {count} registers (1..121)")
        return cls(read_address, read_count, write_address, unpack_registers(pdu[10:]))

    def encode_response(self, result: Sequence[int]) -> bytes:
        return encode_registers(self.function, result, self.read_count)

    def _decode_response(self, pdu: bytes) -> list[int]:
        if pdu[1] != 2 * self.read_count:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return list(REGISTERS[self.read_count].unpack_from(pdu, 2))
