"""
Where a key stands in a TOML text: tomllib tells lines of syntax errors only.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

__all__ = ["line_of"]

_HEADER = re.compile(r"\s*(\[\[?)\s*([\w.\-]+)\s*\]\]?")
_KEY = re.compile(r"\s*([\w\-]+)\s*=")


def line_of(text: str, path: str) -> int | None:
    """
    Find the line that says something about a key.

    Args:
        text: a TOML document with one key or header in a line.
        path: such as ``unit[0].coils[2].values[7]``; tables in arrays and items
            are counted from 0.

    Returns:
        The line, from 1, of the key or of the nearest table or key around it;
        None if there is none.
    """
    best: tuple[int, int] | None = None
    for line, place in _places(text):
        if path == place or path.startswith((f"{place}.", f"{place}[")):
            best = max(best or (0, 0), (len(place), line))
    return best[1] if best else None


def _places(text: str) -> Iterator[tuple[int, str]]:
    """Give each line that has a header or a key, and the path it stands for."""
    seen: Counter[str] = Counter()
    table = ""
    for line, content in enumerate(text.splitlines(), start=1):
        if found := _HEADER.match(content):
            table = _table(found[2].split("."), found[1] == "[[", seen)
            yield line, table
        elif found := _KEY.match(content):
            yield line, f"{table}.{found[1]}" if table else found[1]


def _table(names: list[str], is_array: bool, seen: Counter[str]) -> str:
    """Number the tables in arrays; those around it are the last ones so far."""
    path = ""
    for depth, name in enumerate(names, start=1):
        path = f"{path}.{name}" if path else name
        if depth == len(names) and is_array:
            seen[path] += 1
        if seen[path]:
            path = f"{path}[{seen[path] - 1}]"
    return path
