"""
Values: how registers are interpreted, and how manuals number them (`words`).

Modbus carries 16-bit registers, high byte first. Everything else is a convention of the
device; this module knows the usual ones. Types are named by strings:

* int16, uint16, int32, uint32, int64, uint64;
* int8, uint8: the low byte of a register, the high one in the order BADC; int24, uint24: the last
  three bytes of two registers; int48, uint48: three registers. What is in front of 8 or 24 bits is
  ignored when it is read, and written as the sign;
* signmag16, signmag32: a bit for the sign in front of the amount, in place of two's complement;
* mod10k32, mod10k48, mod10k64: modulo 10000, which is four decimal digits in each register and the
  rest in the first one; of negative numbers, all registers are negative. umod10k32, umod10k48,
  umod10k64: the same without a sign;
* float16, float32, float64 (IEEE 754);
* bcd16, bcd32, bcd64: decimal digits, four in each register; sbcd16, sbcd32: the same with a sign
  in place of the first digit, 0 or, for minus, F; 8 is taken for minus, too;
* bits16, bits32, bits64: lists of True and False, lowest bit first;
* unix32, unix64: seconds since 1970; ms64: milliseconds; unsigned with 32 bits, signed with 64;
  y2k32: seconds since 2000, unsigned;
* iec870: CP56Time2a of IEC 60870-5-4 in the four registers of Schneider's devices;
* date48: six bytes, year (since 2000), month, day, hour, minute, second; bcddate48: the same in
  decimal digits; date64: four registers, year (since 2000), month and day of the week, day and
  hour, minute and second, in two bytes each; date96: six registers, with the full year;
  shortdate96: the same with the year since 2000;
* eui48: a MAC address as text, such as "0D:D7:4C:C6:44:8E", behind a register of padding;
* string:N: N bytes of text, 1..250, two in each register, up to the first NUL; if N is odd, the
  last byte of the last register is written as 0 and ignored when read.

An order tells how the bytes A (most significant), B, C, D of a value are arranged in the
registers. Four letters name the order for all widths; for 16, 48 and 64 bits it may also be
written out:

==== == ====== ======== ================ ========================
name 16 48     64 bits  meaning          registers of 0x12345678
==== == ====== ======== ================ ========================
ABCD AB ABCDEF ABCDEFGH big-endian       1234 5678
CDAB AB EFCDAB GHEFCDAB words swapped    5678 1234
BADC BA BADCFE BADCFEHG bytes swapped    3412 7856
DCBA BA FEDCBA HGFEDCBA little-endian    7856 3412
==== == ====== ======== ================ ========================

Values of 64 bits have four more: EFGHABCD (the halves swapped), CDABGHEF (the words of each half
swapped), and the same with the bytes of each word swapped, FEHGBADC and DCBAHGFE.

Text is always in reading order: its registers are never reversed, only the bytes of
each are swapped (BADC, DCBA).

The float functions of libmodbus are not used, because they differ between versions.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable
from dataclasses import replace
from encodings import normalize_encoding
from encodings.aliases import aliases
from typing import TYPE_CHECKING, Any, NamedTuple

from .checks import integer, string
from .mistakes import Path, WrongType, WrongValue
from .plain import text_of
from .value_types import NUMBERS, ORDERS, WIDE_ORDERS, ValueType, cells_of, checked_order
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
    "ENCODINGS", "ORDERS", "WIDE_ORDERS", "BitsType", "Interpretation", "Layout", "NumberType",
    "Order", "Reference", "StringType", "TextOptions", "TextType", "TimeType", "TypeName",
    "ValueType", "parse_reference", "readings", "string_type", "value_type",
]
# fmt: on


# --- types of times and text ------------------------------------------------------------------


def _moments(type_name: str, registers: int) -> ValueType:
    # Imported when first used: most programs read no times.
    def pack(name: str | Path, value: object) -> bytes:
        from .times import TIMES, pack_time

        return pack_time(TIMES[type_name], name, value)

    def unpack(data: bytes) -> datetime:
        from .times import TIMES, unpack_time

        return unpack_time(TIMES[type_name], data)

    return ValueType(type_name, registers, pack, unpack, is_time=True)


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

    def pack(name: str | Path, value: Any) -> bytes:
        if "\0" in string(name, value):
            raise WrongValue(name, f"must be without NUL, which ends it: {reprlib.repr(value)}")
        data = _encoded(name, value, encoding)
        room = size - len(data)
        if room < 0:
            text = f"{reprlib.repr(value)} with {len(data)}"
            raise WrongValue(name, f"must have 0..{size} bytes in {encoding}, not {text}")
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
    string("encoding", encoding)
    if len(string("padding", padding)) != 1:
        raise WrongValue("padding", f"must be one character, not {reprlib.repr(padding)}")
    if not _known_encoding(encoding):
        form = "ascii, latin-1, utf-8, cp1252 or another of values.ENCODINGS"
        raise WrongValue("encoding", f"must be {form}, not {reprlib.repr(encoding)}")
    one, two = (_encoded("padding", padding * count, encoding) for count in (1, 2))
    return two[len(one) :]


_MAC = r"[0-9A-Fa-f]{2}(?:[:-][0-9A-Fa-f]{2}){5}"


def _pack_mac(name: str | Path, value: Any) -> bytes:
    if not re.fullmatch(_MAC, string(name, value)):
        raise WrongValue(name, f"must be like 0D:D7:4C:C6:44:8E, not {reprlib.repr(value)}")
    return bytes.fromhex(f"0000{value.replace(':', '').replace('-', '')}")


TIME_REGISTERS = {
    "unix32": 2, "unix64": 4, "ms64": 4, "y2k32": 2, "iec870": 4, "date48": 3, "bcddate48": 3,
    "date64": 4, "date96": 6, "shortdate96": 6,
}  # fmt: skip
"""Types of times -> their registers; `times` has their forms."""

TYPES: dict[str, ValueType] = {
    kind.name: kind
    for kind in (
        *NUMBERS,
        *(_moments(name, registers) for name, registers in TIME_REGISTERS.items()),
        # Two bytes of padding may hold anything.
        ValueType("eui48", 4, _pack_mac, lambda data: data[2:].hex(":").upper()),
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
    row = TYPES.get(name) or TYPES.get(type_named(name) or "")
    kind = row or _string(name, encoding, padding)
    return replace(kind, order=checked_order(order, kind))


def _string(name: str, encoding: str, padding: str) -> ValueType:
    match = re.fullmatch(r"string:([0-9]{1,9})", type_named(name) or "")
    if not match:
        names = f"one of {', '.join(TYPES)}, string:N"
        close = close_word(name, [*TYPES, "string:N"], TYPE_WORDS)
        raise WrongValue("type", f"must be {names}, not {reprlib.repr(name)}{close}")
    size = int(match[1])
    if not 1 <= size <= MAX_STRING_BYTES:
        raise WrongValue("type", f"string:N: N must be in 1..{MAX_STRING_BYTES}, not {size}")
    return _text(size, encoding, padding, _fill_of(padding, encoding))


# --- interpretations ----------------------------------------------------------------------


class Interpretation(NamedTuple):
    """
    One way to interpret some registers.

    Attributes:
        type: the type, as in the module's docstring.
        order: one of `Order`.
        value: the value of the registers in this type and order.
    """

    type: str
    order: str
    value: Any

    @property
    def doubt(self) -> tuple[bool, bool, int]:
        """
        The degree of implausibility, to compare the value with others of the same registers.

        A number, or a text without control characters, is the more plausible the fewer characters
        it has for its registers. Behind these come what few devices have, and what is mostly
        chance: numbers with an exponent, texts of less than four characters, float16 and BCD; then
        bits.
        """
        kind = value_type(self.type)
        text = self.value if kind.is_text else text_of(self.value, kind)
        if kind.is_text:
            # Of two random registers, 1 of 50 are printable.
            is_chance = len(text) < 4 or not text.isprintable()
        else:
            is_chance = not re.fullmatch("-?[0-9.]+", text) or not self.type.startswith(_LIKELY)
        return self.type.startswith("bits"), is_chance, len(text) - 4 * kind.registers


_LIKELY = ("int", "uint", "float32", "float64")
_USUAL = "(u?int|float|bcd|bits)(16|32|48|64)"


def readings(registers: Iterable[int]) -> list[Interpretation]:
    """
    Return all interpretations of registers as one value, the most plausible ones first.

    This helps when a manual is wrong: one of the interpretations is the value that the device
    displays. If several orders of a type lead to the same value, only the first one is returned
    (ABCD, CDAB, BADC, DCBA, then those of 64 bits only). Types that few devices have are left out,
    such as mod10k32.

    Args:
        registers: 1..125 registers, 0..65535 each. For 1..4 registers the result contains
            numbers, bits and text; for other counts ASCII text only, or nothing.

    Raises:
        TypeError, ValueError: there are not 1..125 registers, or one is not 0..65535.
    """
    cells = cells_of(registers)
    count = integer("the number of registers", len(cells), 1, 125)
    kinds = [kind for kind in TYPES.values() if kind.registers == count]
    names = [kind.name for kind in kinds if re.fullmatch(_USUAL, kind.name)]
    orders = [*ORDERS, *(WIDE_ORDERS if 2 * count == len(WIDE_ORDERS[0]) else ())]
    interpretations: dict[tuple[str, str], Interpretation] = {}
    for name in [*names, f"string:{2 * count}"]:
        for order in orders if name in TYPES else ORDERS:
            try:
                value = value_type(name, order=order).decode(cells)
            except ValueError:
                continue
            if value == "" and any(cells):
                continue  # numbers with a 0 in front, rather than text
            # By repr, because a nan is not equal to itself.
            interpretations.setdefault((name, repr(value)), Interpretation(name, order, value))
    # Of equal doubt, an unsigned integer is the last: it is mostly a signed one, too.
    return sorted(
        interpretations.values(), key=lambda one: (one.doubt, one.type.startswith("uint"))
    )
