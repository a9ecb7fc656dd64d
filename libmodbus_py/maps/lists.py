"""
Register lists as vendors and programs write them: which rows are read, and what each says of a
point.

Nothing is guessed: a heading or a word with two meanings, and a column that would change values but
is not known, are mistakes, which name the option that says what is meant.
"""

from __future__ import annotations

import re
import reprlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

from ..files.csv_text import CsvRow, CsvText, number_in
from ..files.texts import FileError, FilePlace
from ..protocol.mistakes import Path, WrongValue, inside
from ..protocol.values import value_type
from ..protocol.words import plain
from .list_cells import (
    BLANKS,
    HEADINGS_OF_KINDS,
    KEYS,
    NOTHING,
    RAW,
    READERS,
    SaidColumns,
    address_in,
    factor_in,
    find_columns,
    option_for,
    without_base,
)
from .list_words import (
    MODPOLL,
    MOST_NAMED,
    REFERENCE,
    ListOptions,
    flat_rows,
    kind_of_cells,
    type_keys,
    width_of,
    word_of,
    words,
)
from .scaling import Scaling

FREE = frozenset(("name", "description", "group", "writable", "initial", "bits", "states"))
"""Kinds of columns in whose cells a dash means something, as it does below the keys of maps."""

LAST_OF_BYTE = {"int8": -128, "uint8": 255}
"""Type that SunSpec lacks -> what it would take for no value."""


class MapError(FileError):
    """A file is not a valid register map; the message names file, line, column or key."""


class MapEntry(NamedTuple):
    """The description of one point in a file, not yet checked."""

    path: Path  # of the point in the file; empty in a list, where a row is a point
    place: Callable[[Path], FilePlace]  # of a path in the file
    keys: Callable[[], Mapping[str, Any]]  # the arguments of `Point`, or a TypeError or ValueError


