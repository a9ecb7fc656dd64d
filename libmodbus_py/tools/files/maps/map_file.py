"""
Register maps from files.
"""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike, fspath
from pathlib import PurePath

from ....maps.register_map import RegisterMap
from ..file_error import FilePlace
from ..texts import read_text
from . import csv_form, toml_form
from .drafts import Contents, MapError, collected

__all__ = ["FORMS", "contents_of", "load_map"]


def load_map(path: str | PathLike[str]) -> RegisterMap:
    """
    Return the register map of a file of up to 512 KiB with up to 10000 points.

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
    return collected(Contents(), toml_form.drafts(text), most)


def _from_csv(text: str, most: int) -> Contents:
    try:
        opened = csv_form.opened(text)
        columns = csv_form.columns_of(opened.head)
    except MapError as error:
        return Contents(mistakes=[error])
    contents = Contents(ignored=columns.ignored)
    return collected(contents, csv_form.drafts(opened, columns), most)


FORMS: dict[str, Callable[[str, int], Contents]] = {
    ".toml": _from_toml,
    ".csv": _from_csv,
    ".tsv": _from_csv,
    ".txt": _from_csv,
}
"""Suffix of a file -> function that reads its text, up to the mistake with a given number."""
