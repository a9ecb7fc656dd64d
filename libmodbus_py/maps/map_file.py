"""
Register maps from files: in TOML, with a table ``[[point]]`` for each point and ``[defaults]`` for
all, or as lists, which `lists` reads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from os import PathLike, fspath
from pathlib import PurePath
from typing import Any

from ..files.schema import Key, Keys, keys_of, table, tables, whole
from ..files.texts import FilePlace, line_of, read_table, read_text, read_toml
from ..protocol.mistakes import Path, WrongValue, placed
from .list_words import ListOptions
from .lists import MapEntry, MapError, RegisterList
from .point import Point
from .point_plan import scale_mistakes

FORMS: tuple[str, ...] = (".toml", ".csv", ".tsv", ".txt", ".md", ".xlsx")
"""The suffixes of files that may be maps; all but the first have columns."""

POINT = keys_of(Point)
"""The keys of a point, in every file that describes points."""

_FIRST = Key("first_address", whole(0, 0xFFFF), "what the file calls address 0")
DEFAULTS = Keys([*POINT.but("name", "address").optional().values(), _FIRST])
"""The keys of ``[defaults]``: those of a point, and how its addresses count."""

_POINTS = Key("point", tables, "a table for each point: [[point]]", ())
FILE = Keys([_POINTS, Key("defaults", DEFAULTS.read, "keys of all points without their own")])


@dataclass
class Contents:
    """The content of a file, which is a map if there are no mistakes."""

    points: dict[str, Point] = field(default_factory=dict)
    entries: dict[str, MapEntry] = field(default_factory=dict)  # point -> its entry in the file
    mistakes: list[MapError] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # notes about an unusual reading of the file
    columns: Mapping[str, str] = field(default_factory=dict)  # kind of a column -> its heading

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
    path: str | PathLike[str], most: int, options: ListOptions | None = None
) -> Contents:
    """Read a file up to the mistake with the number `most`; otherwise as `load_map`."""
    options = options or ListOptions()
    suffix = PurePath(path).suffix.lower()
    if suffix not in FORMS:
        reason = f"a register map must end with one of {', '.join(FORMS)}"
        raise MapError((), reason, place=FilePlace(fspath(path)))
    note = ""
    if suffix == ".toml":
        text = read_text(path, MapError)
    else:
        text, note = read_table(path, MapError, options.encoding, options.sheet)
    contents = contents_of_text(text, suffix, most, options)
    contents.notes[:0] = [note] if note else []
    if note.startswith("read sheet") and not contents.columns:
        contents.mistakes = [
            MapError((), f"{error.reason}; {note}: --list sheet=NAME", place=error.place)
            for error in contents.mistakes
        ]
    contents.mistakes = [mistake.in_file(fspath(path)) for mistake in contents.mistakes]
    return contents


def contents_of_text(text: str, suffix: str, most: int, options: ListOptions) -> Contents:
    """Read the text of a file with one of the suffixes `FORMS`; otherwise as `contents_of`."""
    if suffix == ".toml":
        if not options.is_empty:
            raise ValueError("columns and such are for lists; TOML has [defaults]")
        return collected(Contents(), _toml_entries(text), most)
    try:
        rows = RegisterList(text, options)
    except MapError as error:
        return Contents(mistakes=[error])
    contents = Contents(notes=rows.notes, columns=rows.columns)
    return collected(contents, rows.entries(), most)


def _toml_entries(text: str) -> Iterator[MapEntry]:
    def place(path: Path) -> FilePlace:
        return FilePlace(line=line_of(text, path))

    try:
        content = FILE.read((), read_toml(text))
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        raise MapError.of(mistake, place(mistake.path)) from None
    defaults = content.get("defaults", {})
    for at, entry in enumerate(content.get("point", [])):
        path = ("point", at)
        yield MapEntry(path, place, partial(_with_defaults, path, entry, defaults))


def _with_defaults(path: Path, entry: object, defaults: Mapping[str, Any]) -> dict[str, Any]:
    usual = dict(defaults)
    first = usual.pop("first_address", 0)
    keys = {**usual, **table(path, entry)}
    if first and isinstance(keys.get("address"), int):
        keys["address"] -= first
    return keys


# Table -> how references to it begin (PI-MBUS-300): a 5-digit one is an address, too.
_REFERENCES = {"holding_registers": range(40001, 50000), "input_registers": range(30001, 40000)}


def remarks(contents: Contents) -> Iterator[str]:
    """Yield a line for everything in a file that is allowed, and unlikely."""
    points = list(contents.points.values())
    yield from contents.notes
    for name, span in _REFERENCES.items():
        addresses = {point.address for point in points if point.table == name}
        if addresses and addresses.issubset(span):
            reason = f"all addresses of {name} are in {span.start}..{span.stop - 1}"
            hint = f"{span.start} for address 0, leave out the column with the table"
            yield f"{reason}: if these are references, {hint}"
    for first, second in pairwise(sorted(points, key=lambda point: (point.table, point.address))):
        are_parts = first.is_part and second.is_part  # which may be different bits
        is_within = first.table == second.table and second.address < first.cells.stop
        if is_within and not are_parts:
            place = contents.place(second.name)
            yield f"{place}: {second.name} overlaps {first.name} at {second.table} {second.address}"
