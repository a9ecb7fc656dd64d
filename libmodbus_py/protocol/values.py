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
* string:N: N bytes of text, 1..250, two in each register, up to the first NUL; if N is odd, the
  last byte of the last register is written as 0 and ignored when read.

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

The float functions of libmodbus are not used, because they differ between versions.
"""

from __future__ import annotations

import re
import reprlib
import struct
import sys
from collections.abc import Iterable
from dataclasses import replace
from encodings import normalize_encoding
from encodings.aliases import aliases
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsFloat, SupportsIndex

from .checks import integer, shown
from .mistakes import Path, WrongType, WrongValue, item
from .value_types import ORDERS, ValueType, cells_of, checked_order, items_of
from .words import (
    MAX_STRING_BYTES,
    TYPE_WORDS,
    BitsType,
    Layout,
    NumberType,
    Order,
    Reference,
    StringType,
    TextOptions,
    TextType,
    TimeType,
    TypeName,
    close_word,
    parse_reference,
    string_type,
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


# --- types of numbers, bits, times and text -------------------------------------------------


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
        if isinstance(value, bool) or not isinstance(value, SupportsFloat | SupportsIndex):
            raise WrongType(name, f"must be a number, not {type(value).__name__}")
        try:
            return form.pack(float(value))
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
        flags = items_of(name, value)
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


# fmt: off
ENCODINGS = frozenset((
    "ascii", "latin_1", "utf_8", "utf_16", "utf_16_be", "utf_16_le", "utf_32", "utf_32_be",
    "utf_32_le", "cp1250", "cp1251", "cp1252", "cp1253", "cp1254", "cp1255", "cp1256", "cp1257",
    "cp1258", "cp437", "cp737", "cp775", "cp850", "cp852", "cp855", "cp857", "cp858", "cp860",
    "cp861", "cp862", "cp863", "cp864", "cp865", "cp866", "cp869", "iso8859_2", "iso8859_3",
    "iso8859_4", "iso8859_5", "iso8859_6", "iso8859_7", "iso8859_8", "iso8859_9", "iso8859_10",
    "iso8859_11", "iso8859_13", "iso8859_14", "iso8859_15", "iso8859_16", "koi8_r", "koi8_u",
    "mac_roman", "tis_620", "shift_jis", "cp932", "euc_jp", "gb2312", "gbk", "gb18030", "big5",
    "cp950", "euc_kr", "cp949",
))
# fmt: on
"""
The encodings of strings in registers, by Python's names of their modules. Not all that Python
knows: some take the square of the text's length (punycode), and every other name would import
a module.
"""


def _text(size: int, encoding: str, padding: str, fill: bytes) -> ValueType:
    registers = (size + 1) // 2
    nul = _fill_of("\0", encoding)

    def pack(name: str | Path, value: object) -> bytes:
        if not isinstance(value, str):
            raise WrongType(name, f"must be a string, not {type(value).__name__}")
        if "\0" in value:
            raise WrongValue(name, f"must be without NUL, which ends it: {reprlib.repr(value)}")
        data = _encoded(name, value, encoding)
        room = size - len(data)
        if room < 0:
            given = f"{reprlib.repr(value)} with {len(data)}"
            raise WrongValue(name, f"must have 0..{size} bytes in {encoding}, not {given}")
        if room % len(fill):
            reason = f"leaves {room} bytes of {size}, and padding fills {len(fill)} at a time"
            raise WrongValue(name, reason)
        return (data + fill * (room // len(fill))).ljust(2 * registers, b"\0")

    def unpack(data: bytes) -> str:
        text = _up_to(nul, data[:size])
        try:
            return text.decode(encoding).rstrip(padding)
        except UnicodeError:
            raise ValueError(f"{text.hex(' ').upper()} is no {encoding}") from None

    return ValueType(f"string:{size}", registers, pack, unpack, is_text=True)


def _up_to(nul: bytes, data: bytes) -> bytes:
    """Return the characters before the first NUL, which has as many bytes as they have."""
    if len(nul) == 1:
        return data.partition(nul)[0]
    ends = (at for at in range(0, len(data), len(nul)) if data.startswith(nul, at))
    return data[: next(ends, None)]


def _known_encoding(encoding: str) -> bool:
    # Python drops other characters from the name, though not everywhere; 3.15 warns of them.
    if not (encoding.isascii() and encoding.isprintable()):
        return False
    name = normalize_encoding(encoding.lower())
    return aliases.get(name, name) in ENCODINGS


def _encoded(name: str | Path, value: str, encoding: str) -> bytes:
    try:
        return value.encode(encoding)
    except UnicodeError:
        raise WrongValue(name, f"must be {encoding}, not {reprlib.repr(value)}") from None


def _fill_of(padding: str, encoding: str) -> bytes:
    """Return the bytes of one more padding: without the mark that begins UTF-16 text."""
    for name, given in (("encoding", encoding), ("padding", padding)):
        if not isinstance(given, str):
            raise WrongType(name, f"must be a string, not {type(given).__name__}")
    if len(padding) != 1:
        raise WrongValue("padding", f"must be one character, not {reprlib.repr(padding)}")
    if not _known_encoding(encoding):
        wanted = "ascii, latin-1, utf-8, cp1252 or another of values.ENCODINGS"
        raise WrongValue("encoding", f"must be {wanted}, not {reprlib.repr(encoding)}")
    one, two = (_encoded("padding", padding * count, encoding) for count in (1, 2))
    return two[len(one) :]


_MAC = re.compile(r"[0-9A-Fa-f]{2}(?:[:-][0-9A-Fa-f]{2}){5}", re.ASCII)


def _pack_mac(name: str | Path, value: object) -> bytes:
    if not isinstance(value, str):
        raise WrongType(name, f"must be a string, not {type(value).__name__}")
    if not _MAC.fullmatch(value):
        raise WrongValue(name, f"must be like 0D:D7:4C:C6:44:8E, not {reprlib.repr(value)}")
    return bytes.fromhex(f"0000{value.replace(':', '').replace('-', '')}")


def _unpack_mac(data: bytes) -> str:
    return data[2:].hex(":").upper()  # behind two bytes of padding, which may hold anything


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
        ValueType("eui48", 4, _pack_mac, _unpack_mac),
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
    if not isinstance(name, str):
        raise WrongType("type", f"must be a string, such as float32, not {type(name).__name__}")
    known = TYPES.get(name) or TYPES.get(type_named(name) or "")
    kind = known or _string(name, encoding, padding)
    return replace(kind, order=checked_order(order, kind))


def _string(name: str, encoding: str, padding: str) -> ValueType:
    found = re.fullmatch(r"string:([0-9]{1,9})", type_named(name) or "")
    if not found:
        wanted = f"one of {', '.join(TYPES)}, string:N"
        close = close_word(name, TYPES, TYPE_WORDS)
        raise WrongValue("type", f"must be {wanted}, not {reprlib.repr(name)}{close}")
    size = int(found[1])
    if not 1 <= size <= MAX_STRING_BYTES:
        raise WrongValue("type", f"string:N: N must be in 1..{MAX_STRING_BYTES}, not {size}")
    return _text(size, encoding, padding, _fill_of(padding, encoding))


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
    cells = cells_of(registers)
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
            if value == "" and any(cells):
                continue  # numbers with a 0 in front, rather than text
            # By repr, because a nan is not equal to itself.
            found.setdefault((name, repr(value)), Interpretation(name, order, value))
    return list(found.values())
