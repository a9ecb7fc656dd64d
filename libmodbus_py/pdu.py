"""
The function codes: one frozen dataclass for each, with both ends of it.

A request object encodes itself (client), is decoded from bytes (server),
encodes its response (server) and decodes it (client). Only bytes and values:
no unit, no framing, no I/O.

Every request class names its function code and two length rules, which say
how long a request or response PDU is once its first bytes are known; a framer
without end marks (RTU) lives from them. A further function code is one class
and one row in `REQUESTS`.

Layouts, limits and the order of checks: MODBUS Application Protocol V1.1b3,
section 6. Addresses are 0-based.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, fields
from itertools import islice
from typing import Any, ClassVar, Generic, Self, TypeVar

from .arguments import integer
from .errors import (
    ExceptionResponse,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
)

__all__ = [
    "MAX_PDU",
    "REQUESTS",
    "MaskWriteRegister",
    "ReadCoils",
    "ReadDiscreteInputs",
    "ReadFileRecords",
    "ReadHoldingRegisters",
    "ReadInputRegisters",
    "ReadWriteRegisters",
    "Request",
    "WriteCoil",
    "WriteCoils",
    "WriteFileRecords",
    "WriteRegister",
    "WriteRegisters",
    "decode_request",
    "request_length",
    "response_length",
]

MAX_PDU = 253  # section 4.1
TABLE_SIZE = 65536  # section 4.4: addresses are 16 bits
RECORDS_PER_FILE = 10_000  # section 6.14: records 0..9999
FILE_REFERENCE_TYPE = 6  # section 6.14

# Given the first bytes of a PDU, its whole length, or None until that is known.
LengthRule = Callable[[bytes], int | None]

Result = TypeVar("Result")


# --- arguments -----------------------------------------------------------------


class _AddressError(ValueError):
    """An address that no table has: a server answers 2 to it, not 3."""


def _bit(name: str, value: object) -> bool:
    if isinstance(value, bool):
        return value
    return bool(integer(name, value, 0, 1))


def _register(name: str, value: object) -> int:
    return integer(name, value, 0, 0xFFFF)


def _are_bits(values: tuple[Any, ...]) -> bool:
    return set(map(type, values)) == {bool}


def _are_registers(values: tuple[Any, ...]) -> bool:
    return set(map(type, values)) == {int} and min(values) >= 0 and max(values) <= 0xFFFF


def _sequence(name: str, values: object, limit: int) -> tuple[Any, ...]:
    # Text, sets and mappings are iterable, but never a run of registers.
    unfit = isinstance(values, str | bytes | bytearray | Set | Mapping)
    if unfit or not isinstance(values, Iterable):
        given = type(values).__name__
        raise TypeError(f"{name} must be a sequence of 1..{limit} values, not {given}")
    taken = tuple(islice(values, limit + 1))
    if not 1 <= len(taken) <= limit:
        given = f"{len(taken)}" if len(taken) <= limit else f"more than {limit}"
        raise ValueError(f"{name} must hold 1..{limit} values, not {given}")
    return taken


def _bits(name: str, values: object, limit: int) -> tuple[bool, ...]:
    taken = _sequence(name, values, limit)
    if _are_bits(taken):
        return taken
    return tuple(_bit(f"{name}[{at}]", value) for at, value in enumerate(taken))


def _registers(name: str, values: object, limit: int) -> tuple[int, ...]:
    taken = _sequence(name, values, limit)
    if _are_registers(taken):
        return taken
    return tuple(_register(f"{name}[{at}]", value) for at, value in enumerate(taken))


def _span(name: str, address: object, count_name: str, count: int) -> int:
    start = integer(name, address, 0, TABLE_SIZE - 1)
    if start + count > TABLE_SIZE:
        raise _AddressError(
            f"{name} + {count_name} must not pass {TABLE_SIZE}, but {start} + {count} does"
        )
    return start


def _store(request: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(request, name, value)


# --- bytes -----------------------------------------------------------------------


def _pack_bits(bits: Sequence[bool]) -> bytes:
    value = 0
    for position, bit in enumerate(bits):
        if bit:
            value |= 1 << position
    return value.to_bytes((len(bits) + 7) // 8, "little")


def _unpack_bits(data: bytes, count: int) -> list[bool]:
    return [bool(data[position >> 3] >> (position & 7) & 1) for position in range(count)]


def _pack_registers(values: Sequence[int]) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


def _unpack_registers(data: bytes) -> tuple[int, ...]:
    return struct.unpack(f">{len(data) // 2}H", data)


def _fixed(length: int) -> LengthRule:
    return lambda head: length


def _counted(base: int, at: int) -> LengthRule:
    """The byte at `at` counts the bytes that follow the first `base`."""
    return lambda head: base + head[at] if len(head) > at else None


# --- the two ends ------------------------------------------------------------------


class Request(Generic[Result]):
    """
    What every request has in common.

    Class attributes:
        function: the function code, 1..127.
        request_length, response_length: length rules of the two PDUs.
        is_write: whether a broadcast of it makes sense (it changes the
            device and its answer carries nothing new).

    Constructors raise TypeError or ValueError, naming the argument and its
    range; ``str()`` of a request says what is asked, for messages.
    """

    __slots__ = ()

    function: ClassVar[int]
    request_length: ClassVar[LengthRule]
    response_length: ClassVar[LengthRule]
    is_write: ClassVar[bool] = False

    def encode(self) -> bytes:
        """Encode the request PDU."""
        raise NotImplementedError

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        """
        Decode a request PDU of this function, whose length has been checked.

        Raises:
            ValueError: a quantity, byte count or constant is wrong.
        """
        raise NotImplementedError

    def encode_response(self, result: Result) -> bytes:
        """
        Encode the response PDU a server sends.

        Args:
            result: what the client method of this function returns.

        Raises:
            ValueError: the result is not what was asked for.
        """
        raise NotImplementedError

    def decode_response(self, pdu: bytes) -> Result:
        """
        Decode the response PDU.

        Returns:
            What the client method of this function returns.

        Raises:
            ExceptionResponse: the server refused (its subclass for the code).
            InvalidResponse: the PDU does not answer this request.
        """
        if pdu[:1] != bytes([self.function]):
            raise self._refusal(pdu)
        if type(self).response_length(pdu) != len(pdu):
            raise self._invalid(f"a response of {len(pdu)} bytes")
        return self._decode_response(pdu)

    def _decode_response(self, pdu: bytes) -> Result:
        raise NotImplementedError

    def _refusal(self, pdu: bytes) -> ExceptionResponse | InvalidResponse:
        if len(pdu) == 2 and pdu[0] == self.function | 0x80:
            return ExceptionResponse.of(pdu[1], function=self.function, asked=str(self))
        return self._invalid(f"response {pdu[:8].hex(' ') or 'without a byte'}")

    def _invalid(self, what: str) -> InvalidResponse:
        return InvalidResponse(f"answered with {what}", function=self.function, asked=str(self))

    def __str__(self) -> str:
        shown = (
            f"{field.name}={reprlib.repr(getattr(self, field.name))}"
            for field in fields(self)  # type: ignore[arg-type]
        )
        return f"{type(self).__name__}({', '.join(shown)})"


@dataclass(frozen=True, slots=True)
class _ReadBits(Request[list[bool]]):
    address: int
    count: int

    request_length = _fixed(5)
    response_length = _counted(2, at=1)

    def __post_init__(self) -> None:
        count = integer("count", self.count, 1, 2000)
        _store(self, address=_span("address", self.address, "count", count), count=count)

    def encode(self) -> bytes:
        return struct.pack(">BHH", self.function, self.address, self.count)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(*struct.unpack(">HH", pdu[1:]))

    def encode_response(self, result: Sequence[bool]) -> bytes:
        bits = _bits("result", result, self.count)
        if len(bits) != self.count:
            raise ValueError(f"result must hold {self.count} values, not {len(bits)}")
        data = _pack_bits(bits)
        return bytes([self.function, len(data)]) + data

    def _decode_response(self, pdu: bytes) -> list[bool]:
        if pdu[1] != (self.count + 7) // 8:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return _unpack_bits(pdu[2:], self.count)


class ReadCoils(_ReadBits):
    """Function 1, section 6.1: `count` coils, 1..2000, from `address`."""

    __slots__ = ()
    function = 0x01


class ReadDiscreteInputs(_ReadBits):
    """Function 2, section 6.2: `count` discrete inputs, 1..2000, from `address`."""

    __slots__ = ()
    function = 0x02


@dataclass(frozen=True, slots=True)
class _ReadRegisters(Request[list[int]]):
    address: int
    count: int

    request_length = _fixed(5)
    response_length = _counted(2, at=1)

    def __post_init__(self) -> None:
        count = integer("count", self.count, 1, 125)
        _store(self, address=_span("address", self.address, "count", count), count=count)

    def encode(self) -> bytes:
        return struct.pack(">BHH", self.function, self.address, self.count)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(*struct.unpack(">HH", pdu[1:]))

    def encode_response(self, result: Sequence[int]) -> bytes:
        return _encode_registers(self.function, result, self.count)

    def _decode_response(self, pdu: bytes) -> list[int]:
        if pdu[1] != 2 * self.count:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return list(_unpack_registers(pdu[2:]))


def _encode_registers(function: int, result: Sequence[int], count: int) -> bytes:
    values = _registers("result", result, count)
    if len(values) != count:
        raise ValueError(f"result must hold {count} values, not {len(values)}")
    return bytes([function, 2 * count]) + _pack_registers(values)


class ReadHoldingRegisters(_ReadRegisters):
    """Function 3, section 6.3: `count` holding registers, 1..125, from `address`."""

    __slots__ = ()
    function = 0x03


class ReadInputRegisters(_ReadRegisters):
    """Function 4, section 6.4: `count` input registers, 1..125, from `address`."""

    __slots__ = ()
    function = 0x04


class _Echoed(Request[None]):
    """A write whose response repeats the first bytes of the request."""

    __slots__ = ()
    is_write = True
    echoed: ClassVar[int]

    def encode_response(self, result: None = None) -> bytes:
        return self.encode()[: self.echoed]

    def _decode_response(self, pdu: bytes) -> None:
        if pdu != self.encode_response():
            raise self._invalid(f"the echo {pdu.hex(' ')}")


@dataclass(frozen=True, slots=True)
class WriteCoil(_Echoed):
    """Function 5, section 6.5: one coil; `value` True, False, 1 or 0."""

    address: int
    value: bool

    function = 0x05
    request_length = response_length = _fixed(5)
    echoed = 5
    wire_values: ClassVar[dict[int, bool]] = {0x0000: False, 0xFF00: True}

    def __post_init__(self) -> None:
        _store(self, value=_bit("value", self.value), address=_span("address", self.address, "", 1))

    def encode(self) -> bytes:
        return struct.pack(">BHH", self.function, self.address, 0xFF00 if self.value else 0)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        address, value = struct.unpack(">HH", pdu[1:])
        if value not in cls.wire_values:
            raise ValueError(f"value must be 0000 or FF00, not {value:04X}")
        return cls(address, cls.wire_values[value])


@dataclass(frozen=True, slots=True)
class WriteRegister(_Echoed):
    """Function 6, section 6.6: one holding register; `value` 0..65535."""

    address: int
    value: int

    function = 0x06
    request_length = response_length = _fixed(5)
    echoed = 5

    def __post_init__(self) -> None:
        _store(
            self,
            value=_register("value", self.value),
            address=_span("address", self.address, "", 1),
        )

    def encode(self) -> bytes:
        return struct.pack(">BHH", self.function, self.address, self.value)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(*struct.unpack(">HH", pdu[1:]))


@dataclass(frozen=True, slots=True)
class WriteCoils(_Echoed):
    """Function 15, section 6.11: 1..1968 coils from `address`."""

    address: int
    values: tuple[bool, ...]

    function = 0x0F
    request_length = _counted(6, at=5)
    response_length = _fixed(5)
    echoed = 5

    def __post_init__(self) -> None:
        values = _bits("values", self.values, 1968)
        _store(
            self, values=values, address=_span("address", self.address, "len(values)", len(values))
        )

    def encode(self) -> bytes:
        data = _pack_bits(self.values)
        head = struct.pack(">BHHB", self.function, self.address, len(self.values), len(data))
        return head + data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        address, count, size = struct.unpack(">HHB", pdu[1:6])
        if not 1 <= count <= 1968 or size != (count + 7) // 8:
            raise ValueError(f"byte count {size} does not hold {count} coils, 1..1968")
        return cls(address, tuple(_unpack_bits(pdu[6:], count)))


@dataclass(frozen=True, slots=True)
class WriteRegisters(_Echoed):
    """Function 16, section 6.12: 1..123 holding registers from `address`."""

    address: int
    values: tuple[int, ...]

    function = 0x10
    request_length = _counted(6, at=5)
    response_length = _fixed(5)
    echoed = 5

    def __post_init__(self) -> None:
        values = _registers("values", self.values, 123)
        _store(
            self, values=values, address=_span("address", self.address, "len(values)", len(values))
        )

    def encode(self) -> bytes:
        data = _pack_registers(self.values)
        head = struct.pack(">BHHB", self.function, self.address, len(self.values), len(data))
        return head + data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        address, count, size = struct.unpack(">HHB", pdu[1:6])
        if size != 2 * count:
            raise ValueError(f"byte count {size} does not hold {count} registers, 1..123")
        return cls(address, _unpack_registers(pdu[6:]))


@dataclass(frozen=True, slots=True)
class MaskWriteRegister(_Echoed):
    """
    Function 22, section 6.16: one holding register becomes
    (current AND `and_mask`) OR (`or_mask` AND NOT `and_mask`).
    """

    address: int
    and_mask: int
    or_mask: int

    function = 0x16
    request_length = response_length = _fixed(7)
    echoed = 7

    def __post_init__(self) -> None:
        _store(
            self,
            and_mask=_register("and_mask", self.and_mask),
            or_mask=_register("or_mask", self.or_mask),
            address=_span("address", self.address, "", 1),
        )

    def encode(self) -> bytes:
        return struct.pack(">BHHH", self.function, self.address, self.and_mask, self.or_mask)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(*struct.unpack(">HHH", pdu[1:]))


@dataclass(frozen=True, slots=True)
class ReadWriteRegisters(Request[list[int]]):
    """
    Function 23, section 6.17: write 1..121 holding registers, then read 1..125.

    The write is done first, so registers in both ranges read back new.
    """

    read_address: int
    read_count: int
    write_address: int
    values: tuple[int, ...]

    function = 0x17
    request_length = _counted(10, at=9)
    response_length = _counted(2, at=1)

    def __post_init__(self) -> None:
        count = integer("read_count", self.read_count, 1, 125)
        values = _registers("values", self.values, 121)
        _store(
            self,
            read_address=_span("read_address", self.read_address, "read_count", count),
            read_count=count,
            write_address=_span("write_address", self.write_address, "len(values)", len(values)),
            values=values,
        )

    def encode(self) -> bytes:
        data = _pack_registers(self.values)
        return (
            struct.pack(
                ">BHHHHB",
                self.function,
                self.read_address,
                self.read_count,
                self.write_address,
                len(self.values),
                len(data),
            )
            + data
        )

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        read_address, read_count, write_address, count, size = struct.unpack(">HHHHB", pdu[1:10])
        if size != 2 * count:
            raise ValueError(f"byte count {size} does not hold {count} registers, 1..121")
        return cls(read_address, read_count, write_address, _unpack_registers(pdu[10:]))

    def encode_response(self, result: Sequence[int]) -> bytes:
        return _encode_registers(self.function, result, self.read_count)

    def _decode_response(self, pdu: bytes) -> list[int]:
        if pdu[1] != 2 * self.read_count:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return list(_unpack_registers(pdu[2:]))


# --- file records ------------------------------------------------------------------


def _record_span(name: str, file: object, record: object, length: int) -> tuple[int, int]:
    try:
        checked = (
            integer(f"{name} file", file, 1, 0xFFFF),
            integer(f"{name} record", record, 0, RECORDS_PER_FILE - 1),
        )
    except ValueError as error:  # a file or record that does not exist is an address
        raise _AddressError(str(error)) from None
    if checked[1] + length > RECORDS_PER_FILE:
        raise _AddressError(
            f"{name} record + length must not pass {RECORDS_PER_FILE},"
            f" but {checked[1]} + {length} does"
        )
    return checked


def _triple(name: str, record: object, form: str) -> tuple[object, object, object]:
    if not isinstance(record, Sequence) or isinstance(record, str | bytes) or len(record) != 3:
        raise TypeError(f"{name} must be a tuple ({form}), not {reprlib.repr(record)}")
    return record[0], record[1], record[2]


@dataclass(frozen=True, slots=True)
class ReadFileRecords(Request[list[list[int]]]):
    """
    Function 20, section 6.14: 1..35 pieces of files, each (file, record, length).

    File 1..65535, record 0..9999, record + length up to 10000; the response,
    2 bytes and 2 per register for each piece, up to 251 bytes. Servers that
    keep the letter of the specification answer at most 245.
    """

    records: tuple[tuple[int, int, int], ...]

    function = 0x14
    request_length = _counted(2, at=1)
    response_length = _counted(2, at=1)
    max_response: ClassVar[int] = MAX_PDU - 2
    max_served: ClassVar[int] = 0xF5  # the table of section 6.14

    def __post_init__(self) -> None:
        checked = []
        for position, record in enumerate(_sequence("records", self.records, 35)):
            name = f"records[{position}]"
            file, start, length = _triple(name, record, "file, record, length")
            size = integer(f"{name} length", length, 1, 124)
            checked.append((*_record_span(name, file, start, size), size))
        _store(self, records=tuple(checked))
        if self._response_size() > self.max_response:
            raise ValueError(
                f"records ask for a response of {self._response_size()} bytes,"
                f" more than {self.max_response}"
            )

    def _response_size(self) -> int:
        return sum(2 + 2 * length for _, _, length in self.records)

    def encode(self) -> bytes:
        pieces = b"".join(
            struct.pack(">BHHH", FILE_REFERENCE_TYPE, *record) for record in self.records
        )
        return bytes([self.function, len(pieces)]) + pieces

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        pieces = [struct.unpack(">BHHH", pdu[at : at + 7]) for at in range(2, len(pdu) - 6, 7)]
        if not 1 <= len(pieces) <= 35 or len(pdu) != 2 + 7 * len(pieces):
            raise ValueError(f"byte count must be 7..245 in steps of 7, not {len(pdu) - 2}")
        if any(length == 0 for *_, length in pieces):
            raise ValueError("length must not be 0")
        if sum(2 + 2 * length for *_, length in pieces) > cls.max_served:
            raise ValueError(f"the response must not pass {cls.max_served} bytes")
        _check_reference_types(kind for kind, *_ in pieces)
        return cls(tuple((file, record, length) for _, file, record, length in pieces))

    def encode_response(self, result: Sequence[Sequence[int]]) -> bytes:
        given = _sequence("result", result, len(self.records))
        if len(given) != len(self.records):
            raise ValueError(f"result must hold {len(self.records)} pieces, not {len(given)}")
        pieces = bytearray()
        for piece, (*_, length) in zip(given, self.records, strict=True):
            values = _registers("result", piece, length)
            if len(values) != length:
                raise ValueError(f"result must hold {length} registers, not {len(values)}")
            pieces += bytes([1 + 2 * length, FILE_REFERENCE_TYPE]) + _pack_registers(values)
        return bytes([self.function, len(pieces)]) + pieces

    def _decode_response(self, pdu: bytes) -> list[list[int]]:
        result = []
        at = 2
        for *_, length in self.records:
            head, end = pdu[at : at + 2], at + 2 + 2 * length
            if head != bytes([1 + 2 * length, FILE_REFERENCE_TYPE]) or end > len(pdu):
                raise self._invalid(f"pieces {pdu[2:].hex(' ')}")
            result.append(list(_unpack_registers(pdu[at + 2 : end])))
            at = end
        if at != len(pdu):
            raise self._invalid(f"{len(pdu) - at} bytes too many")
        return result


@dataclass(frozen=True, slots=True)
class WriteFileRecords(_Echoed):
    """
    Function 21, section 6.15: pieces of files, each (file, record, values).

    File 1..65535, record 0..9999, record + length up to 10000, 1..122 values;
    all pieces, 7 bytes and 2 per value each, up to 251 bytes.
    """

    records: tuple[tuple[int, int, tuple[int, ...]], ...]

    function = 0x15
    request_length = _counted(2, at=1)
    response_length = _counted(2, at=1)
    echoed = MAX_PDU

    def __post_init__(self) -> None:
        checked = []
        for position, record in enumerate(_sequence("records", self.records, 27)):
            name = f"records[{position}]"
            file, start, given = _triple(name, record, "file, record, values")
            values = _registers(f"{name} values", given, 122)
            checked.append((*_record_span(name, file, start, len(values)), values))
        _store(self, records=tuple(checked))
        size = sum(7 + 2 * len(values) for *_, values in checked)
        if size > 0xFB:
            raise ValueError(f"records take {size} bytes, more than {0xFB}")

    def encode(self) -> bytes:
        pieces = b"".join(
            struct.pack(">BHHH", FILE_REFERENCE_TYPE, file, record, len(values))
            + _pack_registers(values)
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
            at += 7 + 2 * length
            pieces.append((file, record, _unpack_registers(pdu[at - 2 * length : at])))
            kinds.append(kind)
            if length == 0:
                raise ValueError("length must not be 0")
        if not pieces or at != len(pdu) or len(pdu) > 2 + 0xFB:
            raise ValueError(f"the pieces do not fill the byte count {pdu[1]}, 9..251")
        _check_reference_types(kinds)
        return cls(tuple(pieces))


def _check_reference_types(kinds: Iterable[int]) -> None:
    for kind in kinds:
        if kind != FILE_REFERENCE_TYPE:
            raise _AddressError(f"reference type must be {FILE_REFERENCE_TYPE}, not {kind}")


# --- the table ---------------------------------------------------------------------

REQUESTS: dict[int, type[Request[Any]]] = {
    request.function: request
    for request in (
        ReadCoils,
        ReadDiscreteInputs,
        ReadHoldingRegisters,
        ReadInputRegisters,
        WriteCoil,
        WriteRegister,
        WriteCoils,
        WriteRegisters,
        ReadFileRecords,
        WriteFileRecords,
        MaskWriteRegister,
        ReadWriteRegisters,
    )
}
"""Function code -> request class."""


def decode_request(pdu: bytes) -> Request[Any]:
    """
    Decode any request PDU, as a server does.

    Checks everything that needs no device, in the order of the per-function
    diagrams of section 6: function, length, quantities and constants, address
    range.

    Args:
        pdu: 1..253 bytes.

    Raises:
        IllegalFunction: no such function in `REQUESTS`.
        IllegalDataValue: wrong length, quantity, byte count or constant.
        IllegalDataAddress: address + quantity passes 65536, or a file or
            record that cannot exist.
        ValueError: `pdu` is empty.
    """
    if not pdu:
        raise ValueError("pdu must hold at least the function code")
    request = REQUESTS.get(pdu[0])
    if request is None:
        raise IllegalFunction(function=pdu[0])
    try:
        if request.request_length(pdu) != len(pdu):
            raise ValueError(f"a request of {len(pdu)} bytes")
        return request.decode(pdu)
    except _AddressError as error:
        raise IllegalDataAddress(str(error), function=pdu[0]) from None
    except ValueError as error:
        raise IllegalDataValue(str(error), function=pdu[0]) from None


def request_length(head: bytes) -> int | None:
    """
    Say how long the request PDU is that begins with these bytes.

    Args:
        head: one byte or more.

    Returns:
        The length, or None while more bytes are needed.

    Raises:
        KeyError: the function code has no length rule.
    """
    return REQUESTS[head[0]].request_length(head)


def response_length(head: bytes) -> int | None:
    """Say how long a response PDU is; as `request_length`. Exception responses are 2 bytes."""
    if head[0] & 0x80:
        return 2
    return REQUESTS[head[0]].response_length(head)
