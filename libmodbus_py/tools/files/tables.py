"""
Tables of files: what they may hold.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from typing import Any

from .toml_lines import below

__all__ = ["checked_table"]


def checked_table(
    where: str, given: object, allowed: Iterable[str] | None = None
) -> Mapping[str, Any]:
    """
    Give a table whose keys may all be there.

    Args:
        where: its path, for errors.
        allowed: its keys; None for any.

    Raises:
        TypeError: it is no table.
        ValueError: a key is none of these.
    """
    if not isinstance(given, dict):
        raise TypeError(f"{where} must be a table, not {reprlib.repr(given)}")
    for key in given:
        if allowed is not None and key not in allowed:
            raise ValueError(f"{below(where, key)}: no such key; allowed are {', '.join(allowed)}")
    return given
