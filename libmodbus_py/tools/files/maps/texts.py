"""
Register maps as text, in the forms that files have.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from ....maps.point import Point
from ..csv_text import csv_rows
from ..texts import shown_key
from .csv_form import PADDINGS

__all__ = ["csv_text", "toml_text"]

WORD_OF = {character: word for word, character in PADDINGS.items()}

_DEFAULTS = {each.name: each.default for each in fields(Point) if each.init}


def toml_text(points: Iterable[Point]) -> str:
    """Return points as TOML: a table for each, with the arguments that are not defaults."""
    return "\n".join(
        "\n".join(["[[point]]", *(f"{key} = {_shown(value)}" for key, value in _said(point)), ""])
        for point in points
    )


def csv_text(points: Iterable[Point]) -> str:
    """Return points as CSV: a line for each."""
    said = [dict(_said(point)) for point in points]
    used = [key for key in _DEFAULTS if any(key in keys for keys in said)]
    return csv_rows([used, *([_cell(keys.get(key, "")) for key in used] for keys in said)])


def _cell(value: Any) -> Any:
    """Return a value as the readers of cells take it."""
    if isinstance(value, bool):
        return _shown(value)
    if isinstance(value, str) and value in WORD_OF:
        return WORD_OF[value]
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    if not isinstance(value, Mapping):
        return value
    if any(set(name) & set(";={") for name in value.values()):
        return json.dumps(value, ensure_ascii=False)
    return "; ".join(f"{key} = {name}" for key, name in value.items())


def _said(point: Point) -> list[tuple[str, Any]]:
    return [
        (key, value)
        for key, default in _DEFAULTS.items()
        if (value := getattr(point, key)) is not None and value != default
    ]


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        pairs = (f"{shown_key(str(key))} = {_shown(each)}" for key, each in value.items())
        return f"{{ {', '.join(pairs)} }}"
    # Printable text, numbers and lists are written alike in JSON and TOML.
    return json.dumps(value, ensure_ascii=False)
