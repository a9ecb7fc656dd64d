"""
Where a key stands in a TOML text: tomllib tells lines of syntax errors only.
"""

from __future__ import annotations

import re
import reprlib
from collections import Counter
from collections.abc import Iterator

__all__ = ["below", "line_of", "path_at_start", "shown_key"]

_PART = r"""(?:[\w\-]+|"[^"\n]*"|'[^'\n]*')"""
# Deeper ones mean nothing here, and would cost the square of their depth.
_NAME = rf"{_PART}(?:[ \t]*\.[ \t]*{_PART}){{0,9}}"
_HEADER = re.compile(rf"[ \t]*(\[\[?)[ \t]*({_NAME})[ \t]*\]\]?")
_KEY = re.compile(rf"[ \t]*({_NAME})[ \t]*=")
_PARTS = re.compile(_PART)

# A path, where it stands before what is wrong there.
_PATH = re.compile(r"""(?:[\w\-.\[\]]|"[^"]*"|'[^']*')+""")


def shown_key(key: str) -> str:
    """A key as it stands in the file: quoted where it must be, and short."""
    return key if re.fullmatch("[A-Za-z0-9_-]{1,40}", key) else reprlib.repr(key)


def below(path: str, key: str | int) -> str:
    """The path of an item of a list, or of a key of a table; of the document it is empty."""
    if isinstance(key, int):
        return f"{path}[{key}]"
    return f"{path}.{shown_key(key)}" if path else shown_key(key)


def path_at_start(message: str) -> str:
    """The path that a message begins with; else its first word."""
    found = _PATH.match(message)
    return found[0] if found else ""


def line_of(text: str, path: str) -> int | None:
    """
    Find the line that says something about a key.

    Args:
        text: a TOML document with one key or header in a line.
        path: such as ``unit[0].coils[2].values[7]``; tables in arrays and items
            are counted from 0.

    Returns:
        The line, from 1, of the key or header; where only what lies below it is in the
        text, the first line of that; else that of the nearest table or key around it;
        None if there is none.
    """
    around: tuple[int, int] | None = None
    beneath: int | None = None
    for line, place in _places(text):
        if _is_below(path, place):
            around = max(around or (0, 0), (len(place), line))
        elif beneath is None and _is_below(place, path):
            beneath = line
    if beneath is not None and (around is None or around[0] < len(path)):
        return beneath
    return around[1] if around else None


def _is_below(path: str, other: str) -> bool:
    return path == other or path.startswith((f"{other}.", f"{other}["))


def _places(text: str) -> Iterator[tuple[int, str]]:
    """Give each line that has a header or a key, and the path it stands for."""
    seen: Counter[str] = Counter()
    table = ""
    # Not splitlines, which knows more ends of lines than TOML.
    for line, content in enumerate(text.split("\n"), start=1):
        if found := _HEADER.match(content):
            table = _table(_names(found[2]), found[1] == "[[", seen)
            yield line, table
        elif found := _KEY.match(content):
            path = table
            for name in _names(found[1]):
                path = below(path, name)
            yield line, path


def _names(dotted: str) -> list[str]:
    return [part.strip("\"'") for part in _PARTS.findall(dotted)]


def _table(names: list[str], is_array: bool, seen: Counter[str]) -> str:
    """Number the tables in arrays; those around it are the last ones so far."""
    path = ""
    for depth, name in enumerate(names, start=1):
        path = below(path, name)
        if depth == len(names) and is_array:
            seen[path] += 1
        if seen[path]:
            path = below(path, seen[path] - 1)
    return path