class RegisterList:
    """
    The text of a list, as CSV or Markdown, and what its columns mean.

    A MapError says that the headings have no meaning, or two; a ValueError, that an option names a
    column or a row that a list cannot have. `notes` say how it was read, and what is ignored.
    """

    def __init__(self, text: str, options: ListOptions) -> None:
        self._content = text
        self._options = options
        self._origin = options.of_origin
        self.notes: list[str] = []
        self._said = SaidColumns.of(options.columns)
        headings = {*HEADINGS_OF_KINDS, *words().headings, *words().ambiguous}
        headings |= {*self._origin.columns, *map(word_of, self._said.headings.values())}
        is_modpoll = options.origin == "modpoll"
        self._text = CsvText(
            text, lambda cell: word_of(cell) in headings, MapError, headings=MODPOLL * is_modpoll
        )
        if options.origin is None:
            self._options = options.with_origin_of(self._text.head.cells)
            self._origin = self._options.of_origin
        if self._options.origin != options.origin:
            self.notes.append(f"read as a list of {self._options.origin}, whose headings it has")
        self._give_headings()
        if self._text.skipped:
            self.notes.append(f"rows above the headings that are skipped: {self._text.skipped}")
        self._columns, ignored_headings = find_columns(
            self._text.head, self._said, self._origin, self._error
        )
        if "type" not in self._columns and "" not in self._origin.types:
            self.notes.append("no column has the type: registers are uint16")
        if ignored_headings:
            self.notes.append(f"columns that mean nothing here: {', '.join(ignored_headings)}")
        rows = [*(flat_rows(self._text.rows()) if is_modpoll else self._text.rows())]
        self._rows = list(self._selected(rows))
        self._table = self._options.table or self._origin.table
        self._tells_table = {"table", "function"} & self._columns.keys() or self._table
        self._first_address = self._options.first_address  # the list's number for address 0
        if self._first_address is None and self._tells_table:
            self._first_address = self._origin.first_address
        self._check_ignored(ignored_headings)
        self._check_addresses()
        self._check_offsets()
        self._names = self._read_names()

    @property
    def columns(self) -> dict[str, str]:
        """Kind of each column that says something -> its heading."""
        return {kind: column.heading for kind, column in self._columns.items()}

    def entries(self) -> Iterator[MapEntry]:
        """Yield the entry of each row."""
        for row in self._rows:
            yield MapEntry((), partial(self._place, row), partial(self._keys, row))

    # --- columns ---------------------------------------------------------------------------

    def _give_headings(self) -> None:
        """Use the headings of the origin for a list that has none."""
        head = self._text.head
        headings = self._origin.headings.get(len(head.cells))
        if headings and not any(word_of(cell) in words().headings for cell in head.cells):
            self._text.head = CsvRow(0, headings)
            self._text.skipped = 0

    def _error(self, reason: str) -> MapError:
        if self._options.origin is None:
            for name, origin in words().origins.items():
                if any(sign in self._content for sign in origin.signs):
                    reason += f"; --from {name} reads such lists"
        return MapError((), reason, place=FilePlace(line=self._text.head.line or None))

    # --- rows ------------------------------------------------------------------------------

    def _selected(self, rows: list[CsvRow]) -> Iterator[CsvRow]:
        """Yield the rows of one device that have a cell in a column that means something."""
        filters = {}
        cells = [word_of(cell) for cell in self._text.head.cells]
        for heading, value in self._options.only.items():
            if word_of(heading) not in cells:
                raise self._error(f"no column {heading}, which is named in only")
            filters[cells.index(word_of(heading))] = str(value)
        device = self._columns.get("device")
        if device is not None and device.at not in filters:
            values = dict.fromkeys(_cell(row, device.at) for row in rows)
            values.pop("", None)
            if len(values) > 1:
                some = ", ".join([*values][:MOST_NAMED]) + " ..." * (len(values) > MOST_NAMED)
                example = f"--list 'only={device.heading}={next(iter(values))}'"
                reason = f"column {device.heading} has several devices, {some}"
                raise self._error(f"{reason}: say one, as in {example}")
        count = 0
        kind_of = {word_of(heading): kind for kind, heading in self._said.headings.items()}
        meanings = words().headings | kind_of
        is_of_other = False
        for row in rows:
            kinds = {meanings.get(word_of(cell), word_of(cell)) for cell in row.cells}
            if row.cells == self._text.head.cells:
                is_of_other = False
                self.notes.append(f"the headings are repeated in line {row.line}")
                continue
            if kinds.issuperset(("name", "address")):
                reason = "has other headings: a list has one table"
                raise MapError((), reason, place=FilePlace(line=row.line))
            if self._text.is_head(row):
                is_of_other = True
                self.notes.append(f"the table in line {row.line} has other headings: not read")
            if is_of_other:
                continue
            if all(_cell(row, at) == value for at, value in filters.items()) and any(
                _cell(row, column.at) for column in self._columns.values()
            ):
                count += 1
                yield row
        if filters and not count:
            raise self._error(f"no row has {dict(self._options.only)}")

    def _check_ignored(self, headings: list[str]) -> None:
        """Refuse a column whose heading means nothing, and whose cells would change values."""
        heads = [" ".join(cell.split()) for cell in self._text.head.cells]
        for heading in headings:
            at = heads.index(heading)
            cells = {cell for row in self._rows if (cell := _cell(row, at)) and cell not in BLANKS}
            kind = kind_of_cells(cells)
            if kind and kind not in self._columns and word_of(heading) not in self._said.ignored:
                example = reprlib.repr(next(iter(sorted(cells))))
                reason = f"column {heading} may hold the {kind}, as it has {example}"
                advice = f"{option_for(kind, heading)}, or {option_for(NOTHING, heading)}"
                raise self._error(f"{reason}: say {advice} to ignore it")
        count = self._columns.get("count")
        # A heading in small letters is the key of a map.
        is_said = count is None or count.heading == "count" or "count" in self._said.headings
        if count is not None and not is_said and "type" in self._columns:
            at = self._columns["type"].at
            widths = {(_cell(row, count.at), width_of(_cell(row, at))) for row in self._rows}
            if all(number == str(width) for number, width in widths) and widths != {("1", 1)}:
                options = (option_for(kind, count.heading) for kind in ("registers", "count"))
                advice = " or ".join(options)
                raise self._error(
                    f"column {count.heading} may count registers or values: say {advice}"
                )

    def _check_addresses(self) -> None:
        """Refuse addresses that may count from 0 or from 1, or be references."""
        column, origin = self._columns["address"], self._options.origin
        if not self._tells_table and self._first_address != REFERENCE:
            if self._first_address is not None or origin == "iobroker":
                tables = "holding_registers, input_registers, coils or discrete_inputs"
                reason = f"say --list table= one of {tables}"
                if self._first_address is None:  # the first digits of references say the table
                    reason += ", whose addresses count from 0, or first_address=reference"
                raise self._error(f"no column has the table: {reason}")
            self.notes.append(f"{column.heading} has references: 40001 is holding register 0")
        word = without_base(word_of(column.heading))[0]
        if self._first_address is not None or not self._tells_table or word in KEYS:
            return
        is_numbered = any(part in words().numbered for part in (word, *word.split()))
        if is_numbered and "addr" not in word:
            reason = f"column {column.heading} may count from 0 or from 1"
            raise self._error(f"{reason}: say --list first_address=0, =1 or =reference")
        cells = [_cell(row, column.at) for row in self._rows]
        numbers = [int(cell) for cell in cells if re.fullmatch("[0-9]{5}", cell)]
        references = [number for number in numbers if 30001 <= number <= 49999]
        if 2 * len(references) >= len(cells) > 0:
            reason = f"column {column.heading} may have references, such as {references[0]}"
            raise self._error(f"{reason}: say --list first_address=0 or =reference")

    def _check_offsets(self) -> None:
        """Refuse a column of offsets that are added to addresses, and not to values."""
        at, offset = self._columns["address"].at, self._columns.get("offset")
        if offset is None or "offset" in self._said.headings:
            return
        cells = [(_cell(row, at), _cell(row, offset.at)) for row in self._rows]
        pairs = {int(one) - int(two) for one, two in cells if one.isdecimal() and two.isdecimal()}
        if len(pairs) == 1 and len(cells) > 1 and all(two.isdecimal() for _, two in cells):
            reason = f"column {offset.heading} rises with the addresses: say --column"
            raise self._error(f"{reason} nothing={offset.heading} or offset={offset.heading}")

    def _read_names(self) -> dict[int, str]:
        """Return the name of each row by its line; those that an origin repeats get the address."""
        at = self._columns["name"].at
        names = {row.line: " ".join(_cell(row, at).split()) for row in self._rows}
        counts = Counter(names.values())
        if self._options.origin is None:
            return names
        duplicates = [row for row in self._rows if counts[names[row.line]] > 1 and names[row.line]]
        for row in duplicates:
            names[row.line] += f" {_cell(row, self._columns['address'].at)}"
        if duplicates:
            lines = ", ".join(str(row.line) for row in duplicates[:MOST_NAMED])
            more = " ..." * (len(duplicates) > MOST_NAMED)
            self.notes.append(f"names that occur twice have their address behind: {lines}{more}")
        return names

    def _place(self, row: CsvRow, path: Path) -> FilePlace:
        kind = str(path[0]) if path else ""
        kinds = [kind, *(raw for raw, name in RAW.items() if name == kind)]
        heading = next((self._columns[k].heading for k in kinds if k in self._columns), "")
        return FilePlace(line=row.line, column=heading)

    # --- the arguments of a point -------------------------------------------------------------

    def _keys(self, row: CsvRow) -> dict[str, Any]:
        cells = [" ".join(cell.split()) for cell in self._text.cells(row)]
        texts = {
            kind: cells[column.at]
            for kind, column in self._columns.items()
            if column.at < len(cells) and cells[column.at]
            if kind in FREE or column.heading == kind or cells[column.at] not in BLANKS
        }
        keys: dict[str, Any] = {}
        for kind, text in texts.items():
            with inside(kind):
                keys[kind] = self._read(kind, text)
        texts["name"] = self._names[row.line]
        keys |= {"name": texts["name"]} if texts["name"] else {}
        self._settle_address(keys, texts)
        self._settle_type(keys, texts)
        self._settle_scale(keys)
        keys.setdefault("access", keys.pop("writable", None) or self._options.access)
        keys.pop("device", None)
        keys |= keys.pop("units_or_states", {})
        return {key: value for key, value in keys.items() if value is not None}

    def _read(self, kind: str, text: str) -> Any:
        if kind == "access" and word_of(text) in self._origin.accesses:
            return self._origin.accesses[word_of(text)]
        read = READERS[kind]
        is_number = read in (number_in, factor_in) or kind == "initial"
        return read(self._text.number_cell(text) if is_number else text)

    def _settle_address(self, keys: dict[str, Any], texts: Mapping[str, str]) -> None:
        table = keys.pop("function", None)
        if table and keys.setdefault("table", table) != table:
            raise WrongValue("function", f"{texts['function']} is none of {keys['table']}")
        keys.setdefault("table", self._table)
        if "address" not in texts:
            return
        with inside("address"):
            first = self._first_address
            is_reference = first == REFERENCE or not self._tells_table
            base = self._columns["address"].base or (0 if first is None else 10)
            table, address, size = address_in(texts["address"], base, is_reference=is_reference)
            if table and keys["table"] not in (None, table):
                raise WrongValue((), f"{texts['address']} is none of {keys['table']}")
            if isinstance(first, int) and not table:
                address -= first
            if address < 0:
                raise WrongValue((), f"{texts['address']} is below the first address, {first}")
            keys["address"] = address
        keys["table"] = keys["table"] or table
        if size is not None:
            keys.setdefault("registers", size)

    def _settle_type(self, keys: dict[str, Any], texts: Mapping[str, str]) -> None:
        registers, size = keys.pop("registers", None), keys.pop("bytes", None)
        is_of_registers = str(keys["table"]).endswith("registers")
        if is_of_registers:
            keys.setdefault("order", self._options.order or self._origin.order)
        if "type" in texts or (is_of_registers and "" in self._origin.types):
            with inside("type"):
                keys |= type_keys(texts.get("type", ""), self._options, registers, size)
        if not is_of_registers and "type" in texts:
            keys.pop("order", None)
        if "initial" in texts and str(keys.get("type")).startswith(("string", "eui")):
            keys["initial"] = texts["initial"]
        if keys.get("type") == "bool":
            if is_of_registers:
                reason = "of registers must not be bool; bits16 gives those of one"
                raise WrongValue("type", reason)
            del keys["type"]
        if self._origin.missing and str(keys.get("type")).startswith(("int", "uint")):
            keys.setdefault("missing", LAST_OF_BYTE.get(keys["type"], self._origin.missing))
        if keys.get("missing") == "sunspec" and plain(texts.get("type", "")).startswith("acc"):
            keys["missing"] = [0]  # of accumulators, 0 means "not implemented"
        if registers is not None and not self._origin.is_sloppy and is_of_registers:
            type_word = keys.get("type", "uint16")
            width = value_type(type_word).registers * keys.get("count", 1)
            if width != registers:
                reason = f"{type_word} has {width}, and the list says {registers}"
                raise WrongValue.about("registers", reason)

    def _settle_scale(self, keys: dict[str, Any]) -> None:
        for kind in ("scale", "divisor"):
            if self._origin.is_sloppy and not keys.get(kind, 1):
                del keys[kind]
        if formula := keys.pop("formula", None):
            keys.pop("offset", None)
            keys.pop("scale", None)
            keys |= formula
        if pair := keys.pop("scale_and_units", None):
            keys["units"] = keys.get("units", pair["units"])
            keys |= {"scale": pair["scale"]} if "scale" in pair else {}
        for kind in ("exponent", "negative_exponent"):
            if (power := keys.pop(kind, None)) is not None:
                if "scale" in keys:
                    raise WrongValue(kind, "cannot be given together with a scale")
                keys["scale"] = 10**power if power >= 0 else float(f"1e{power}")
        if "divisor" in keys:
            if "scale" in keys:
                raise WrongValue("divisor", "cannot be given together with a scale")
            if not keys["divisor"]:
                raise WrongValue("divisor", "must not be 0")
            scale = 1 / keys.pop("divisor")
            keys["scale"] = int(scale) if scale.is_integer() else scale
        if (address := keys.pop("scale_address", None)) is not None:
            at = self._columns["address"].at
            sources = [row for row in self._rows if _cell(row, at) == address]
            if not sources:
                raise WrongValue("formula", f"no row has the address {address}")
            keys["scale_from"] = self._names[sources[0].line]
        scale, offset = keys.get("scale", 1), keys.get("offset", 0)
        raws = {kind: keys.pop(kind) for kind in RAW if kind in keys}
        if raws.get("raw_minimum") == raws.get("raw_maximum") == 0:
            del raws["raw_minimum"], raws["raw_maximum"]  # which name no bounds
        if raws.get("raw_initial") == 0:
            del raws["raw_initial"]  # with which devices begin anyway
        for kind, raw in raws.items():
            is_scaled = (scale, offset) != (1, 0)
            keys[RAW[kind]] = Scaling(scale, offset).to_value(raw) if is_scaled else raw
        if scale < 0 and "raw_minimum" in raws and "raw_maximum" in raws:
            keys["minimum"], keys["maximum"] = keys["maximum"], keys["minimum"]


def _cell(row: CsvRow, at: int) -> str:
    return row.cells[at] if at < len(row.cells) else ""
