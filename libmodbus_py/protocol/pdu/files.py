"""File records and queues: functions 20, 21 and 24."""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from ..checks import integer
from ..errors import in_hex
from ..scan import lib
from .request import (
    MAX_PDU,
    AddressError,
    EchoedWrite,
    LengthRule,
    Request,
    WordRequest,
    checked_registers,
    checked_sequence,
    checked_span,
    counted,
    fixed,
    in_c,
    pack_registers,
    store,
    unpack_registers,
)

RECORDS_PER_FILE = 10_000
"""Records are 0..9999 (section 6.14)."""
FILE_REFERENCE_TYPE = 6  # section 6.14


def _record_span(name: str, file: object, record: object, length: int) -> tuple[int, int]:
    try:
        span = (
            integer(f"{name} file", file, 1, 0xFFFF),
            integer(f"{name} record", record, 0, RECORDS_PER_FILE - 1),
        )
    except ValueError as error:  # a file or record that does not exist is an address
        raise AddressError(*error.args) from None
    if span[1] + length > RECORDS_PER_FILE:
        reason = f"must not pass {RECORDS_PER_FILE}, but {span[1]} + {length} does"
        raise AddressError(f"{name} record", f"+ length {reason}")
    return span


def _triple(name: str, record: object, form: str) -> Sequence[object]:
    if not isinstance(record, Sequence) or isinstance(record, str | bytes) or len(record) != 3:
        raise TypeError(f"{name} must be a tuple ({form}), not {reprlib.repr(record)}")
    return record


@dataclass(frozen=True, slots=True)
class ReadFileRecords(Request[list[list[int]]]):
    """
    Function 20, section 6.14: read 1..35 groups of records, each (file, record, length).

    File is 1..65535, record 0..9999, and record + length up to 10000. The response has
    2 bytes for each group and 2 for each record, up to 251 bytes in all. Servers that
    follow the specification to the letter send at most 245.
    """

    records: tuple[tuple[int, int, int], ...]

    function: ClassVar[int] = 0x14
    repeatable = True
    changes = False
    request_length: ClassVar[LengthRule] = counted(2, at=1)
    response_length: ClassVar[LengthRule] = counted(2, at=1)
    max_response: ClassVar[int] = MAX_PDU - 2
    max_served: ClassVar[int] = 0xF5  # the table of section 6.14

    def __post_init__(self) -> None:
        records = []
        for position, record in enumerate(checked_sequence("records", self.records, 35)):
            name = f"records[{position}]"
            file, start, length = _triple(name, record, "file, record, length")
            size = integer(f"{name} length", length, 1, 124)
            records.append((*_record_span(name, file, start, size), size))
        store(self, records=tuple(records))
        size = sum(2 + 2 * length for *_, length in records)
        if size > self.max_response:
            limit = f"more than {self.max_response}"
            raise ValueError(f"records ask for a response of {size} bytes, {limit}")

    def encode(self) -> bytes:
        pieces = [struct.pack(">BHHH", FILE_REFERENCE_TYPE, *record) for record in self.records]
        return bytes([self.function, 7 * len(pieces)]) + b"".join(pieces)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        pieces = [struct.unpack(">BHHH", pdu[at : at + 7]) for at in range(2, len(pdu) - 6, 7)]
        if not pieces or len(pdu) != 2 + 7 * len(pieces):
            raise ValueError(f"byte count must be 7..245 in steps of 7, not {len(pdu) - 2}")
        if any(length == 0 for *_, length in pieces):
            raise ValueError("length must not be 0")
        if sum(2 + 2 * length for *_, length in pieces) > cls.max_served:
            raise ValueError(f"the response must not pass {cls.max_served} bytes")
        _check_reference_types(kind for kind, *_ in pieces)
        return cls(tuple((file, record, length) for _, file, record, length in pieces))

    def encode_response(self, result: Sequence[Sequence[int]]) -> bytes:
        records = checked_sequence("result", result, len(self.records))
        if len(records) != len(self.records):
            raise ValueError(f"result must hold {len(self.records)} pieces, not {len(records)}")
        pieces = bytearray()
        for piece, (*_, length) in zip(records, self.records, strict=True):
            values = checked_registers("result", piece, length)
            if len(values) != length:
                raise ValueError(f"result must hold {length} registers, not {len(values)}")
            pieces += bytes([1 + 2 * length, FILE_REFERENCE_TYPE]) + pack_registers(values)
        return bytes([self.function, len(pieces)]) + pieces

    def _decode_response(self, pdu: bytes) -> list[list[int]]:
        result = []
        at = 2
        for *_, length in self.records:
            head, end = pdu[at : at + 2], at + 2 + 2 * length
            if head != bytes([1 + 2 * length, FILE_REFERENCE_TYPE]) or end > len(pdu):
                raise self._invalid(f"pieces {in_hex(pdu[2:])}")
            result.append(list(unpack_registers(pdu[at + 2 : end])))
            at = end
        if at != len(pdu):
            raise self._invalid(f"{len(pdu) - at} bytes too many")
        return result


