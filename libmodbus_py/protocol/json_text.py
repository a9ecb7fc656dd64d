"""
The encoders of JSON, and the check of names in what is decoded.

All values that the package writes as JSON pass through one of these. They raise a ValueError for a
nan or an infinity, in place of which `plain.plain` returns None.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

from .mistakes import WrongValue

JSON = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
"""Encodes text as it is."""

COMPACT_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
"""Encodes text in ASCII, without spaces."""

SORTED_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), sort_keys=True)
"""Encodes the same for equal values, without spaces."""

json_text: Callable[[Any], str] = json.JSONEncoder(allow_nan=False).encode
"""Returns a value as JSON, in ASCII."""


def json_line(value: Any) -> str:
    """Return a value as JSON that escapes only the characters that cannot be printed."""
    text = JSON.encode(value)
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else json_text(character)[1:-1] for character in text
    )


def each_once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return names and values, as `object_pairs_hook`, too; json takes the last of two alike."""
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise WrongValue.about((name,), "occurs twice")
        values[name] = value
    return values
