"""
Register maps from files: in TOML, with a table ``[[point]]`` for each point, or in CSV.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from os import PathLike, fspath
from pathlib import PurePath
from typing import Any

from ....maps.register_map import RegisterMap
from ....protocol.mistakes import Path, placed
from ..file_error import FilePlace
from ..schema import Key, Keys, table, tables
from ..texts import line_of, read_text, read_toml
from . import csv_form
from .contents import Contents, MapEntry, MapError, collected

__all__ = ["FORMS", "contents_of", "load_map"]

FILE = Keys([Key("point", tables, "a table for each point: [[point]]", ())])


def load_map(path: str | PathLike[str]) -> RegisterMap:
    """
    Return the register map of a file.

    Args:
        path: the path of the file. If it ends with ``.toml``, the file has a table ``[[point]]``
            for each point, with the arguments of `Point` as keys. If it ends with ``.csv``,
            ``.tsv`` or ``.txt``, it has a row for each point, and columns that are recognised by
            their headings, as vendors name them.

    Raises:
        MapError: the file cannot be read, or contains a mistake. The message describes the first
            one, with file, line, column and what is allowed.
    """
    contents = contents_of(path, most=1)
    if contents.mistakes:
        raise contents.mistakes[0]
    return RegisterMap(contents.points.values())


def contents_of(path: str | PathLike[str], most: int) -> Contents:
    """
    Read a file up to the mistake with the number `most`.

    Raises:
        MapError: the file cannot be read.
    """
    form = FORMS.get(PurePath(path).suffix.lower())
    if form is None:
        reason = f"a register map must end with one of {', '.join(FORMS)}"
        raise MapError((), reason, place=FilePlace(fspath(path)))
    contents = form(read_text(path, MapError), most)
    contents.mistakes = [mistake.in_file(fspath(path)) for mistake in contents.mistakes]
    return contents


def _from_toml(text: str, most: int) -> Contents:
    return collected(Contents(), _toml_entries(text), most)


def _toml_entries(text: str) -> Iterator[MapEntry]:
    def place(path: Path) -> FilePlace:
        return FilePlace(line=line_of(text, path))

    try:
        points: list[Any] = FILE.read((), read_toml(text)).get("point", [])
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        raise MapError.of(mistake, place(mistake.path)) from None
    for at, given in enumerate(points):
        path = ("point", at)
        yield MapEntry(path, place, partial(table, path, given))


def _from_csv(text: str, most: int) -> Contents:
    try:
        opened = csv_form.opened(text)
        columns = csv_form.columns_of(opened.head)
    except MapError as error:
        return Contents(mistakes=[error])
    contents = Contents(ignored=columns.ignored)
    return collected(contents, csv_form.entries(opened, columns), most)


FORMS: dict[str, Callable[[str, int], Contents]] = {
    ".toml": _from_toml,
    **dict.fromkeys((".csv", ".tsv", ".txt"), _from_csv),
}
"""Suffix of a file -> function that reads its text, up to the mistake with a given number."""
