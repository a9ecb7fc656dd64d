"""
Values: how registers are interpreted, and how manuals number them (`words`).

Modbus carries 16-bit registers, high byte first. Everything else is a convention of the
device; this module knows the usual ones. Types are named by strings:

* int16, uint16, int32, uint32, int64, uint64;
* float16, float32, float64 (IEEE 754);
* bcd16, bcd32, bcd64: decimal digits, four in each register;
* bits16, bits32, bits64: lists of True and False, lowest bit first;
* unix32, unix64: seconds since 1970; ms64: milliseconds; unsigned with 32 bits, signed with 64;
* iec870: CP56Time2a of IEC 60870-5-4 in the four registers of Schneider's devices;
* date48: six bytes, year (since 2000), month, day, hour, minute, second; bcddate48: the same in
  decimal digits; date96: six registers, with the full year;
* eui48: a MAC address as text, such as "0D:D7:4C:C6:44:8E", behind a register of padding;
* string:N: N bytes of text, 1..250, two in each register; if N is odd, the last
  byte of the last register is written as 0 and ignored when read.

An order tells how the bytes A (most significant), B, C, D of a value are arranged in the
registers. Four letters name the order for all widths; for 16 and 64 bits it may also be
written out:

==== == ======== ================ ========================
name 16 64 bits  meaning          registers of 0x12345678
==== == ======== ================ ========================
ABCD AB ABCDEFGH big-endian       1234 5678
CDAB AB GHEFCDAB words swapped    5678 1234
BADC BA BADCFEHG bytes swapped    3412 7856
DCBA BA HGFEDCBA little-endian    7856 3412
==== == ======== ================ ========================

Text is always in reading order: its registers are never reversed, only the bytes of
each are swapped (BADC, DCBA).

libmodbus's own float functions are not used: they differ between versions.
"""

from __future__ import annotations

import re
import reprlib
import struct
import sys
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsFloat, SupportsIndex

from .checks import are_registers, integer, shown
from .encodings import ENCODINGS, encoded, fill_of, pack_mac, unpack_mac
from .mistakes import Path, WrongType, WrongValue, item
from .type_names import (
    MAX_STRING_BYTES,
    BitsType,
    Layout,
    NumberType,
    Order,
    StringType,
    TextOptions,
    TextType,
    TimeType,
    TypeName,
    string_type,
)
from .words import (
    ORDER_WORDS,
    TYPE_WORDS,
    Reference,
    close_word,
    order_named,
    parse_reference,
    type_named,
)

if TYPE_CHECKING:
    from datetime import datetime

# fmt: off
__all__ = [
    "ENCODINGS", "ORDERS", "BitsType", "Interpretation", "Layout", "NumberType", "Order",
    "Reference", "StringType", "TextOptions", "TextType", "TimeType", "TypeName", "ValueType",
    "parse_reference", "readings", "string_type", "value_type",
]
# fmt: on

# --- orders ------------------------------------------------------------------------

ORDERS: dict[str, tuple[bool, bool]] = {
    "ABCD": (False, False),
    "CDAB": (True, False),
    "BADC": (False, True),
    "DCBA": (True, True),
}
"""Order -> (registers reversed, bytes of each swapped)."""

_SPELLINGS = {
    "AB": ("ABCD", 1),
    "BA": ("BADC", 1),
    "ABCDEFGH": ("ABCD", 4),
    "GHEFCDAB": ("CDAB", 4),
    "BADCFEHG": ("BADC", 4),
    "HGFEDCBA": ("DCBA", 4),
}


def _order(order: object, kind: ValueType) -> str:
    if not isinstance(order, str):
        raise WrongType("order", f"must be one of {', '.join(ORDERS)}, not {type(order).__name__}")
    name, width = _SPELLINGS.get(order.upper(), (order.upper(), None))
    name = name if name in ORDERS else order_named(order) or name
    if name not in ORDERS:
        close = close_word(name, ORDERS, ORDER_WORDS)
        wanted = f"must be one of {', '.join(ORDERS)}"
        raise WrongValue("order", f"{wanted}, not {reprlib.repr(order)}{close}")
    if width not in (None, 1 if kind.is_text else kind.registers):
        wanted = f"one of {', '.join(ORDERS)}"
        raise WrongValue("order", f"of {kind.name} must be {wanted}, not {order!r}")
    return name


def _reorder(data: bytes, words: bool, swap: bool) -> bytes:
    if words:
        data = data[::-1]  # which swaps the bytes of each, too
    if words == swap:
        return data
    swapped = bytearray(data)
    swapped[0::2], swapped[1::2] = data[1::2], data[0::2]
    return bytes(swapped)


