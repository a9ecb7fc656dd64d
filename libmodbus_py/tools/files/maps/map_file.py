"""
Register maps from files: in TOML, with a table ``[[point]]`` for each point, or in CSV.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from os import PathLike, fspath
from pathlib import PurePath
from typing import Any

from ....maps.register_map import RegisterMap
from ....protocol.mistakes import Path, placed
from ..schema import Key, Keys, table, tables
from ..texts import FilePlace, line_of, read_table, read_text, read_toml
from . import csv_form
from .contents import Contents, MapEntry, MapError, collected

__all__ = ["FORMS", "contents_of", "contents_of_text", "load_map"]

FILE = Keys([Key("point", tables, "a table for each point: [[point]]", ())])


def load_map(path: str | PathLike[str], *, columns: Mapping[str, str] | None = None) -> RegisterMap:
    """
    Return the register map of a file.

    Args:
        path: the path of the file. If it ends with ``.toml``, the file has a table ``[[point]]``
            for each point, with the arguments of `Point` as keys. If it ends with ``.csv``,
            ``.tsv`` or ``.txt``, it has a row for each point, and columns that are recognised by
            their headings, as vendors name them. It may be as Excel saves it: in UTF-8, UTF-16 or
            cp1252, with a title above the headings, and with decimal commas where semicolons
            separate the cells.
        columns: the headings of columns that are not recognised, by the arguments of `Point`, such
            as ``{"name": "Bezeichnung"}``; only for files with columns.

    Raises:
        MapError: the file cannot be read, or contains a mistake. The message describes the first
            one, with file, line, column and what is allowed.
        ValueError: `columns` has a name that is no argument of `Point`, or the file no columns.
    """
    contents = contents_of(path, most=1, columns=columns)
    if contents.mistakes:
        raise contents.mistakes[0]
    return RegisterMap(contents.points.values())


def contents_of(
    path: str | PathLike[str], most: int, columns: Mapping[str, str] | None = None
) -> Contents:
    """
    Read a file up to the mistake with the number `most`.

    Args:
        columns: as for `load_map`.

    Raises:
        MapError: the file cannot be read.
        ValueError: as for `load_map`.
    """
    suffix = PurePath(path).suffix.lower()
    if suffix not in FORMS:
        reason = f"a register map must end with one of {', '.join(FORMS)}"
        raise MapError((), reason, place=FilePlace(fspath(path)))
    is_toml = suffix == ".toml"
    text, note = (read_text(path, MapError), "") if is_toml else read_table(path, MapError)
    contents = contents_of_text(text, suffix, most, columns or {})
    contents.notes[:0] = [note] if note else []
    contents.mistakes = [mistake.in_file(fspath(path)) for mistake in contents.mistakes]
    return contents


def contents_of_text(text: str, suffix: str, most: int, columns: Mapping[str, str]) -> Contents:
    """
    Read the text of a file with one of the suffixes `FORMS`, up to the mistake number `most`.

    Raises:
        ValueError: as for `load_map`.
    """
    if suffix == ".toml":
        if columns:
            raise ValueError("columns are for CSV; the keys of TOML have the names of arguments")
        return collected(Contents(), _toml_entries(text), most)
    for kind in columns:
        if kind not in csv_form.READERS:
            allowed = ", ".join(csv_form.READERS)
            raise ValueError(f"columns must name some of {allowed}, not {kind!r}")
    return _from_csv(text, most, columns)


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


def _from_csv(text: str, most: int, named: Mapping[str, str]) -> Contents:
    try:
        opened = csv_form.opened(text, named)
        columns = csv_form.columns_of(opened.head, named)
    except MapError as error:
        return Contents(mistakes=[error])
    contents = Contents(ignored=columns.ignored)
    if opened.skipped:
        contents.notes.append(f"rows above the headings that are skipped: {opened.skipped}")
    return collected(contents, csv_form.entries(opened, columns), most)


FORMS: tuple[str, ...] = (".toml", ".csv", ".tsv", ".txt")
"""The suffixes of files that may be maps; all but the first have columns."""
