"""
Reading files, and reading them again: their text, TOML with the line of each key, and mistakes with
their place in the file.
"""

from __future__ import annotations

import codecs
import io
import re
import reprlib
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from os import PathLike, fspath
from typing import Any, NamedTuple, Self, TypeVar

from ..protocol.mistakes import Mistake, Path, Problem, WrongValue, placed
from ..system import open_file
from ..version import what_is_missing


class FilePlace(NamedTuple):
    """A place in a file; unknown parts are left out."""

    file: str = ""
    line: int | None = None  # from 1
    column: str = ""  # the heading

    def __str__(self) -> str:
        line = f"line {self.line}" if self.line else ""
        column = f"column {self.column}" if self.column else ""
        return ", ".join(filter(None, (self.file, line, column)))


class FileError(WrongValue):
    """
    The content of a file is wrong.

    Attributes:
        place: the place of the mistake; `path` is the key, such as ("unit", 0, "id").
    """

    def __init__(
        self, path: str | Path, reason: str, between: str = " ", place: FilePlace | None = None
    ) -> None:
        super().__init__(path, reason, between)
        self.place: FilePlace = place or FilePlace()

    @classmethod
    def of(cls, error: Exception, place: FilePlace | None = None) -> Self:
        """Return a TypeError or ValueError as an error about a place."""
        mistake = placed(error, ())
        return cls(mistake.path, mistake.reason, mistake.between, place)

    def in_file(self, file: str) -> Self:
        """Return the same error about a place in a file."""
        return type(self)(self.path, self.reason, self.between, self.place._replace(file=file))

    def under(self, around: Path) -> Mistake:
        """Return a mistake at the key `around`, which names the file of this error."""
        return WrongValue.about(around, str(self))

    def __str__(self) -> str:
        place = str(self.place)
        return f"{place}: {super().__str__()}" if place else super().__str__()


Content = TypeVar("Content")


def _content(path: str | PathLike[str], kind: type[FileError]) -> bytes:
    try:
        with open_file(path) as file:
            return file.read()
    except OSError as error:
        raise kind((), f"cannot read {fspath(path)}: {error.strerror}") from error


def read_text(path: str | PathLike[str], kind: type[FileError]) -> str:
    """Return the text of a file in UTF-8; raise an error of the class `kind` if that fails."""
    try:
        return _content(path, kind).decode("utf-8")
    except UnicodeDecodeError as error:
        reason = f"byte {error.start} is not UTF-8; save it as UTF-8"
        raise kind((), reason, place=FilePlace(fspath(path))) from None


def read_table(
    path: str | PathLike[str],
    kind: type[FileError],
    encoding: str | None = None,
    sheet: str | None = None,
) -> tuple[str, str]:
    """
    Return the text of a file as spreadsheets save it, and a note if it is not UTF-8.

    Without an encoding, it is UTF-8, or UTF-16 with a mark. A spreadsheet becomes CSV.
    """
    if fspath(path).lower().endswith(".xlsx"):
        return _spreadsheet(path, kind, sheet)
    data = _content(path, kind)
    place = FilePlace(fspath(path))
    is_utf_16 = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    name = encoding or ("utf-16" if is_utf_16 else "utf-8")
    try:
        text = data.decode(name)
    except LookupError:
        raise kind("encoding", f"{name!r} is not known, such as cp1252", place=place) from None
    except UnicodeDecodeError as error:
        reason = f"byte {error.start} is not {name}: say its encoding (--encoding), such as"
        some = "cp1252 (western Europe), cp1250 (central Europe), cp1251 (Cyrillic), gbk (Chinese)"
        raise kind((), f"{reason} {some}", place=place) from None
    if encoding is not None:
        return text, f"read as {name}"
    return text, "read as utf-16, because it is not UTF-8" if is_utf_16 else ""


