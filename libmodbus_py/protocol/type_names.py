"""
The names of types and orders, as `values` explains them; type checkers find wrong names.
"""

from __future__ import annotations

from typing import Literal, NewType, TypeAlias, TypedDict

from .checks import integer

# fmt: off
__all__ = [
    "MAX_STRING_BYTES", "BitsType", "FloatType", "IntegerType", "Layout", "NumberType", "Order",
    "StringType", "TextOptions", "TextType", "TimeType", "TypeName", "string_type",
]
# fmt: on

Order = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""The orders of bytes, by the names that hold for every width."""
# fmt: off
IntegerType = Literal[
    "int16", "int32", "int64", "uint16", "uint32", "uint64", "bcd16", "bcd32", "bcd64",
]
"""Types whose values are whole numbers."""
FloatType = Literal["float16", "float32", "float64"]
"""Types whose values are floats."""
NumberType = Literal[IntegerType, FloatType]
"""Types whose values are numbers."""
BitsType = Literal["bits16", "bits32", "bits64"]
"""Types whose values are lists of True and False."""
TimeType = Literal["unix32", "unix64", "ms64", "iec870", "date48", "bcddate48", "date96"]
"""Types whose values are datetimes."""
StringType = NewType("StringType", str)
"""The name of a type of strings of any length, as `string_type` returns it."""
TextType: TypeAlias = Literal[
    "string:1", "string:2", "string:3", "string:4", "string:5", "string:6", "string:7", "string:8",
    "string:10", "string:12", "string:14", "string:16", "string:18", "string:20", "string:24",
    "string:28", "string:30", "string:32", "string:40", "string:48", "string:50", "string:64",
] | StringType
"""Types whose values are text: the usual lengths; `string_type` has the others."""
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
