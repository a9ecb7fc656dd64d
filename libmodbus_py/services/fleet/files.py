"""
Fleet files: devices and outputs, described in TOML; ``examples/fleet.toml`` has every key once.

Devices may also be in CSV, a row for each, for fleets of thousands. The headings are keys of
``[[device]]``, in any order, and ``labels.NAME``; for an empty cell the default is used.
"""

from __future__ import annotations

import os
import re
import reprlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from os import PathLike
from pathlib import Path as FilePath
from typing import Any, cast

from ...files.csv_text import CELLS, CsvRow, CsvText, number_in
from ...files.schema import REQUIRED, Key, Keys, keys_of, table, tables, text
from ...files.texts import FileError, FilePlace, line_of, load_file, read_table, read_toml
from ...maps.list_words import LIST, ListOptions, options_of
from ...maps.map_file import POINT
from ...maps.point_plan import scale_mistakes
from ...maps.register_map import RegisterMap, map_with
from ...protocol.mistakes import (
    Mistake,
    Path,
    WrongType,
    WrongValue,
    inside,
    item,
    path_text,
    placed,
)
from ...tools.simulator.example_files import map_file
from ..other_servers import SecretFile
from .config import ENGINE, DeviceConfig, conflicts
from .journal.journal import Journal
from .outputs.kinds import KINDS, make_output, output_keys
from .outputs.output import Output, file_at, shared_thing, used_thing

# Keys whose values must not be written in the fleet file, which many can read.
SECRET = ("password", "token")

MOST_MISTAKES = 20
"""Mistakes in the devices of a file that are reported at once: about a page."""

LABEL = "labels."
"""Columns with labels begin with this in CSV."""

_Place = Callable[[Exception], Mistake]

_NAME = re.compile(r"\$\{(\w*)\}")


class FleetFileError(FileError):
    """
    A mistake in a fleet file; it names the file, the line, the key and the allowed values.

    Attributes:
        others: further mistakes in the devices of the file, up to 20 in all.
    """

    others: tuple[FleetFileError, ...] = ()


@dataclass(frozen=True)
class FleetFile:
    """
    The contents of a fleet file.

    Attributes:
        devices: the devices of the fleet.
        outputs: the kind of each output, and the arguments of its class, secrets included.
        journal: the arguments of the `Journal`; empty if there is none.
        sources: the files that were read, which no output may use.
        engine: the table ``[engine]``, for fleets on several machines; empty if there is none.
        notes: how the list of devices was read, where that is not the usual way.
    """

    devices: list[DeviceConfig]
    outputs: list[tuple[str, dict[str, Any]]] = field(default_factory=list, repr=False)
    journal: dict[str, str] = field(default_factory=dict)
    sources: frozenset[str] = field(default=frozenset(), repr=False)
    engine: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def make_outputs(self) -> list[Output]:
        """Return new outputs; each can be used by one fleet only."""
        return [make_output(kind, keys) for kind, keys in self.outputs]

    def make_journal(self) -> Journal | None:
        """Return a new journal, which can be used by one fleet only; None if there is none."""
        return Journal(**self.journal) if self.journal else None


def load(path: str | PathLike[str]) -> FleetFile:
    """
    Read a fleet file, and the files that it names, whose paths are relative to its folder.

    Raises:
        FleetFileError: a file cannot be read or contains a mistake.
    """
    reader = _Reader(FilePath(path))
    try:
        return load_file(path, reader.parse, FleetFileError)
    except FleetFileError as error:
        error.others = reader.other_mistakes()
        raise


