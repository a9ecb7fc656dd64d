"""Reads of coils, discrete inputs and registers: functions 1-4."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from ..checks import integer
from .request import (
    REGISTERS,
    TABLE_SIZE,
    LengthRule,
    WordRequest,
    checked_bits,
    checked_span,
    counted,
    encode_registers,
    exactly,
    fixed,
    pack_bits,
    unpack_bits,
)

Values = TypeVar("Values", list[bool], list[int])

_REQUEST = struct.Struct(">BHH")


@dataclass(frozen=True, slots=True)
class _Read(WordRequest[Values]):
    """`count` items, up to `limit`, from `address`."""

    address: int
    count: int

    limit: ClassVar[int]
    repeatable = True
    changes = False
    request_length: ClassVar[LengthRule] = fixed(5)
    response_length: ClassVar[LengthRule] = counted(2, at=1)

    def __init__(self, address: int, count: int) -> None:
        if not (
            type(address) is int
            and type(count) is int
            and 0 <= address <= TABLE_SIZE - count
            and 1 <= count <= self.limit
        ):  # not the usual case, which is five times as fast as finding the mistake
            count = integer("count", count, 1, self.limit)
            address = checked_span("address", address, "count", count)
        _set_address(self, address)
        _set_count(self, count)

    def encode(self) -> bytes:
        return _REQUEST.pack(self.function, self.address, self.count)


# What is frozen is set once, in half the time of object.__setattr__.
_set_address, _set_count = (vars(_Read)[name].__set__ for name in ("address", "count"))


class _ReadBits(_Read[list[bool]]):
    __slots__ = ()
    limit: ClassVar[int] = 2000

    def encode_response(self, result: Sequence[bool]) -> bytes:
        data = pack_bits(exactly(self.count, checked_bits("result", result, self.count)))
        return bytes([self.function, len(data)]) + data

    def _decode_response(self, pdu: bytes) -> list[bool]:
        if pdu[1] != (self.count + 7) // 8:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return unpack_bits(pdu[2:], self.count)


class _ReadRegisters(_Read[list[int]]):
    __slots__ = ()
    limit: ClassVar[int] = 125

    def encode_response(self, result: Sequence[int]) -> bytes:
        return encode_registers(self.function, result, self.count)

    def decode_response(self, pdu: bytes) -> list[int]:
        # The usual case, in half the instructions; a class of one's own may decode in its own way.
        size = 2 + 2 * self.count
        if (
            type(self) in _USUAL
            and len(pdu) == size
            and pdu[1] == size - 2
            and pdu[0] == self.function
        ):
            return [*REGISTERS[self.count].unpack_from(pdu, 2)]
        return WordRequest.decode_response(self, pdu)  # super() fails in a dataclass with slots

    def _decode_response(self, pdu: bytes) -> list[int]:
        if pdu[1] != 2 * self.count:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return [*REGISTERS[self.count].unpack_from(pdu, 2)]


class ReadCoils(_ReadBits):
    """Function 1, section 6.1: read `count` coils, 1..2000, from `address` on."""

    __slots__ = ()
    function: ClassVar[int] = 0x01


class ReadDiscreteInputs(_ReadBits):
    """Function 2, section 6.2: read `count` discrete inputs, 1..2000, from `address` on."""

    __slots__ = ()
    function: ClassVar[int] = 0x02


class ReadHoldingRegisters(_ReadRegisters):
    """Function 3, section 6.3: read `count` holding registers, 1..125, from `address` on."""

    __slots__ = ()
    function: ClassVar[int] = 0x03


class ReadInputRegisters(_ReadRegisters):
    """Function 4, section 6.4: read `count` input registers, 1..125, from `address` on."""

    __slots__ = ()
    function: ClassVar[int] = 0x04


_USUAL = frozenset({ReadHoldingRegisters, ReadInputRegisters})