# --- types -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ValueType:
    """
    A type of values in one byte order, made by `value_type`.

    Attributes:
        name: the name of the type, as in the module's docstring.
        registers: the number of registers of one value, 1..125.
        pack: returns the bytes of a value in the order ABCD; takes its name for errors, and it.
        unpack: returns the value of bytes in the order ABCD; raises ValueError.
        order: ABCD, CDAB, BADC or DCBA.
        limits: the lowest and the highest number; None if values are not numbers.
        is_text: True if the registers are in reading order, whatever the order.
        is_time: True if values are datetimes, with a time zone.
    """

    name: str
    registers: int
    pack: Callable[[str | Path, Any], bytes] = field(repr=False)
    unpack: Callable[[bytes], Any] = field(repr=False)
    limits: tuple[int, int] | tuple[float, float] | None = None
    is_text: bool = False
    order: str = "ABCD"
    is_time: bool = False

    def encode(self, value: Any) -> list[int]:
        """
        Return the registers of one value, 0..65535 each.

        Args:
            value: a number; for bits, a list of True and False, lowest first; for string:N and
                eui48, a string, which is never truncated; for times, a datetime with a time zone,
                whose fractions of a second are dropped if the type has none.

        Raises:
            TypeError, ValueError: the value does not fit the type.
        """
        return self._to_registers("value", value)

    def encode_many(self, values: Iterable[Any]) -> list[int]:
        """
        Return the registers of values, one value after the other.

        Raises:
            TypeError, ValueError: `values` is not a list, or a value does not fit the type; the
                message names the value.
        """
        found = []
        for at, value in enumerate(_items("values", values)):
            found += self._to_registers(("values", at), value)
        return found

    def decode(self, registers: Iterable[int]) -> Any:
        """
        Return the value of its registers.

        Returns:
            An int, a float, a list of True and False, a datetime in UTC, or a string without the
            padding at its end.

        Raises:
            TypeError, ValueError: there are too many or too few registers, they are not
                0..65535 each, or they hold no such value.
        """
        cells = _cells(registers)
        if len(cells) != self.registers:
            raise WrongValue(
                "registers", f"must hold {self.registers} for {self.name}, not {len(cells)}"
            )
        return self._from_registers(cells)[0]

    def decode_many(self, registers: Iterable[int]) -> list[Any]:
        """
        Return the values of registers, one after the other; an empty list without registers.

        Raises:
            TypeError, ValueError: the last value is incomplete, or registers are not 0..65535
                each or hold no such value; the message names the registers.
        """
        cells = _cells(registers)
        if len(cells) % self.registers:
            raise WrongValue(
                "registers",
                f"must hold a multiple of {self.registers} for {self.name}, not {len(cells)}",
            )
        return self._from_registers(cells)

    def _to_registers(self, name: str | Path, value: object) -> list[int]:
        data = self._reordered(self.pack(name, value))
        return list(struct.unpack(f">{self.registers}H", data))

    def _from_registers(self, cells: list[int]) -> list[Any]:
        data = struct.pack(f">{len(cells)}H", *cells)
        size = 2 * self.registers
        return [self._from_part(data[at : at + size], at // 2) for at in range(0, len(data), size)]

    def _from_part(self, data: bytes, at: int) -> Any:
        try:
            return self.from_bytes(data)
        except ValueError as error:
            end = at + self.registers
            raise ValueError(f"registers[{at}:{end}] hold no {self.name}: {error}") from None

    def from_bytes(self, data: bytes) -> Any:
        """
        Return the value of the bytes of its registers, as in a response.

        Raises:
            ValueError: the bytes hold no such value.
        """
        return self.unpack(self._reordered(data))

    @property
    def reader(self) -> Callable[[bytes], Any]:
        """Return a function that does the same as `from_bytes`, with fewer calls if possible."""
        return self.unpack if self.order == "ABCD" else self.from_bytes

    def to_number(self, data: bytes) -> int:
        """Return the bits of one value of any type as an unsigned number."""
        return int.from_bytes(self._reordered(data), "big")

    def cells_of_number(self, number: int) -> list[int]:
        """Return the registers that contain the bits of an unsigned number."""
        data = self._reordered(number.to_bytes(2 * self.registers, "big"))
        return list(struct.unpack(f">{self.registers}H", data))

    def _reordered(self, data: bytes) -> bytes:
        if self.order == "ABCD":
            return data
        words, swap = ORDERS[self.order]
        return _reorder(data, words and not self.is_text, swap)


def _items(name: str | Path, values: object) -> list[Any]:
    # Text, sets and mappings are iterable, but never a run of values.
    unfit = isinstance(values, str | bytes | bytearray | Set | Mapping)
    if unfit or not isinstance(values, Iterable):
        raise WrongType(name, f"must be a list, not {type(values).__name__}")
    return list(values)


def _cells(registers: object) -> list[int]:
    given = registers if type(registers) is list else _items("registers", registers)
    if are_registers(given):
        return given
    return [integer(("registers", at), cell, 0, 0xFFFF) for at, cell in enumerate(given)]


def _integers(bits: int, signed: bool) -> ValueType:
    low, high = (-1 << bits - 1, (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)

    def pack(name: str | Path, value: object) -> bytes:
        return integer(name, value, low, high).to_bytes(bits // 8, "big", signed=signed)

    def unpack(data: bytes) -> int:
        return int.from_bytes(data, "big", signed=signed)

    name = f"{'' if signed else 'u'}int{bits}"
    return ValueType(name, bits // 16, pack, unpack, (low, high))


def _floats(bits: int, code: str, largest: float) -> ValueType:
    form = struct.Struct(f">{code}")

    def pack(name: str | Path, value: object) -> bytes:
        unfit = isinstance(value, bool) or not isinstance(value, SupportsFloat | SupportsIndex)
        if unfit:
            raise WrongType(name, f"must be a number, not {type(value).__name__}")
        try:
            return form.pack(float(value))  # type: ignore[arg-type]
        except OverflowError:
            span = f"-{largest:.8g}..{largest:.8g}, infinite or nan"
            raise WrongValue(name, f"must be in {span}, not {shown(value)}") from None

    def unpack(data: bytes) -> float:
        value: float = form.unpack(data)[0]
        return value

    return ValueType(f"float{bits}", bits // 16, pack, unpack, (-largest, largest))


def _decimals(bits: int) -> ValueType:
    digits = bits // 4
    high = 10**digits - 1

    def pack(name: str | Path, value: object) -> bytes:
        number = integer(name, value, 0, high)
        return bytes.fromhex(f"{number:0{digits}}")

    def unpack(data: bytes) -> int:
        text = data.hex().upper()
        if not text.isdecimal():
            raise ValueError(f"{text} has digits other than 0..9")
        return int(text)

    return ValueType(f"bcd{bits}", bits // 16, pack, unpack, (0, high))


def _flags(bits: int) -> ValueType:
    def pack(name: str | Path, value: object) -> bytes:
        flags = _items(name, value)
        if len(flags) != bits:
            raise WrongValue(name, f"must hold {bits} bits, lowest first, not {len(flags)}")
        number = sum(_bit(item(name, at), flag) << at for at, flag in enumerate(flags))
        return number.to_bytes(bits // 8, "big")

    def unpack(data: bytes) -> list[bool]:
        number = int.from_bytes(data, "big")
        return [bool(number >> at & 1) for at in range(bits)]

    return ValueType(f"bits{bits}", bits // 16, pack, unpack)


def _moments(type_name: str, registers: int) -> ValueType:
    # Imported when first used: most programs read no times.
    def pack(name: str | Path, value: object) -> bytes:
        from .times import TIMES, pack_time

        return pack_time(TIMES[type_name], name, value)

    def unpack(data: bytes) -> datetime:
        from .times import TIMES, unpack_time

        return unpack_time(TIMES[type_name], data)

    return ValueType(type_name, registers, pack, unpack, is_time=True)


def _bit(name: str | Path, flag: object) -> int:
    return int(flag) if isinstance(flag, bool) else integer(name, flag, 0, 1)


def _text(size: int, encoding: str, padding: str, fill: bytes) -> ValueType:
    registers = (size + 1) // 2

    def pack(name: str | Path, value: object) -> bytes:
        if not isinstance(value, str):
            raise WrongType(name, f"must be a string, not {type(value).__name__}")
        data = encoded(name, value, encoding)
        room = size - len(data)
        if room < 0:
            given = f"{reprlib.repr(value)} with {len(data)}"
            raise WrongValue(name, f"must have 0..{size} bytes in {encoding}, not {given}")
        if room % len(fill):
            raise WrongValue(
                name, f"leaves {room} bytes of {size}, and padding fills {len(fill)} at a time"
            )
        return (data + fill * (room // len(fill))).ljust(2 * registers, b"\0")

    def unpack(data: bytes) -> str:
        try:
            return data[:size].decode(encoding).rstrip(padding)
        except UnicodeError:
            raise ValueError(f"{data[:size].hex(' ').upper()} is no {encoding}") from None

    return ValueType(f"string:{size}", registers, pack, unpack, is_text=True)


TIME_REGISTERS = {
    "unix32": 2, "unix64": 4, "ms64": 4, "iec870": 4, "date48": 3, "bcddate48": 3, "date96": 6,
}  # fmt: skip
"""Types of times -> their registers; `times` has their forms."""

TYPES: dict[str, ValueType] = {
    made.name: made
    for made in (
        *(_integers(bits, signed=True) for bits in (16, 32, 64)),
        *(_integers(bits, signed=False) for bits in (16, 32, 64)),
        _floats(16, "e", 65504.0),
        _floats(32, "f", (2 - 2**-23) * 2.0**127),
        _floats(64, "d", sys.float_info.max),
        *(_decimals(bits) for bits in (16, 32, 64)),
        *(_flags(bits) for bits in (16, 32, 64)),
        *(_moments(name, registers) for name, registers in TIME_REGISTERS.items()),
        ValueType("eui48", 4, pack_mac, unpack_mac),
    )
}
"""Name -> type, in the order ABCD; strings are made by `value_type`."""


def value_type(
    name: str, *, order: str = "ABCD", encoding: str = "ascii", padding: str = "\0"
) -> ValueType:
    """
    Return a type by its name; the name and the options are checked here.

    Args:
        name: the name as in the module's docstring, or as vendors write it, such as "FLOAT" or
            "u16".
        order: ABCD, CDAB, BADC or DCBA, or written out for the width of the type, in upper
            or lower case; or in words, such as "word swapped" or "byte swapped".
        encoding: the encoding of strings: one of `ENCODINGS`, or another name that Python has
            for one of them, such as "latin-1" or "windows-1252".
        padding: the character with which strings are filled up, and which is removed from
            their ends.

    Raises:
        TypeError, ValueError: there is no such type, order, encoding or padding.
    """
    kind = _known(name) or _string(name, encoding, padding)
    return replace(kind, order=_order(order, kind))


def _known(name: object) -> ValueType | None:
    if not isinstance(name, str):
        raise WrongType("type", f"must be a string, such as float32, not {type(name).__name__}")
    return TYPES.get(name) or TYPES.get(type_named(name) or "")


def _string(name: str, encoding: str, padding: str) -> ValueType:
    found = re.fullmatch(r"string:([0-9]{1,9})", type_named(name) or "")
    if not found:
        wanted = f"one of {', '.join(TYPES)}, string:N"
        close = close_word(name, TYPES, TYPE_WORDS)
        raise WrongValue("type", f"must be {wanted}, not {reprlib.repr(name)}{close}")
    size = int(found[1])
    if not 1 <= size <= MAX_STRING_BYTES:
        raise WrongValue("type", f"string:N: N must be in 1..{MAX_STRING_BYTES}, not {size}")
    return _text(size, encoding, padding, fill_of(padding, encoding))


# --- interpretations ----------------------------------------------------------------------


class Interpretation(NamedTuple):
    """
    One way to interpret some registers.

    Attributes:
        type: the type, as in the module's docstring.
        order: ABCD, CDAB, BADC or DCBA.
        value: the value of the registers in this type and order.
    """

    type: str
    order: str
    value: Any


def readings(registers: Iterable[int]) -> list[Interpretation]:
    """
    Return all interpretations of registers as one value.

    This helps when a manual is wrong: one of the interpretations is the value that the device
    displays. If several orders of a type lead to the same value, only the first one is returned
    (ABCD, CDAB, BADC, DCBA).

    Args:
        registers: 1..125 registers, 0..65535 each. For 1, 2 and 4 registers the result contains
            numbers, bits and text; for other counts ASCII text only, or nothing.

    Raises:
        TypeError, ValueError: there are not 1..125 registers, or one is not 0..65535.
    """
    cells = _cells(registers)
    count = integer("the number of registers", len(cells), 1, 125)
    fitting = [kind for kind in TYPES.values() if kind.registers == count]
    names = [kind.name for kind in fitting if kind.limits or kind.name.startswith("bits")]
    found: dict[tuple[str, str], Interpretation] = {}
    for name in [*names, f"string:{2 * count}"]:
        for order in ORDERS:
            try:
                value = value_type(name, order=order).decode(cells)
            except ValueError:
                continue
            # By repr, because a nan is not equal to itself.
            found.setdefault((name, repr(value)), Interpretation(name, order, value))
    return list(found.values())
