"""
Register maps from files: in TOML, with a table ``[[point]]`` for each point, or in CSV, as vendors
publish them.

In CSV, the headings name the columns, in any order, by `COLUMNS`. Empty cells are ignored. Without
a column for the table, addresses are references, such as 40123.

Only words that every vendor means alike are known: a "gain" multiplies with some and divides with
others, and a wrong guess would be a wrong value.
"""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from os import PathLike, fspath
from pathlib import PurePath
from typing import Any, NamedTuple

from ..files.csv_text import CsvRow, CsvText, flag_in, number_in, whole_in
from ..files.schema import Key, Keys, keys_of, table, tables
from ..files.texts import FileError, FilePlace, line_of, read_table, read_text, read_toml
from ..protocol.mistakes import Path, WrongValue, inside, placed
from ..protocol.values import parse_reference
from ..protocol.words import ORDER_WORDS, TABLE_WORDS, TYPE_WORDS, by_word, plain, type_named
from .point import Point
from .point_checks import BYTES, SCALES
from .point_plan import scale_mistakes

# fmt: off
__all__ = [
    "FORMS", "PADDINGS", "POINT", "Contents", "MapError", "contents_of", "contents_of_text",
    "remarks",
]
# fmt: on

FORMS: tuple[str, ...] = (".toml", ".csv", ".tsv", ".txt")
"""The suffixes of files that may be maps; all but the first have columns."""

FILE = Keys([Key("point", tables, "a table for each point: [[point]]", ())])

POINT = keys_of(Point)
"""The keys of a point, in every file that describes points."""


class MapError(FileError):
    """A file is not a valid register map; the message names file, line, column or key."""


class MapEntry(NamedTuple):
    """The description of one point in a file, not yet checked."""

    path: Path  # of the point in the file; empty in CSV, where a row is a point
    place: Callable[[Path], FilePlace]  # of a path in the file
    keys: Callable[[], Mapping[str, Any]]  # the arguments of `Point`, or a TypeError or ValueError


@dataclass
class Contents:
    """The content of a file, which is a map if there are no mistakes."""

    points: dict[str, Point] = field(default_factory=dict)
    entries: dict[str, MapEntry] = field(default_factory=dict)  # of each of these points
    mistakes: list[MapError] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # how it was read, if not in the usual way

    def place(self, name: str) -> FilePlace:
        """Return the place of a point in the file."""
        entry = self.entries[name]
        return entry.place(entry.path)


def collected(contents: Contents, entries: Iterable[MapEntry], most: int) -> Contents:
    """Add the points of entries to contents, up to the mistake with the number `most`."""
    points, mistakes = contents.points, contents.mistakes
    try:
        for entry in entries:
            try:
                point: Point = POINT.read(entry.path, entry.keys())
                if point.name in points:
                    reason = f"{point.name!r} stands in {contents.place(point.name)} already"
                    raise WrongValue((*entry.path, "name"), reason)
                points[point.name], contents.entries[point.name] = point, entry
            except (TypeError, ValueError) as error:
                mistake = placed(error, ())
                mistakes.append(MapError.of(mistake, entry.place(mistake.path)))
            if len(mistakes) == most:
                return contents
    except MapError as error:
        mistakes.append(error)
    for name, mistake in scale_mistakes(points) if not mistakes else ():
        entry = contents.entries[name]
        path = (*entry.path, *mistake.path[1:])
        mistakes.append(MapError.of(mistake.renamed(entry.path), entry.place(path)))
    del mistakes[most:]
    if not points and not mistakes:
        mistakes.append(MapError((), "it has no points"))
    return contents


def contents_of(
    path: str | PathLike[str], most: int, columns: Mapping[str, str] | None = None
) -> Contents:
    """Read a file up to the mistake with the number `most`; otherwise as `load_map`."""
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
    """Read the text of a file with one of the suffixes `FORMS`; otherwise as `contents_of`."""
    if suffix == ".toml":
        if columns:
            raise ValueError("columns are for CSV; the keys of TOML have the names of arguments")
        return collected(Contents(), _toml_entries(text), most)
    named = {COLUMNS.get(plain(kind), kind): heading for kind, heading in columns.items()}
    for kind in named:
        if kind not in READERS:
            allowed = ", ".join(READERS)
            raise ValueError(f"columns must name some of {allowed}, not {kind!r}")
    headings = COLUMNS.keys() | {plain(heading) for heading in named.values()}
    ignored: list[str] = []
    try:
        rows = CsvText(text, lambda heading: plain(heading) in headings, MapError)
        found = _columns(rows.head, named, ignored)
    except MapError as error:
        return Contents(mistakes=[error])
    notes = [f"rows above the headings that are skipped: {rows.skipped}"] if rows.skipped else []
    if ignored:
        notes.append(f"columns that mean nothing here: {', '.join(ignored)}")
    return collected(Contents(notes=notes), _csv_entries(rows, found), most)


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


# --- words -----------------------------------------------------------------------------------

