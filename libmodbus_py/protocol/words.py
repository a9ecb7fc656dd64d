"""
The names of types and orders, as `values` explains them and type checkers know them; the words of
vendors and other tools for tables, types and orders; and references, such as 40123, by which
manuals number the items of tables.

Words are taken wherever a table, a type or an order is: by the clients, in register maps and device
files, and on the command line. Only words that every vendor means alike are here: a "long" has 32
bits or 64, and a wrong guess would be a wrong value.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal, NamedTuple, NewType, TypeAlias, TypedDict, get_args

from .checks import integer
from .mistakes import WrongValue, close_to

Order = Literal[
    "ABCD", "CDAB", "BADC", "DCBA", "EFGHABCD", "CDABGHEF", "FEHGBADC", "DCBAHGFE",
]  # fmt: skip
"""The orders of bytes: the names that hold for every width, and those of 64 bits only."""
# fmt: off
PlainIntegerType = Literal[
    "int8", "int16", "int24", "int32", "int48", "int64", "uint8", "uint16", "uint24", "uint32",
    "uint48", "uint64",
]
"""Types of which all registers hold a whole number."""
IntegerType = Literal[
    PlainIntegerType, "signmag16", "signmag32", "mod10k32", "mod10k48", "mod10k64", "umod10k32",
    "umod10k48", "umod10k64", "bcd16", "bcd32", "bcd64", "sbcd16", "sbcd32",
]
"""Types whose values are whole numbers."""
FloatType = Literal["float16", "float32", "float64"]
"""Types whose values are floats."""
NumberType = Literal[IntegerType, FloatType]
"""Types whose values are numbers."""
BitsType = Literal["bits16", "bits32", "bits64"]
"""Types whose values are lists of True and False."""
TimeType = Literal[
    "unix32", "unix64", "ms64", "y2k32", "iec870", "date48", "bcddate48", "date64", "date96",
    "shortdate96",
]
"""Types whose values are datetimes."""
StringType = NewType("StringType", str)
"""The name of a type of strings of any length, as `string_type` returns it."""
TextType: TypeAlias = Literal[
    "string:1", "string:2", "string:3", "string:4", "string:5", "string:6", "string:7", "string:8",
    "string:10", "string:12", "string:14", "string:16", "string:18", "string:20", "string:24",
    "string:28", "string:30", "string:32", "string:40", "string:48", "string:50", "string:64",
    "eui48",
] | StringType
"""Types whose values are text: MAC addresses, the usual lengths; `string_type` has the others."""
# fmt: on
TypeName: TypeAlias = NumberType | BitsType | TimeType | TextType
"""All of them."""

MAX_STRING_BYTES = 250
"""Bytes of a string: those of the 125 registers that one request can read."""


def string_type(size: int) -> StringType:
    """
    Return the name of the type of strings of a size, such as "string:77".

    At run time every such text is a type. Type checkers know the usual sizes, so that a misspelt
    type is an error with a short message; for other sizes they need this function.

    Args:
        size: bytes of text, 1..250.

    Raises:
        TypeError, ValueError: the size is of the wrong type or range.
    """
    return StringType(f"string:{integer('size', size, 1, MAX_STRING_BYTES)}")


class TextOptions(TypedDict, total=False):
    """The layout of strings in registers, as for `value_type`."""

    encoding: str
    padding: str


class Layout(TextOptions, total=False):
    """The layout of any value in registers."""

    order: Order


# --- words ---------------------------------------------------------------------------------

_STRING = re.compile(r"(?:string|str|char|ascii|text) ?:? ?([0-9]{1,9})")


def plain(text: str) -> str:
    """Return a word in the form of the tables below: "Data_Type " is "data type"."""
    return " ".join(re.split(r"[\s_./()\[\]-]+", text.casefold())).strip()


def by_word(meanings: dict[str, str]) -> dict[str, str]:
    """Invert meaning -> words, with commas, to word -> meaning; a meaning is a word for itself."""
    return {
        word: meaning
        for meaning, words in meanings.items()
        for word in (plain(meaning), *filter(None, words.split(", ")))
    }


TABLE_WORDS = by_word(
    {
        "coils": "coil, co, c, 0x, 0xxxx, 0xxxxx, digital output, digital outputs, do",
        "discrete_inputs": "discrete inputs, discrete input, discrete, di, input status,"
        " 1x, 1xxxx, 1xxxxx, digital input, digital inputs",
        "holding_registers": "holding registers, holding register, holding, hold, hr, h,"
        " 4x, 4xxxx, 4xxxxx",
        "input_registers": "input registers, input register, input, ir, 3x, 3xxxx, 3xxxxx",
    }
)

# int, dint, word and similar names as in IEC 61131-3; acc, enum, bitfield and sunssf of SunSpec.
TYPE_WORDS = by_word(
    {
        "int16": "int, i16, s16, sint16, signed16, signed int16, signed 16, sunssf",
        "uint16": "uint, u16, unsigned16, unsigned int16, unsigned 16, word, enum16, acc16",
        "int32": "dint, i32, s32, sint32, signed32, signed int32, signed 32",
        "uint32": "udint, u32, unsigned32, unsigned int32, unsigned 32, dword, enum32, acc32",
        "int64": "lint, i64, s64, sint64, signed64, signed int64, signed 64",
        "uint64": "ulint, u64, unsigned64, unsigned int64, unsigned 64, lword, acc64",
        "float16": "f16, half",
        "float32": "float, f32, single, real, ieee754, ieee 754, float 32",
        "float64": "double, f64, lreal, float 64",
        "bits16": "bitfield16, bitmap16, bitmask16",
        "bits32": "bitfield32, bitmap32, bitmask32",
        "bits64": "bitfield64, bitmap64, bitmask64",
        "int8": "i8, s8, sint8, signed8",
        "uint8": "u8, unsigned8",
        "int24": "i24, s24, sint24, signed24",
        "uint24": "u24, unsigned24",
        "int48": "i48, s48, sint48, signed48",
        "uint48": "u48, unsigned48",
        "eui48": "mac, mac address",
        "bool": "boolean, bit",
        **dict.fromkeys(("bcd16", "bcd32", "bcd64", "sbcd16", "sbcd32"), ""),
        **dict.fromkeys(("signmag16", "signmag32", "mod10k32", "mod10k48", "mod10k64"), ""),
        **dict.fromkeys(("umod10k32", "umod10k48", "umod10k64"), ""),
        **dict.fromkeys(get_args(TimeType), ""),
    }
)
"""Word -> type; "bool" is that of tables of bits, which has no name here."""

ORDER_WORDS = by_word(
    {
        "ABCD": "",
        "CDAB": "word swapped, word swap, swapped words",
        "BADC": "byte swapped, byte swap, swapped bytes",
        "DCBA": "",
    }
)

_LITTLE = ", which is DCBA to some, and CDAB (the low word first) to others"
_BIG = ", which is ABCD to some, and CDAB (each register alone, the low word first) to others"

_TWO_ORDERS = {
    **dict.fromkeys(("little endian", "little", "le"), _LITTLE),
    **dict.fromkeys(("big endian", "big", "be"), _BIG),
}
"""Word that names no order, because vendors mean two -> the end of the message about it."""


def table_named(text: object) -> str | None:
    """Return the name of a table, such as "holding_registers" for "hr" or "4x"; None if none."""
    return TABLE_WORDS.get(plain(text)) if isinstance(text, str) else None


def close_word(text: object, names: Iterable[str], words: Iterable[str]) -> str:
    """Return the end of a message about a word: close `names`, else `words`, or its two orders."""
    if words is ORDER_WORDS and (meanings := _TWO_ORDERS.get(plain(str(text)))):
        return meanings
    return close_to(text, names) or close_to(plain(str(text)), words)


def type_named(text: object) -> str | None:
    """Return the name of a type, such as "float32" for "FLOAT"; None for none, and for bits."""
    if not isinstance(text, str):
        return None
    match = _STRING.fullmatch(plain(text))
    if match and not text.lower().startswith("string:-"):
        return f"string:{match[1]}"
    name = TYPE_WORDS.get(plain(text))
    return None if name == "bool" else name


def order_named(text: object) -> str | None:
    """Return the name of an order, such as "CDAB" for "word swapped"; None if it is none."""
    return ORDER_WORDS.get(plain(text)) if isinstance(text, str) else None


# --- references ----------------------------------------------------------------------------

REFERENCE_TABLES = {
    "0": "coils",
    "1": "discrete_inputs",
    "3": "input_registers",
    "4": "holding_registers",
    "6": "file",
}
"""First digit of a reference -> table."""


class Reference(NamedTuple):
    """
    The table and address of a reference.

    Attributes:
        table: "coils", "discrete_inputs", "input_registers",
            "holding_registers" or "file" (a reference does not contain the file number).
        address: the 0-based address, or the record number.
    """

    table: str
    address: int


def parse_reference(text: str) -> Reference:
    """
    Return the table and address of a 5- or 6-digit reference (PI-MBUS-300).

    The first digit is the table, and the rest is the number of the item, counted from 1: "40123"
    is the holding register with address 122. Only file records are counted from 0: "600007" is
    record 7.

    Args:
        text: the reference, as a string because the leading zero of coils matters.

    Raises:
        TypeError: the argument is not a string.
        ValueError: the text is not a reference; the message tells what one looks like.
    """
    if not isinstance(text, str):
        kind = type(text).__name__
        raise TypeError(f'a reference must be a string, such as "40123", not {kind}')
    if not re.fullmatch(r"[0-9]{5,6}", text) or text[0] not in REFERENCE_TABLES:
        raise WrongValue(
            "reference",
            f"{text!r} must have 5 or 6 digits and begin with 0 (coil), 1 (discrete"
            " input), 3 (input register), 4 (holding register) or 6 (file record), as in 40123;"
            " addresses that count from 0 follow the name of a table, as in hr 122",
        )
    table, item = REFERENCE_TABLES[text[0]], int(text[1:])
    if table == "file":
        if item > 9999:
            raise WrongValue("reference", f"{text!r}: file records are 600000..609999")
        return Reference(table, item)
    if not 1 <= item <= 65536:
        first, last = f"{text[0]}{'1':0>{len(text) - 1}}", f"{text[0]}65536"
        raise WrongValue("reference", f"{text!r}: the items are {first}..{last}, counted from 1")
    return Reference(table, item - 1)
