"""
Register maps in TOML: a table ``[[point]]`` for each, with the arguments of `Point` as keys.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator
from typing import Any

from ....maps.point import MAX_DESCRIPTION
from ..toml_lines import below, line_of, path_at_start, shown_key
from ..toml_text import read_toml
from .drafts import KEYS, Draft, Mistake

__all__ = ["drafts"]


def drafts(text: str) -> Iterator[Draft | Mistake]:
    """Give what a text says of each point, or what is wrong with it."""
    try:
        content = read_toml(text, max_text=MAX_DESCRIPTION)
    except ValueError as error:
        yield Mistake(_place(text, path_at_start(str(error))), str(error))
        return
    for key in content:
        if key != "point":
            message = f"{shown_key(key)} means nothing here; points are tables [[point]]"
            yield Mistake(_place(text, below("", key)), message)
    tables = content.get("point", [])
    if isinstance(tables, list):
        yield from (_draft(text, below("point", at), keys) for at, keys in enumerate(tables))
    else:
        yield Mistake(_place(text, "point"), "point must be an array of tables: [[point]]")


def _draft(text: str, path: str, keys: Any) -> Draft | Mistake:
    def place(key: str | None) -> str:
        return _place(text, below(path, key) if key else path)

    if not isinstance(keys, dict):
        return Mistake(place(None), f"point must be a table, not {reprlib.repr(keys)}")
    for key in keys:
        if key not in KEYS:
            known = ", ".join(KEYS)
            return Mistake(place(key), f"{shown_key(key)} means nothing here; allowed are {known}")
    return Draft(keys, place)


def _place(text: str, path: str) -> str:
    line = line_of(text, path)
    return f"line {line}" if line else ""