@dataclass(frozen=True, slots=True)
class WriteFileRecords(EchoedWrite):
    """
    Function 21, section 6.15: write groups of records, each (file, record, values).

    File is 1..65535, record 0..9999, and record + length up to 10000, with 1..122 values in a
    group. The request has 7 bytes for each group and 2 for each value, up to 251 bytes in all.
    """

    records: tuple[tuple[int, int, tuple[int, ...]], ...]

    function: ClassVar[int] = 0x15
    request_length: ClassVar[LengthRule] = counted(2, at=1)
    response_length: ClassVar[LengthRule] = counted(2, at=1)
    echoed = MAX_PDU

    def __post_init__(self) -> None:
        records = []
        for position, record in enumerate(checked_sequence("records", self.records, 27)):
            name = f"records[{position}]"
            file, start, registers = _triple(name, record, "file, record, values")
            values = checked_registers(f"{name} values", registers, 122)
            records.append((*_record_span(name, file, start, len(values)), values))
        store(self, records=tuple(records))
        size = sum(7 + 2 * len(values) for *_, values in records)
        if size > 0xFB:
            raise ValueError(f"records take {size} bytes, more than {0xFB}")

    def encode(self) -> bytes:
        pieces = b"".join(
            struct.pack(">BHHH", FILE_REFERENCE_TYPE, file, record, len(values))
            + pack_registers(values)
            for file, record, values in self.records
        )
        return bytes([self.function, len(pieces)]) + pieces

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        pieces = []
        kinds = []
        at = 2
        while at + 7 <= len(pdu):
            kind, file, record, length = struct.unpack(">BHHH", pdu[at : at + 7])
            start, at = at + 7, at + 7 + 2 * length
            if length == 0 or at > len(pdu):
                raise ValueError(f"a piece of {length} registers")
            pieces.append((file, record, unpack_registers(pdu[start:at])))
            kinds.append(kind)
        if not pieces or at != len(pdu):
            raise ValueError(f"the pieces do not fill the byte count {pdu[1]}, 9..251")
        _check_reference_types(kinds)
        return cls(tuple(pieces))


def _check_reference_types(kinds: Iterable[int]) -> None:
    for kind in kinds:
        if kind != FILE_REFERENCE_TYPE:
            raise AddressError("reference type", f"must be {FILE_REFERENCE_TYPE}, not {kind}")


@dataclass(frozen=True, slots=True)
class ReadFifoQueue(WordRequest[list[int]]):
    """Function 24, section 6.18: read 0..31 registers of the FIFO queue at `address`."""

    address: int

    function: ClassVar[int] = 0x18
    repeatable = True
    changes = False
    request_length: ClassVar[LengthRule] = fixed(3)
    response_length: ClassVar[LengthRule] = in_c(
        lambda head: 3 + int.from_bytes(head[1:3]) if len(head) >= 3 else None,
        *(lib.COUNTED_WIDE, 3, 1),
    )
    max_count: ClassVar[int] = 31

    def __post_init__(self) -> None:
        store(self, address=checked_span("address", self.address, "", 1))

    def encode_response(self, result: Sequence[int]) -> bytes:
        values = checked_registers("result", result, self.max_count) if len(result) else ()
        head = struct.pack(">BHH", self.function, 2 + 2 * len(values), len(values))
        return head + pack_registers(values)

    def _decode_response(self, pdu: bytes) -> list[int]:
        count = int.from_bytes(pdu[3:5], "big")
        if count > self.max_count or len(pdu) != 5 + 2 * count:
            raise self._invalid(f"{count} registers in {len(pdu)} bytes")
        return list(unpack_registers(pdu[5:]))