def _spreadsheet(
    path: str | PathLike[str], kind: type[FileError], sheet: str | None
) -> tuple[str, str]:
    """Return a sheet of a spreadsheet as CSV, a line for each row, and a note about the sheet."""
    place = FilePlace(fspath(path))
    data = io.BytesIO(_content(path, kind))
    try:
        from openpyxl import load_workbook  # which few programs need
    except ImportError:
        reason = what_is_missing("a spreadsheet", "spreadsheets")
        raise kind((), reason, place=place) from None
    try:
        book = load_workbook(data, data_only=True)
    except Exception as error:  # each version of openpyxl raises other exceptions
        raise kind((), f"is no spreadsheet: {error}", place=place) from None
    if sheet is not None and sheet not in book.sheetnames:
        reason = f"must be one of {', '.join(book.sheetnames)}, not {sheet!r}"
        raise kind("sheet", reason, place=place)
    name = sheet or book.sheetnames[0]
    rows = [[*row] for row in book[name].iter_rows(values_only=True)]
    for area in book[name].merged_cells.ranges:  # merged cells are copied into each of their rows
        for row in rows[area.min_row : area.max_row]:
            row[area.min_col - 1] = rows[area.min_row - 1][area.min_col - 1]
    text = "".join(f"{','.join(map(_quoted, row))}\n" for row in rows)
    others = [title for title in book.sheetnames if title != name]
    return text, f"read sheet {name}, not {', '.join(others)}" if others else ""


def _quoted(cell: object) -> str:
    """Return a cell of a spreadsheet as a cell of CSV, on one line."""
    if isinstance(cell, float) and cell.is_integer():
        cell = int(cell)
    text = str(cell).lower() if isinstance(cell, bool) else "" if cell is None else str(cell)
    return '"' + " ".join(text.split()).replace('"', '""') + '"'


def load_file(
    path: str | PathLike[str], parse: Callable[[str], Content], kind: type[FileError]
) -> Content:
    """Return the parsed content of a file in TOML; raise errors as a `kind`, with their line."""
    text = read_text(path, kind)
    try:
        return parse(text)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        raise kind.of(mistake, FilePlace(fspath(path), line_of(text, mistake.path))) from None


def reread(load: Callable[[], Content], use: Callable[[Content], str]) -> str:
    """Load a file again, use it, and return what `use` says, or the mistake in the file."""
    try:
        return use(load())
    except (TypeError, ValueError) as error:
        return Problem(f"the former content is used: {error}")


def compared(path: str, noun: str, before: Mapping[Any, Any], after: Mapping[Any, Any]) -> str:
    """Return a line about what changed in a file: things called `noun`, by name or number."""
    counts = {
        "new": len(after.keys() - before.keys()),
        "changed": sum(before[key] != after[key] for key in before.keys() & after.keys()),
        "removed": len(before.keys() - after.keys()),
    }
    changes = ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    plural = "s" * (len(after) != 1)
    return f"{path}: read again, {len(after)} {noun}{plural}: {changes or 'no change'}"


# --- TOML ------------------------------------------------------------------------------------

_PART = r"""(?:[\w\-]+|"[^"\n]*"|'[^'\n]*')"""
_NAME = rf"{_PART}(?:[ \t]*\.[ \t]*{_PART})*"
_LINE = re.compile(rf"[ \t]*(?:(\[\[?)[ \t]*({_NAME})[ \t]*\]|({_NAME})[ \t]*=)")


def read_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML document; a ValueError names line and column."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("arrays or tables are nested too deeply") from None


def shown_key(key: str) -> str:
    """Return a key as it is written in a file: quoted where necessary, and shortened."""
    return key if re.fullmatch("[A-Za-z0-9_-]{1,40}", key) else reprlib.repr(key)


def line_of(text: str, path: Path) -> int | None:
    """Return the line, from 1, of a key of a TOML document, or of what is around it."""
    nearest, depth = None, 0
    for line, other in _paths(text):
        length = 0
        while other[: length + 1] == path[: length + 1] and length < min(len(other), len(path)):
            length += 1
        if length > depth:
            nearest, depth = line, length
    return nearest


def _paths(text: str) -> Iterator[tuple[int, Path]]:
    """Yield each line that contains a header or a key, with its path."""
    counts: Counter[Path] = Counter()
    table: Path = ()
    # Not splitlines, which accepts more line endings than TOML.
    for line, content in enumerate(text.split("\n"), start=1):
        if match := _LINE.match(content):
            parts = re.findall(_PART, match[2] or match[3])
            names = [shown_key(part.strip("\"'")) for part in parts]
            if match[1]:
                table = _table_path(names, match[1] == "[[", counts)
            yield line, table if match[1] else (*table, *names)


def _table_path(names: list[str], is_array: bool, counts: Counter[Path]) -> Path:
    """Return the path of a table with indices; arrays around the table are at their last item."""
    path: Path = ()
    for depth, name in enumerate(names, start=1):
        path = (*path, name)
        if depth == len(names) and is_array:
            counts[path] += 1
        if counts[path]:
            path = (*path, counts[path] - 1)
    return path
