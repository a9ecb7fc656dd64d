"""
Register maps in TOML: a table ``[[point]]`` for each, with the arguments of `Point` as keys.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ....protocol.mistakes import Path, placed
from ..file_error import FilePlace
from ..schema import Key, Keys, table, tables
from ..toml_lines import line_of
from ..toml_text import read_toml
from .drafts import Draft, MapError

__all__ = ["drafts"]

FILE = Keys([Key("point", tables, "a table for each point: [[point]]", ())])


def drafts(text: str) -> Iterator[Draft]:
    """
    Yield each point of a text as a draft.

    Raises:
        MapError: the text is not TOML, or has other keys.
    """

    def place(path: Path) -> FilePlace:
        return FilePlace(line=line_of(text, path))

    try:
        points = FILE.read((), read_toml(text)).get("point", [])
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        raise MapError.of(mistake, place(mistake.path)) from None
    for at, given in enumerate(points):
        yield _draft(("point", at), given, place)


def _draft(path: Path, given: Any, place: Any) -> Draft:
    return Draft(path, place, lambda: table(path, given))
