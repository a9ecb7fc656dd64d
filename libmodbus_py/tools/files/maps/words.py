"""
The headings and accesses of vendors' tables, and their meanings.

The words of tables, types and orders stand in `protocol.words`. Only words that every vendor
means alike are here: a "gain" multiplies with some and divides with others, and a wrong guess
would be a wrong value.
"""

from __future__ import annotations

from ....protocol.words import by_word

__all__ = ["ACCESS_WORDS", "COLUMNS", "DOUBTFUL_COLUMNS", "FUNCTION_TABLES"]

COLUMNS = by_word(
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
        "padding": "",
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
        "time_zone": "timezone",
        "interval": "poll interval, polling interval",
        "group": "",
    }
)
"""Heading of a column -> kind of the column."""

DOUBTFUL_COLUMNS = {
    "gain": "scale (raw values are multiplied by it) or divisor",
    "sf": "scale, and write the factor itself: some write the power of ten, or its register",
}
"""Ambiguous heading -> names to use instead, because its meaning differs between vendors."""

FUNCTION_TABLES = {
    **dict.fromkeys((1, 5, 15), "coils"),
    2: "discrete_inputs",
    **dict.fromkeys((3, 6, 16, 22, 23), "holding_registers"),
    4: "input_registers",
}
"""Function code -> the table that it reads or writes."""

ACCESS_WORDS = by_word(
    {
        "read": "r, ro, read only, readonly",
        "write": "w, wo, write only, writeonly",
        "read_write": "read write, rw, r w, readwrite, wr, w r",
    }
)
