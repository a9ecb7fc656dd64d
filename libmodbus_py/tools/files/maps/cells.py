"""
Readers for the cells of vendors' tables, one for each kind of column.
"""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Callable, Iterable
from typing import Any

from ....maps.point_checks import BYTES, SCALES
from ....protocol.mistakes import WrongValue
from ....protocol.words import ORDER_WORDS, TABLE_WORDS, TYPE_WORDS, plain, type_named
from ..csv_text import flag_in, number_in, whole_in
from .words import ACCESS_WORDS, FUNCTION_TABLES

__all__ = ["PADDINGS", "READERS"]

_FUNCTION = re.compile(r"(?<![0-9a-z])(?:fc|f|0x)? ?([0-9]{1,2})(?![0-9a-z])")


def _word(meanings: dict[str, str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if found := meanings.get(plain(text)):
            return found
        allowed = ", ".join(dict.fromkeys(meanings.values()))
        raise WrongValue((), f"must be one of {allowed}, not {reprlib.repr(text)}")

    return read


def _by_itself(words: Iterable[str]) -> dict[str, str]:
    return {word: word for word in words}


def _type(text: str) -> str:
    return type_named(text) or _type_word(text)


def _order(text: str) -> str:
    return ORDER_WORDS.get(plain(text), text)


def _function(text: str) -> str:
    """Return the table of "3", "03/06/16", "0x04" or "FC 3"."""
    codes = [int(code) for code in _FUNCTION.findall(text.casefold())]
    tables = {FUNCTION_TABLES.get(code) for code in codes}
    if len(tables) != 1 or None in tables:
        allowed = ", ".join(map(str, FUNCTION_TABLES))
        raise WrongValue((), f"must be of {allowed}, all of one table, not {reprlib.repr(text)}")
    return str(*tables)


def _missing(text: str) -> str | list[int | float]:
    """Return the numbers of "65535" or "0x8000; -1", or the word sunspec."""
    if plain(text) == "sunspec":
        return "sunspec"
    return [_raw(each) for each in re.split(r"[;,\s]+", text.strip("; "))]


def _raw(text: str) -> int | float:
    return whole_in(text) if text.casefold().startswith("0x") else number_in(text)


def _names(text: str) -> dict[str, str]:
    """Return the names of "0 = off; 1 = on", or of a JSON object."""
    if text.startswith("{"):
        return _object(text)
    found: dict[str, str] = {}
    for each in text.strip("; ").split(";"):
        key, separator, name = each.partition("=")
        if not separator or not name.strip():
            raise WrongValue((), f"must be like 0 = off; 1 = on, not {reprlib.repr(text)}")
        if key.strip() in found:
            raise WrongValue((), f"must name {key.strip()} once, not twice")
        found[key.strip()] = name.strip()
    return found


def _object(text: str) -> dict[str, str]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise WrongValue((), f"must be a JSON object, not {reprlib.repr(text)}") from None
    return dict(found)


_type_word = _word({**TYPE_WORDS, "string:n": "string:N"})

PADDINGS = {"space": " ", "nul": "\0"}
"""Word -> the character that it stands for in the column of paddings."""

READERS: dict[str, Callable[[str], Any]] = {
    "name": str,
    "table": _word(TABLE_WORDS),
    "function": _function,
    "address": whole_in,
    "count": whole_in,
    "type": _type,
    "order": _order,
    "encoding": str,
    "padding": lambda text: PADDINGS.get(plain(text), text),
    "scale": number_in,
    "divisor": number_in,
    "offset": number_in,
    "units": str,
    "access": _word(ACCESS_WORDS),
    "minimum": number_in,
    "maximum": number_in,
    "description": str,
    "missing": _missing,
    "plausible_minimum": number_in,
    "plausible_maximum": number_in,
    "never_falls": flag_in,
    "scale_from": str,
    "scale_as": _word(_by_itself(SCALES)),
    "states": _names,
    "bits": _names,
    "bit": str,
    "byte": _word(_by_itself(BYTES)),
    "time_zone": str,
    "interval": number_in,
    "group": str,
}
"""Kind of a column -> the reader that returns the argument of `Point`, or raises WrongValue."""