COLUMNS = by_word(
    dict.fromkeys(POINT, "")
    | {
        "name": "parameter, parameter name, point, point name, signal, signal name, tag, tag name,"
        " variable, variable name, register name, symbol, label",
        "table": "register type, reg type, register table, object type, modbus table, area,"
        " modbus type",
        "function": "function code, fc, modbus function, func, func code",
        "address": "register, reg, register address, reg address, start address, addr,"
        " start register, modbus address, modbus register, register number, offset address",
        "count": "values",
        "type": "data type, datatype, value type, format, data format",
        "order": "byte order, word order, endianness, endian",
        "scale": "factor, multiplier, scaling, scale factor, scaling factor, multiply by",
        "divisor": "divider, divide by",
        "offset": "value offset",
        "units": "unit, engineering unit, engineering units, eng unit, uom",
        "access": "r w, rw, access type, access mode, read write, mode, permission, permissions",
        "minimum": "min, min value, low limit, lower limit",
        "maximum": "max, max value, high limit, upper limit",
        "description": "comment, comments, remark, remarks, note, notes, details, meaning",
        "missing": "missing value, missing values",
        "time_zone": "timezone",
        "interval": "poll interval, polling interval",
    }
)
"""Heading of a column -> kind of the column."""

AMBIGUOUS = {
    "gain": "scale (raw values are multiplied by it) or divisor",
    "sf": "scale, and write the factor itself: some write the power of ten, or its register",
}
"""Heading whose meaning differs between vendors -> the headings to use instead."""

FUNCTION_TABLES = {
    **dict.fromkeys((1, 5, 15), "coils"),
    2: "discrete_inputs",
    **dict.fromkeys((3, 6, 16, 22, 23), "holding_registers"),
    4: "input_registers",
}
"""Function code -> the table that it reads or writes."""

ACCESS_WORDS = by_word(
    {
        "read": "r, ro, read only, readonly",
        "write": "w, wo, write only, writeonly",
        "read_write": "read write, rw, r w, readwrite, wr, w r",
    }
)

PADDINGS = {"space": " ", "nul": "\0"}
"""Word -> the character that it stands for in the column of paddings."""

# --- columns and rows ------------------------------------------------------------------------

Columns = dict[str, tuple[int, str]]
"""Kind of a column -> its index, and its heading."""


def _columns(head: CsvRow, named: Mapping[str, str], ignored: list[str]) -> Columns:
    """Return the columns by their kinds, and add headings without a meaning to `ignored`."""
    place = FilePlace(line=head.line)
    cells = [" ".join(cell.split()) for cell in head.cells]
    by_heading = {plain(heading): kind for kind, heading in named.items()}
    for kind, heading in named.items():
        if plain(heading) not in map(plain, cells):
            raise MapError((), f"no column {heading}, which is named for {kind}", place=place)
    kinds = {word: kind for word, kind in COLUMNS.items() if kind not in named} | by_heading
    columns: Columns = {}
    # Headings that are the names of keys come before other words.
    headings = [(at, heading) for at, heading in enumerate(cells) if heading]
    for at, heading in sorted(headings, key=lambda each: plain(each[1]) not in READERS):
        found = kinds.get(plain(heading))
        if found is None and (instead := AMBIGUOUS.get(plain(heading))):
            reason = f"column {heading} means this or that: call it {instead}"
            raise MapError((), reason, place=place)
        if found is not None and found not in columns:
            columns[found] = at, heading
        elif found in (None, "description") or plain(columns[found][1]) in READERS:
            ignored.append(heading)
        else:
            reason = f"columns {columns[found][1]} and {heading} both hold the {found}"
            raise MapError((), reason, place=place)
    for key in ("name", "address"):
        if key not in columns:
            known = ", ".join(word for word, kind in COLUMNS.items() if kind == key)
            raise MapError((), f"no column {key}; it may be called {known}", place=place)
    return columns


def _csv_entries(text: CsvText, columns: Columns) -> Iterator[MapEntry]:
    """Yield the entry of each row; raise a MapError if the rest of the text is not CSV."""
    for row in text.rows():
        if any(row.cells[at : at + 1] != [""] for at, _ in columns.values()):
            place = partial(_place_in_row, row, columns)
            yield MapEntry((), place, partial(_keys_of_row, text, row, columns))


def _place_in_row(row: CsvRow, columns: Columns, path: Path) -> FilePlace:
    _, heading = columns.get(str(path[0]) if path else "", (0, ""))
    return FilePlace(line=row.line, column=heading)


def _keys_of_row(text: CsvText, row: CsvRow, columns: Columns) -> dict[str, Any]:
    cells = [" ".join(cell.split()) for cell in text.cells(row)]
    given = {key: cells[at] for key, (at, _) in columns.items() if at < len(cells) and cells[at]}
    found = {}
    for key, cell in given.items():
        with inside(key):
            read = READERS[key]
            found[key] = read(text.number_cell(cell) if read is number_in else cell)
    return _settled(found, given)


