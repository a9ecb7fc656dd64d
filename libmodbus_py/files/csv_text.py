"""
CSV as people and programs write it: one line with headings, then one row per line.

Cells are separated by commas, semicolons, tabs or bars; empty lines, lines that begin with ``#``
(in quotes it begins a cell) and a byte order mark are ignored. Lines above the headings, such as a
title, are skipped: the headings are the first line in which two of them are known. Where semicolons
separate the cells, a comma in a number is a decimal comma.
"""

from __future__ import annotations

import csv
import io
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import Any, Literal, NamedTuple

from ..protocol.mistakes import WrongValue
from ..protocol.plain import CONTROL
from .texts import FileError, FilePlace

__all__ = ["CELLS", "CsvRow", "CsvText", "csv_rows", "flag_in", "number_in", "whole_in"]

DELIMITERS = ",;\t|"

# The most lines above the headings.
MOST_TITLES = 30

# Control characters, which editors and terminals obey and no table contains.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


class CsvRow(NamedTuple):
    """A line of a file: its number, from 1, and its cells without spaces around."""

    line: int
    cells: list[str]


class CsvText:
    """A text in CSV: its row of headings, its delimiter, and how many rows are skipped above."""

    def __init__(
        self,
        text: str,
        is_known: Callable[[str], bool],
        kind: type[FileError],
        *,
        names_first: bool = False,
    ) -> None:
        if found := _CONTROL.search(text):
            line = text.count("\n", 0, found.start()) + 1
            reason = f"contains the control character {ord(found[0]):#04x}"
            raise kind((), reason, place=FilePlace(line=line))
        self._kind = kind  # of errors about characters, or what is not CSV
        # Excel begins a file with a byte order mark, or with a line such as "sep=;".
        self._text = re.sub(r"\A\ufeff?(sep=[^\r\n](?=[\r\n]))?", "", text)
        self._lines = re.split("\r\n|\r|\n", self._text)
        # The first cell may be a name such as #12, which could be a comment.
        self._names_first = names_first
        heads, errors = [], []
        for delimiter in DELIMITERS:
            try:
                heads.append((*self._head(delimiter, is_known), delimiter))
            except FileError as error:
                errors.append(error)
        if not heads:
            raise errors[0]
        _, head, skipped, delimiter = max(heads, key=lambda each: each[0])
        self.head: CsvRow = head
        self.skipped: int = skipped
        self.delimiter: str = delimiter

    def number_cell(self, cell: str) -> str:
        """Return a cell with a point in place of its decimal comma, if it has one."""
        has_comma = self.delimiter == ";" and _WITH_COMMA.fullmatch(cell)
        return cell.replace(",", ".") if has_comma else cell

    def rows(self) -> Iterator[CsvRow]:
        """Yield the rows below the headings; raise a FileError if the rest is not CSV."""
        return (row for row in self._rows(self.delimiter) if row.line > self.head.line)

    def cells(self, row: CsvRow) -> list[str]:
        """Return the cells of a row; raise WrongValue if it has more than there are headings."""
        width = len(self.head.cells)
        if any(row.cells[width:]):
            reason = f"{len(row.cells)} cells below {width} headings"
            raise WrongValue((), f"{reason}: quote what has a {self.delimiter!r} in it")
        return row.cells[:width]

    def _head(self, delimiter: str, is_known: Callable[[str], bool]) -> tuple[int, CsvRow, int]:
        """Return how many headings are known, their row, and how many rows stand above it."""
        first = 0, CsvRow(1, []), 0
        for at, row in enumerate(islice(self._rows(delimiter), MOST_TITLES + 1)):
            known = sum(map(is_known, row.cells))
            if known >= 2:
                return known, row, at
            if at == 0:
                first = known, row, 0
        return first

    def _rows(self, delimiter: str) -> Iterator[CsvRow]:
        lines = io.StringIO(self._text, newline="")
        reader = csv.reader(lines, delimiter=delimiter, strict=True)
        line = 1
        while True:
            try:
                found = next(reader, None)
            except csv.Error as error:
                raise self._kind((), f"invalid CSV: {error}", place=FilePlace(line=line)) from None
            if found is None:
                return
            cells = [cell.strip() for cell in found]
            if any(cells) and not self._is_comment(cells, line):
                yield CsvRow(line, cells)
            line = reader.line_num + 1

    def _is_comment(self, cells: list[str], line: int) -> bool:
        if not cells[0].startswith("#") or self._lines[line - 1].lstrip().startswith('"'):
            return False
        if self._names_first and len(cells) > 1 and re.match("#[0-9]", cells[0]):
            reason = f"quote {cells[0]!r} if it is a name, or put a space behind the # of a comment"
            raise self._kind((), reason, place=FilePlace(line=line))
        return True


def csv_rows(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV (RFC 4180), with all texts quoted if one has a control character."""
    rows = [[*row] for row in rows]  # which may be iterators, and are written twice
    text = _written(rows, csv.QUOTE_MINIMAL)
    return _written(rows, csv.QUOTE_NONNUMERIC) if CONTROL.search(text) else text


def _written(rows: Iterable[Iterable[Any]], quoting: Literal[0, 2]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n", quoting=quoting).writerows(rows)
    return text.getvalue()


_WITH_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+([eE][+-]?[0-9]+)?")
_DECIMAL = re.compile(r"[+-]?([0-9]{1,40}(\.[0-9]{0,40})?|\.[0-9]{1,40})([eE][+-]?[0-9]{1,3})?")


def number_in(cell: str) -> int | float:
    """Read 10, 0.1, 1e-3 or 1/10; raise WrongValue for anything else."""
    over, slash, under = cell.partition("/")
    if not _DECIMAL.fullmatch(over) or (slash and not _DECIMAL.fullmatch(under)):
        hint = " with a point, not a comma," if "," in cell and "." not in cell else ""
        raise WrongValue((), f"must be a number such as 0.1,{hint} not {reprlib.repr(cell)}")
    if not slash:
        return int(over) if re.fullmatch("[+-]?[0-9]+", over) else float(over)
    if not float(under):
        raise WrongValue((), f"must not divide by 0: {reprlib.repr(cell)}")
    return float(over) / float(under)


def whole_in(cell: str) -> int:
    """Read 100, 0x64 or 64h; raise WrongValue for anything else."""
    if re.fullmatch("[0-9]{1,20}", cell):
        return int(cell)
    if found := re.fullmatch("0x([0-9a-f]{1,16})|([0-9a-f]{1,16})h", cell.casefold()):
        return int(found[1] or found[2], 16)
    wanted = "a whole number such as 100, 0x64 or 64h"
    raise WrongValue((), f"must be {wanted}, not {reprlib.repr(cell)}")


def flag_in(cell: str) -> bool:
    """Read true or false; raise WrongValue for anything else."""
    if cell.lower() not in ("true", "false"):
        raise WrongValue((), f"must be true or false, not {reprlib.repr(cell)}")
    return cell.lower() == "true"


def _words(cell: str) -> list[str]:
    return [each.strip() for each in cell.split(";") if each.strip()]


CELLS: dict[str, Callable[[str], Any]] = {
    "str": str,
    "int": whole_in,
    "float": number_in,
    "float | None": number_in,
    "bool": flag_in,
    "tuple[str, ...]": _words,
}
"""Annotation of an argument -> reads its value from a cell."""
