"""
Tables as people and programs write them: one row with headings, then a row for each thing. In CSV
with commas, semicolons, tabs or bars between the cells, or in Markdown; spreadsheets become CSV
before (`texts.read_table`).

Empty lines, lines that begin with ``#`` and a byte order mark are ignored. A comment is recognised
by its line, before cells are: quotes in it mean nothing. A cell that begins with ``#`` is one in
quotes, or a mere ``#``, with which some lists head the numbers of their rows. Lines above the
headings, such as a title, are skipped: the headings are the first line in which two of them are
known. Where commas do not separate the cells, a comma in a number is a decimal comma.
"""

from __future__ import annotations

import csv
import io
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import islice
from typing import Any, Literal, NamedTuple

from ..protocol.mistakes import WrongValue
from ..protocol.plain import CONTROL
from .texts import FileError, FilePlace

MARKDOWN = "Markdown"
"""In place of a delimiter: bars, also at both ends of a row."""

# Control characters, which editors and terminals obey and no table contains.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")

# All characters of the line below the headings in Markdown; colons align columns.
_RULER = frozenset("|-: ")


class CsvRow(NamedTuple):
    """A line of a file: its number, from 1, and its cells without spaces around."""

    line: int
    cells: list[str]


class CsvText:
    """
    The text of a table: its row of headings, its delimiter, and how many rows are skipped above.

    `is_known` says whether a heading is known; `kind` is the class of errors about characters, or
    what is not CSV; `headings` are those of a list that has none of its own.
    """

    def __init__(
        self,
        text: str,
        is_known: Callable[[str], bool],
        kind: type[FileError],
        *,
        headings: Sequence[str] = (),
    ) -> None:
        if control := _CONTROL.search(text):
            line = text.count("\n", 0, control.start()) + 1
            reason = f"contains the control character {ord(control[0]):#04x}"
            raise kind((), reason, place=FilePlace(line=line))
        self._kind = kind
        # Excel begins a file with a byte order mark, or with a line such as "sep=;".
        text = re.sub(r"\A\ufeff?(sep=[^\r\n](?=[\r\n]))?", "", text)
        self._lines = io.StringIO(text, newline="").readlines()
        self._rulers: list[int] = [
            at for at, line in enumerate(self._lines) if {*"|-"} <= {*line.strip()} <= _RULER
        ]
        self.head: CsvRow = CsvRow(0, list(headings))
        self.skipped: int = 0
        self.delimiter: str = ","
        if not headings:
            self._find_head(is_known)

    def _find_head(self, is_known: Callable[[str], bool]) -> None:
        if any(self._rulers[:1]):
            self.delimiter = MARKDOWN
            counts = [sum(map(is_known, self._markdown_cells(at - 1))) for at in self._rulers]
            ruler = self._rulers[counts.index(max(counts))]
            self.head = CsvRow(ruler, self._markdown_cells(ruler - 1))
            self.skipped = sum("|" in line for line in self._lines[:ruler]) - 1
            return
        heads, errors = [], []
        for delimiter in ",;\t|":
            try:
                heads.append((*self._head(delimiter, is_known), delimiter))
            except FileError as error:
                errors.append(error)
        if not heads:
            raise errors[0]
        _, self.head, self.skipped, self.delimiter = max(heads, key=lambda head: head[0])

    def is_head(self, row: CsvRow) -> bool:
        """Return True for the headings of a table in Markdown."""
        return row.line in self._rulers

    def number_cell(self, cell: str) -> str:
        """Return a cell with a point in place of its decimal comma; WrongValue for 1,000."""
        if self.delimiter == "," or not _WITH_MARK.fullmatch(cell):
            return cell
        may_be_thousand = self.delimiter != ";" if "," in cell else self._has_decimal_commas
        if may_be_thousand and _THOUSANDS.fullmatch(cell):
            mark = "comma" if "," in cell else "point"
            reason = f"{cell} may be a thousand, or have three decimals: write it without a {mark}"
            raise WrongValue((), reason)
        return cell.replace(",", ".")

    @cached_property
    def _has_decimal_commas(self) -> bool:
        cells = (cell for row in self.rows() for cell in row.cells)
        return any("," in cell and _WITH_MARK.fullmatch(cell) for cell in cells)

    def rows(self) -> Iterator[CsvRow]:
        """Yield the rows below the headings; raise a FileError if the rest is not CSV."""
        for row in self._rows(self.delimiter, below=self.head.line):
            if row.line > self.head.line:
                yield row

    def cells(self, row: CsvRow) -> list[str]:
        """Return the cells of a row; raise WrongValue if it has more than there are headings."""
        width = len(self.head.cells)
        if any(row.cells[width:]):
            reason = f"{len(row.cells)} cells below {width} headings"
            raise WrongValue((), f"{reason}: quote what has a {self.delimiter!r} in it")
        return row.cells[:width]

    def _head(self, delimiter: str, is_known: Callable[[str], bool]) -> tuple[int, CsvRow, int]:
        """Return how many headings are known, their row, and the number of rows above."""
        head = 0, CsvRow(1, []), 0
        try:
            for at, row in enumerate(islice(self._rows(delimiter), 31)):  # up to 30 lines of titles
                count = sum(map(is_known, row.cells))
                if at == 0 or (count > head[0] and count >= 2):
                    head = count, row, at  # perhaps below a row of groups of columns
                elif head[0] >= 2:
                    break
        except FileError:
            if head[0] < 2:
                raise
        return head

    def _rows(self, delimiter: str, below: int | None = None) -> Iterator[CsvRow]:
        """Yield all rows; below that line, what may be a comment or a name is an error."""
        if delimiter == MARKDOWN:
            for at, line_text in enumerate(self._lines):
                if "|" in line_text and at not in self._rulers:
                    yield CsvRow(at + 1, self._markdown_cells(at))
            return
        at = 0  # the index of the next line
        line = 1  # where the row begins
        is_begin = True  # of a row; a line in the middle of a quoted cell is no comment

        def lines() -> Iterator[str]:
            nonlocal at, is_begin, line
            while at < len(self._lines):
                at += 1
                text = self._lines[at - 1]
                if is_begin and self._is_comment(text, at, delimiter, below):
                    continue
                if is_begin:
                    line, is_begin = at, False
                yield text

        reader = csv.reader(lines(), delimiter=delimiter, strict=True)
        while True:
            is_begin = True
            try:
                cells = next(reader, None)
            except csv.Error as error:
                raise self._kind((), f"invalid CSV: {error}", place=FilePlace(line=line)) from None
            if cells is None:
                return
            if at > line and below is not None:
                self._check_quotes(line, at, delimiter)
            cells = [cell.strip() for cell in cells]
            if any(cells):
                yield CsvRow(line, cells)

    def _check_quotes(self, first: int, last: int, delimiter: str) -> None:
        """Refuse a quoted cell that begins in one row and ends in another."""
        widths = [line.count(delimiter) + 1 for line in self._lines]
        rows = [width for width in widths[self.head.line :] if width > len(self.head.cells) / 2]
        # Both lines of one row have the cells of one row, and one more; commas may be in them, too.
        usual = sorted(rows)[len(rows) // 2] if rows else len(self.head.cells)
        most = usual * (1 if delimiter == "\t" else 1.5) + 1
        if first > self.head.line and widths[first - 1] + widths[last - 1] > most:
            reason = f'a cell that begins with a quote ends in line {last}: write "" for a quote'
            raise self._kind((), reason, place=FilePlace(line=first))

    def _is_comment(self, text: str, line: int, delimiter: str, below: int | None) -> bool:
        text = text.strip()
        if not text.startswith("#") or text[1:].lstrip().startswith(delimiter):
            return False
        if below is not None and line > below and re.match("#[0-9]", text) and delimiter in text:
            name = text.split(delimiter)[0].strip()
            reason = f"quote {name!r} if it is a name, or put a space behind the # of a comment"
            raise self._kind((), reason, place=FilePlace(line=line))
        return True

    def _markdown_cells(self, at: int) -> list[str]:
        row = re.sub(r"^\||(?<!\\)\|$", "", self._lines[at].strip())
        cells = [cell.strip().replace(r"\|", "|") for cell in re.split(r"(?<!\\)\|", row)]
        return [re.sub(r"^(`|\*\*)(.*)\1$", r"\2", cell) for cell in cells]


def csv_rows(rows: Iterable[Iterable[Any]], quoting: Literal[0, 2] = csv.QUOTE_MINIMAL) -> str:
    """Return rows as CSV (RFC 4180), with all texts quoted if one has a control character."""
    rows = [[*row] for row in rows]  # which may be iterators, and are written twice
    lines = io.StringIO(newline="")
    csv.writer(lines, lineterminator="\n", quoting=quoting).writerows(rows)
    text = lines.getvalue()
    is_quoted = quoting == csv.QUOTE_NONNUMERIC or not CONTROL.search(text)
    return text if is_quoted else csv_rows(rows, csv.QUOTE_NONNUMERIC)


_WITH_MARK = re.compile(r"[+-]?[0-9]+[.,][0-9]+([eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")
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
    if match := re.fullmatch("0x([0-9a-f]{1,16})|([0-9a-f]{1,16})h", cell.casefold()):
        return int(match[1] or match[2], 16)
    form = "a whole number such as 100, 0x64 or 64h"
    raise WrongValue((), f"must be {form}, not {reprlib.repr(cell)}")


def flag_in(cell: str) -> bool:
    """Read true or false; raise WrongValue for anything else."""
    if cell.lower() not in ("true", "false"):
        raise WrongValue((), f"must be true or false, not {reprlib.repr(cell)}")
    return cell.lower() == "true"


CELLS: dict[str, Callable[[str], Any]] = {
    "str": str,
    "int": whole_in,
    "float": number_in,
    "float | None": number_in,
    "WriteFunction | None": str,
    "bool": flag_in,
    "tuple[str, ...]": lambda cell: [word.strip() for word in cell.split(";") if word.strip()],
}
"""Annotation of an argument -> reads its value from a cell."""
