"""
The words of vendors' tables, and their meanings.

Only words that every vendor means alike are here: a "gain" multiplies with some and divides
with others, a "long" has 32 bits or 64, and a wrong guess would be a wrong value.
"""

from __future__ import annotations

import re

__all__ = [
    "ACCESS_WORDS",
    "COLUMNS",
    "DOUBTFUL_COLUMNS",
    "FUNCTION_TABLES",
    "ORDER_WORDS",
    "TABLE_WORDS",
    "TYPE_WORDS",
    "plain",
]


def plain(text: str) -> str:
    """Return a word in the form of the tables below: "Data_Type " is "data type"."""
    return " ".join(re.split(r"[\s_./()\[\]-]+", text.casefold())).strip()


def _by_word(meanings: dict[str, str]) -> dict[str, str]:
    """Invert meaning -> words, with commas, to word -> meaning; a meaning is a word for itself."""
    return {
        word: meaning
        for meaning, words in meanings.items()
        for word in (plain(meaning), *filter(None, words.split(", ")))
    }


COLUMNS = _by_word(
    {
        "name": "parameter, parameter name, point, point name, signal, signal name, tag, tag name,"
        " variable, variable name, register name, symbol, label",
        "table": "register type, reg type, register table, object type, modbus table, area,"
        " modbus type",
        "function": "function code, fc, modbus function, func, func code",
        "address": "register, reg, register address, reg address, start address, addr,"
        " start register, modbus address, modbus register, register number, offset address",
        "count": "values",
        "type": "data type, datatype, value type, format, data format",
        "order": "byte order, word order, endianness, endian",
        "encoding": "",
        "scale": "factor, multiplier, scaling, scale factor, scaling factor, multiply by",
        "divisor": "divider, divide by",
        "offset": "value offset",
        "units": "unit, engineering unit, engineering units, eng unit, uom",
        "access": "r w, rw, access type, access mode, read write, mode, permission, permissions",
        "minimum": "min, min value, low limit, lower limit",
        "maximum": "max, max value, high limit, upper limit",
        "description": "comment, comments, remark, remarks, note, notes, details, meaning",
        "missing": "missing value, missing values",
        "plausible_minimum": "",
        "plausible_maximum": "",
        "never_falls": "",
        "scale_from": "",
        "scale_as": "",
        "states": "",
        "bits": "",
        "bit": "",
        "byte": "",
    }
)
"""Heading of a column -> kind of the column."""

DOUBTFUL_COLUMNS = {
    "gain": "scale (raw values are multiplied by it) or divisor",
    "sf": "scale, and write the factor itself: some write the power of ten, or its register",
}
"""Ambiguous heading -> names to use instead, because its meaning differs between vendors."""

TABLE_WORDS = _by_word(
    {
        "coils": "coil, 0x, 0xxxx, 0xxxxx, digital output, digital outputs, do",
        "discrete_inputs": "discrete inputs, discrete input, discrete, di, input status,"
        " 1x, 1xxxx, 1xxxxx, digital input, digital inputs",
        "holding_registers": "holding registers, holding register, holding, hold, hr,"
        " 4x, 4xxxx, 4xxxxx",
        "input_registers": "input registers, input register, input, ir, 3x, 3xxxx, 3xxxxx",
    }
)

FUNCTION_TABLES = {
    **dict.fromkeys((1, 5, 15), "coils"),
    2: "discrete_inputs",
    **dict.fromkeys((3, 6, 16, 22, 23), "holding_registers"),
    4: "input_registers",
}
"""Function code -> the table that it reads or writes."""

# int, dint, word and similar names as in IEC 61131-3; acc, enum, bitfield and sunssf of SunSpec.
TYPE_WORDS = _by_word(
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
        "bcd16": "",
        "bcd32": "",
        "bcd64": "",
        "bits16": "bitfield16, bitmap16, bitmask16",
        "bits32": "bitfield32, bitmap32, bitmask32",
        "bits64": "bitfield64, bitmap64, bitmask64",
        "unix32": "",
        "unix64": "",
        "ms64": "",
        "iec870": "",
        "date48": "",
        "bcddate48": "",
        "date96": "",
        "bool": "boolean, bit",
    }
)
"""Word -> type; "bool" is that of tables of bits, which has no name here."""

ORDER_WORDS = _by_word(
    {
        "ABCD": "big endian, be",
        "CDAB": "word swapped, word swap, swapped words",
        "BADC": "byte swapped, byte swap, swapped bytes",
        "DCBA": "little endian, le",
    }
)

ACCESS_WORDS = _by_word(
    {
        "read": "r, ro, read only, readonly",
        "write": "w, wo, write only, writeonly",
        "read_write": "read write, rw, r w, readwrite, wr, w r",
    }
)
