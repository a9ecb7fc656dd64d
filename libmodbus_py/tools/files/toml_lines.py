"""
The line of a key in a TOML text; tomllib reports lines of syntax errors only.
"""

from __future__ import annotations

import re
import reprlib
from collections import Counter
from collections.abc import Iterator

from ...protocol.mistakes import Path

__all__ = ["line_of", "shown_key"]

_PART = r"""(?:[\w\-]+|"[^"\n]*"|'[^'\n]*')"""
# No deeper key is known here, and its cost would grow with the square of the depth.
_NAME = rf"{_PART}(?:[ \t]*\.[ \t]*{_PART}){{0,9}}"
_HEADER = re.compile(rf"[ \t]*(\[\[?)[ \t]*({_NAME})[ \t]*\]\]?")
_KEY = re.compile(rf"[ \t]*({_NAME})[ \t]*=")
_PARTS = re.compile(_PART)


def shown_key(key: str) -> str:
    """Return a key as it is written in a file: quoted where necessary, and shortened."""
    return key if re.fullmatch("[A-Za-z0-9_-]{1,40}", key) else reprlib.repr(key)


def line_of(text: str, path: Path) -> int | None:
    """
    Return the line of a key.

    Args:
        text: a TOML document with one key or header in a line.
        path: such as ``("unit", 0, "coils", 2, "values", 7)``, with keys as `shown_key`
            returns them; tables in arrays and items are counted from 0.

    Returns:
        The line, from 1, of the key or header; where the text contains only keys below it, the
        first line of that; else that of the nearest table or key around the key; None if there is
        none.
    """
    around: tuple[int, int] | None = None
    beneath: int | None = None
    for line, place in _places(text):
        if path[: len(place)] == place:
            around = max(around or (0, 0), (len(place), line))
        elif beneath is None and place[: len(path)] == path:
            beneath = line
    if beneath is not None and path and (around is None or around[0] < len(path)):
        return beneath
    return around[1] if around else None


def _places(text: str) -> Iterator[tuple[int, Path]]:
    """Yield each line that contains a header or a key, with the path of that."""
    seen: Counter[Path] = Counter()
    table: Path = ()
    # Not splitlines, which accepts more line endings than TOML.
    for line, content in enumerate(text.split("\n"), start=1):
        if found := _HEADER.match(content):
            table = _table(_names(found[2]), found[1] == "[[", seen)
            yield line, table
        elif found := _KEY.match(content):
            yield line, (*table, *_names(found[1]))


def _names(dotted: str) -> list[str]:
    return [shown_key(part.strip("\"'")) for part in _PARTS.findall(dotted)]


def _table(names: list[str], is_array: bool, seen: Counter[Path]) -> Path:
    """Return the path of a table with indices; arrays around the table are at their last item."""
    path: Path = ()
    for depth, name in enumerate(names, start=1):
        path = (*path, name)
        if depth == len(names) and is_array:
            seen[path] += 1
        if seen[path]:
            path = (*path, seen[path] - 1)
    return path