class _Reader:
    """Reads one fleet file."""

    def __init__(self, path: FilePath) -> None:
        self._path = path
        self._folder = path.parent
        self._sources = {file_at(str(path))}
        self._maps: dict[tuple[FilePath, str], RegisterMap] = {}
        self._text = ""
        self._notes: list[str] = []
        self._defaults: dict[str, Any] = {}
        self._devices: list[DeviceConfig] = []
        self._mistakes: list[Mistake] = []

    def parse(self, text: str) -> FleetFile:
        self._text = text
        content = FILE.read((), read_toml(text))
        self._defaults = content.get("defaults", {})
        # For each device: returns an error about it with its place in the file.
        places: list[_Place] = []
        for place, keys, folder in self._described(content):
            try:
                self._devices.append(self._device(keys(), folder))
                places.append(place)
            except (TypeError, ValueError) as error:
                self._mistakes.append(place(error))
                if len(self._mistakes) == MOST_MISTAKES:
                    break
        self._mistakes += (places[at](error) for at, error in conflicts(self._devices))
        if self._mistakes:
            raise self._mistakes[0]
        if not self._devices:
            raise WrongValue("device", "must hold at least one table: [[device]]")
        outputs = self._outputs(content.get("output", {}))
        journal, engine = self._journal(content), content.get("engine", {})
        sources, notes = frozenset(self._sources), tuple(self._notes)
        return FleetFile(self._devices, outputs, journal, sources, engine, notes)

    def other_mistakes(self) -> tuple[FleetFileError, ...]:
        """Return the mistakes in devices but for the first one."""
        return tuple(
            FleetFileError.of(error, FilePlace(str(self._path), line_of(self._text, error.path)))
            for error in self._mistakes[1:MOST_MISTAKES]
        )

    # --- devices ----------------------------------------------------------------------------

    def _described(
        self, file: Mapping[str, Any]
    ) -> Iterator[tuple[_Place, Callable[[], dict[str, Any]], FilePath]]:
        """Yield for each device what places its errors and returns its keys, and its folder."""
        for at, raw in enumerate(file.get("device", [])):
            place = partial(placed, around=("device", at))
            yield place, partial(_keys_of_table, raw), self._folder
        if "devices" not in file:
            return
        path = self._folder / file["devices"]
        self._sources.add(file_at(str(path)))
        with inside("devices"):
            content, note = read_table(path, FleetFileError, file.get("encoding"))
        try:
            text = table_of(content)
            rows_skipped = f"rows above the headings that are skipped: {text.skipped}"
            notes = [note, rows_skipped if text.skipped else ""]
            self._notes += [f"{path}: {note}" for note in notes if note]
            for row in text.rows():
                yield partial(_of_row, path, text, row), partial(keys_in, text, row), path.parent
        except FleetFileError as error:
            self._mistakes.append(error.in_file(str(path)).under(("devices",)))

    def _device(self, own: dict[str, Any], folder: FilePath) -> DeviceConfig:
        """Return the device that these keys describe, with the defaults; labels are merged."""
        usual = dict(self._defaults)
        bands = usual.pop("dead_bands", {})
        keys = {**usual, **own}
        keys["labels"] = {**usual.get("labels", {}), **own.get("labels", {})}
        options = options_of({key: keys.pop(key) for key in ("columns", "list") if key in keys})
        for key in DEVICE.values():
            if key.default is REQUIRED and key.name not in keys:
                raise WrongValue(key.name, "is missing")
        if not isinstance(keys["map"], RegisterMap):
            base = folder if "map" in own else self._folder
            with inside("map"):
                keys["map"] = self._map(base / map_file(keys["map"]), options)
        device = DeviceConfig(**keys)
        # The default bands are those of the points that the device reads.
        bands = {name: band for name, band in bands.items() if name in device.names}
        return replace(device, dead_bands={**bands, **device.dead_bands}) if bands else device

    def _map(self, path: FilePath, options: ListOptions) -> RegisterMap:
        key = path, repr(options)
        if key not in self._maps:
            self._sources.add(file_at(str(path)))
            self._maps[key] = map_with(path, options)
        return self._maps[key]

    # --- journal and outputs ----------------------------------------------------------------

    def _journal(self, content: Mapping[str, Any]) -> dict[str, str]:
        """Return the arguments of the journal, which is made to check them."""
        names = {"keep": "keep", "journal_size": "size"}
        keys = {name: content[key] for key, name in names.items() if key in content}
        if "journal" in content:
            keys["path"] = str(self._folder / content["journal"])
        elif keys:
            raise WrongValue("journal", "is missing, but keep and journal_size need it")
        try:
            if keys:
                Journal(**keys)
        except Mistake as error:
            path = ("journal_size",) if error.path == ("size",) else error.path
            raise error.renamed(path) from None
        return keys

    def _outputs(self, kinds: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
        """Return the kind and the arguments of each output, which is made to check them."""
        outputs, places, trial = [], [], list[Output]()
        for kind, output_tables in kinds.items():
            for path, raw in output_tables:
                with inside(*path):
                    keys = {key: _filled(key, value) for key, value in self._secrets(raw).items()}
                    if isinstance(keys.get("path"), str) and keys["path"] != "-":
                        keys["path"] = str(self._folder / keys["path"])
                    output = make_output(kind, keys)
                    output.describe_devices({device.name: device for device in self._devices})
                outputs.append((kind, keys))
                places.append(path)
                trial.append(output)
        if (both := shared_thing(trial)) is not None:
            first, second, what = both
            reason = f"uses {what}, as {path_text(places[first])} does"
            raise WrongValue.about(places[second], reason)
        for place, output in zip(places, trial, strict=True):
            if (source := used_thing(output, self._sources)) is not None:
                raise WrongValue.about(place, f"uses {source}, which the fleet is read from")
        return outputs

    def _secrets(self, raw: Mapping[str, Any]) -> dict[str, Any]:
        """Return the keys of an output with the contents of files; refuse secrets in the text."""
        keys = dict(raw)
        for key in SECRET:
            name = f"{key}_file"
            if name in keys:
                path = self._folder / _file_name((name,), keys.pop(name))
                self._sources.add(file_at(str(path)))
                with inside(name):
                    keys[key] = SecretFile(path, FleetFileError)
            elif key in keys and not (isinstance(keys[key], str) and _NAME.search(keys[key])):
                ways = f"${{NAME}}, a variable of the environment, or {name}"
                raise WrongValue(key, f"must not be written in the file: use {ways}")
        return keys


def _filled(key: str, value: Any) -> Any:
    """Replace ``${NAME}`` in a text by the variable of the environment; return other values."""
    if not isinstance(value, str):
        return value
    for name in _NAME.findall(value):
        if name not in os.environ:
            reason = f"${{{name}}}: the environment has no such variable"
            raise WrongValue.about(key, reason)
    return _NAME.sub(lambda match: os.environ[match[1]], value)


def _keys_of_table(raw: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a table [[device]], whose points are its map."""
    keys: dict[str, Any] = TABLE.read((), raw)
    if "point" in keys and keys.keys() & {"map", "columns", "list"}:
        raise WrongValue.about("point", "the device has a map already")
    if "point" in keys:
        keys["map"] = keys.pop("point")
    return keys


# --- devices in CSV ----------------------------------------------------------------------


def table_of(text: str) -> CsvText:
    """Return devices in CSV; raise a FleetFileError if it is none, or a heading is wrong."""
    columns = [key.name for key in DEVICE.values() if key.kind in CELLS or key.name == "map"]

    def is_column(heading: str) -> bool:
        return heading in columns or heading.startswith(LABEL)

    content = CsvText(text, is_column, FleetFileError)
    headings = content.head.cells
    for at, heading in enumerate(headings):
        reason = ""
        if heading and not is_column(heading):
            names = ", ".join([*columns, f"{LABEL}NAME"])
            reason = f"no such column: {reprlib.repr(heading)}; allowed are {names}"
        elif heading and heading in headings[:at]:
            reason = f"two columns {heading}"
        if reason:
            raise FleetFileError((), reason, place=FilePlace(line=content.head.line))
    return content


def keys_in(text: CsvText, row: CsvRow) -> dict[str, Any]:
    """Return the keys of the device in a row; raise a WrongValue with the path of a key."""
    keys: dict[str, Any] = {}
    for heading, cell in zip(text.head.cells, text.cells(row), strict=False):
        if not (heading and cell):
            continue
        if heading.startswith(LABEL):
            keys.setdefault("labels", {})[heading.removeprefix(LABEL)] = cell
            continue
        with inside(heading):
            read = CELLS.get(DEVICE[heading].kind, str)
            keys[heading] = read(text.number_cell(cell) if read is number_in else cell)
    return keys


def _of_row(path: FilePath, text: CsvText, row: CsvRow, error: Exception) -> Mistake:
    """Return an error about a row of the file of devices with its place there."""
    mistake = placed(error, ())
    key = mistake.path[:2] if mistake.path[:1] == ("labels",) else mistake.path[:1]
    heading = ".".join(map(str, key))
    place = FilePlace(str(path), row.line, heading if heading in text.head.cells else "")
    return FleetFileError.of(mistake, place).under(("devices",))


# --- the keys ----------------------------------------------------------------------------


def _file_name(path: Path, value: object) -> str:
    if not isinstance(value, str) or not value:
        raise WrongType(path, f"must be the name of a file, not {value!r}")
    return value


def _points(path: Path, value: object) -> RegisterMap:
    if not isinstance(value, list) or not value:
        raise WrongType(path, "must be an array of tables: [[device.point]]")
    points = [POINT.read(item(path, at), raw) for at, raw in enumerate(value)]
    indexes = {point.name: at for at, point in enumerate(points)}
    for name, mistake in scale_mistakes({point.name: point for point in points}):
        raise mistake.renamed(item(path, indexes[name]))
    with inside(*path):
        return RegisterMap(points)


def _columns(path: Path, value: object) -> dict[str, str]:
    for key, heading in table(path, value).items():
        if not isinstance(heading, str) and key != "nothing":
            raise WrongType((*path, key), f"must be the heading of a column, not {heading!r}")
    return cast(dict[str, str], value)


def _one_or_several(path: Path, value: object) -> list[tuple[Path, dict[str, Any]]]:
    """Return the table ``[output.KIND]``, or the tables ``[[output.KIND]]``, with their paths."""
    keys = output_keys(str(path[-1]))
    files = [Key(f"{key}_file", text=f"a file with the {key}") for key in SECRET if key in keys]
    either = (keys | Keys(files)).optional()
    if not isinstance(value, list):
        return [(path, either.read(path, value))]
    return [(item(path, at), either.read(item(path, at), raw)) for at, raw in enumerate(value)]


DEVICE = keys_of(DeviceConfig, map=_file_name, dead_bands=table, labels=table)

POINTS = Key("point", _points, "a table for each point, [[device.point]], instead of a map")

COLUMNS = Key("columns", _columns, "headings of a map that are not recognised, by their meaning")

OF_LIST = Key("list", LIST.read, "what a list does not say of itself, as for load_map")

TABLE = (DEVICE | Keys([COLUMNS, OF_LIST, POINTS])).optional()

OUTPUTS = Keys(Key(kind, _one_or_several) for kind in KINDS)

DEFAULTS = (DEVICE.but("name") | Keys([COLUMNS, OF_LIST])).optional()

# fmt: off
FILE = Keys([
    Key("journal", _file_name, "a file that keeps readings for outputs that are away"),
    Key("keep", text="how long the journal keeps readings, such as 90 days"),
    Key("journal_size", text="the size of the journal, such as 2 GB"),
    Key("devices", _file_name, "a file of devices in CSV, Markdown or .xlsx"),
    Key("encoding", text, "the encoding of that file, UTF-8 unless it is given"),
    Key("defaults", DEFAULTS.read, "defaults of the keys of devices"),
    Key("device", tables, "a table for each device: [[device]]"),
    Key("output", OUTPUTS.read,
        "a table for each output: [output.KIND], or several: [[output.KIND]]"),
    Key("engine", ENGINE.read, "options of several machines that share a fleet"),
])
# fmt: on