def _settled(keys: dict[str, Any], given: dict[str, str]) -> dict[str, Any]:
    """Resolve arguments that depend on several columns."""
    table = keys.pop("function", None)
    if table and keys.setdefault("table", table) != table:
        raise WrongValue("function", f"{given['function']} is none of {keys['table']}")
    if "address" in keys and "table" not in keys:
        with inside("address"):
            keys["table"], keys["address"] = _referred(given["address"])
    if "divisor" in given:
        if "scale" in given:
            raise WrongValue("divisor", "cannot be given together with a scale")
        if not keys["divisor"]:
            raise WrongValue("divisor", "must not be 0")
        keys["scale"] = 1 / keys.pop("divisor")
    if keys.get("missing") == "sunspec" and plain(given.get("type", "")).startswith("acc"):
        keys["missing"] = [0]  # of accumulators, 0 means "not implemented"
    if keys.get("type") == "bool":
        if keys.get("table", "").endswith("registers"):
            reason = "of registers must not be bool; bits16 gives those of one"
            raise WrongValue("type", reason)
        del keys["type"]
    return keys


def _referred(text: str) -> tuple[str, int]:
    try:
        return parse_reference(text)
    except ValueError:
        wanted = "a reference such as 40123 or 300007 where no column says the table"
        raise WrongValue((), f"must be {wanted}, not {reprlib.repr(text)}") from None


# --- cells -----------------------------------------------------------------------------------

_FUNCTION = re.compile(r"(?<![0-9a-z])(?:fc|f|0x)? ?([0-9]{1,2})(?![0-9a-z])")


def _word(meanings: dict[str, str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if found := meanings.get(plain(text)):
            return found
        allowed = ", ".join(dict.fromkeys(meanings.values()))
        raise WrongValue((), f"must be one of {allowed}, not {reprlib.repr(text)}")

    return read


_type_word = _word({**TYPE_WORDS, "string:n": "string:N"})


def _function(text: str) -> str:
    """Return the table of "3", "03/06/16", "0x04" or "FC 3"."""
    tables = {FUNCTION_TABLES.get(int(code)) for code in _FUNCTION.findall(text.casefold())}
    if len(tables) != 1 or None in tables:
        allowed = ", ".join(map(str, FUNCTION_TABLES))
        raise WrongValue((), f"must be of {allowed}, all of one table, not {reprlib.repr(text)}")
    return str(*tables)


def _missing(text: str) -> str | list[int | float]:
    """Return the numbers of "65535" or "0x8000; -1", or the word sunspec."""
    if plain(text) == "sunspec":
        return "sunspec"
    words = re.split(r"[;,\s]+", text.strip("; "))
    return [whole_in(each) if each[:2] in ("0x", "0X") else number_in(each) for each in words]


def _names(text: str) -> dict[str, str]:
    """Return the names of "0 = off; 1 = on", or of a JSON object."""
    if text.startswith("{"):
        try:
            return dict(json.loads(text))
        except ValueError:
            raise WrongValue((), f"must be a JSON object, not {reprlib.repr(text)}") from None
    found: dict[str, str] = {}
    for each in text.strip("; ").split(";"):
        key, separator, name = each.partition("=")
        if not separator or not name.strip():
            raise WrongValue((), f"must be like 0 = off; 1 = on, not {reprlib.repr(text)}")
        if key.strip() in found:
            raise WrongValue((), f"must name {key.strip()} once, not twice")
        found[key.strip()] = name.strip()
    return found


READERS: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(POINT, str),
    **dict.fromkeys(("address", "count"), whole_in),
    **dict.fromkeys(("scale", "divisor", "offset", "interval", "minimum", "maximum"), number_in),
    **dict.fromkeys(("plausible_minimum", "plausible_maximum"), number_in),
    **dict.fromkeys(("states", "bits"), _names),
    "table": _word(TABLE_WORDS),
    "function": _function,
    "type": lambda text: type_named(text) or _type_word(text),
    "order": lambda text: ORDER_WORDS.get(plain(text), text),
    "padding": lambda text: PADDINGS.get(plain(text), text),
    "access": _word(ACCESS_WORDS),
    "missing": _missing,
    **dict.fromkeys(("never_falls", "border"), flag_in),
    "scale_as": _word({word: word for word in SCALES}),
    "byte": _word({word: word for word in BYTES}),
}
"""Kind of a column -> the reader that returns the argument of `Point`, or raises WrongValue."""


# Table -> how references to it begin (PI-MBUS-300): a 5-digit one is an address, too.
_REFERENCES = {"holding_registers": range(40001, 50000), "input_registers": range(30001, 40000)}


def remarks(contents: Contents) -> Iterator[str]:
    """Yield a line for everything in a file that is allowed, and unlikely."""
    points = list(contents.points.values())
    yield from contents.notes
    for name, span in _REFERENCES.items():
        addresses = [point.address for point in points if point.table == name]
        if addresses and all(address in span for address in addresses):
            yield (
                f"all addresses of {name} are in {span.start}..{span.stop - 1}: if these are"
                f" references, {span.start} for address 0, leave out the column with the table"
            )
    for first, second in pairwise(sorted(points, key=lambda point: (point.table, point.address))):
        are_parts = first.is_part and second.is_part  # which may be different bits
        is_within = first.table == second.table and second.address < first.cells.stop
        if is_within and not are_parts:
            place = contents.place(second.name)
            yield f"{place}: {second.name} overlaps {first.name} at {second.table} {second.address}"
