"""
Cells of vendors' tables: what each becomes, by what its column holds.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Callable
from typing import Any

from .words import (
    ACCESS_WORDS,
    FUNCTION_TABLES,
    ORDER_WORDS,
    TABLE_WORDS,
    TYPE_WORDS,
    plain,
)

__all__ = ["READERS"]

_DECIMAL = re.compile(r"[+-]?([0-9]{1,40}(\.[0-9]{0,40})?|\.[0-9]{1,40})([eE][+-]?[0-9]{1,3})?")
_STRING = re.compile(r"(?:string|str|char|ascii|text) ?:? ?([0-9]{1,9})")
_FUNCTION = re.compile(r"(?<![0-9a-z])(?:fc|f|0x)? ?([0-9]{1,2})(?![0-9a-z])")


def _number(text: str) -> int | float:
    """Read 10, 0.1, 1e-3 or 1/10."""
    over, slash, under = text.partition("/")
    if not _DECIMAL.fullmatch(over) or (slash and not _DECIMAL.fullmatch(under)):
        hint = " with a point, not a comma," if "," in text else ""
        raise ValueError(f"must be a number such as 0.1,{hint} not {reprlib.repr(text)}")
    if not slash:
        return int(over) if re.fullmatch("[+-]?[0-9]+", over) else float(over)
    if not float(under):
        raise ValueError(f"must not divide by 0: {reprlib.repr(text)}")
    return float(over) / float(under)


def _integer(text: str) -> int:
    if re.fullmatch("[0-9]{1,20}", text):
        return int(text)
    if found := re.fullmatch("0x([0-9a-f]{1,16})|([0-9a-f]{1,16})h", text.casefold()):
        return int(found[1] or found[2], 16)
    raise ValueError(f"must be a whole number such as 100, 0x64 or 64h, not {reprlib.repr(text)}")


def _word(meanings: dict[str, str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if found := meanings.get(plain(text)):
            return found
        allowed = ", ".join(dict.fromkeys(meanings.values()))
        raise ValueError(f"must be one of {allowed}, not {reprlib.repr(text)}")

    return read


def _type(text: str) -> str:
    found = _STRING.fullmatch(plain(text))
    return f"string:{found[1]}" if found else _type_word(text)


def _order(text: str) -> str:
    return ORDER_WORDS.get(plain(text), text)


def _function(text: str) -> str:
    """The table of "3", "03/06/16", "0x04" or "FC 3"."""
    codes = [int(code) for code in _FUNCTION.findall(text.casefold())]
    tables = {FUNCTION_TABLES.get(code) for code in codes}
    if len(tables) != 1 or None in tables:
        allowed = ", ".join(map(str, FUNCTION_TABLES))
        raise ValueError(f"must be of {allowed}, all of one table, not {reprlib.repr(text)}")
    return str(*tables)


_type_word = _word({**TYPE_WORDS, "string:n": "string:N"})

READERS: dict[str, Callable[[str], Any]] = {
    "name": str,
    "table": _word(TABLE_WORDS),
    "function": _function,
    "address": _integer,
    "count": _integer,
    "type": _type,
    "order": _order,
    "encoding": str,
    "scale": _number,
    "divisor": _number,
    "offset": _number,
    "unit": str,
    "access": _word(ACCESS_WORDS),
    "minimum": _number,
    "maximum": _number,
    "description": str,
}
"""What a column holds -> what makes the argument of a cell; ValueError says what is allowed."""
