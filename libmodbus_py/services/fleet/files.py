"""
Fleet files: devices and outputs, described in TOML.

``examples/fleet.toml`` of the source tree has every key once, explained. In short::

    devices                     a file of devices in CSV, see `devices_csv`
    [defaults]                  what devices have that do not say it themselves
    [[device]]                  as `DeviceConfig`; map is a file, or [[device.point]] tables
                                stand in its place, with what a `Point` has
    [engine]                    for several machines, see `workers.pushing`
    [output.json] [output.csv] [output.mqtt] ...
                                as `outputs.kinds`; "${NAME}" stands for what the environment
                                has under that name
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from os import PathLike
from pathlib import Path
from typing import Any

from ...maps.point import Point
from ...maps.register_map import RegisterMap
from ...tools.files.maps.drafts import MapError
from ...tools.files.maps.map_file import load_map
from ...tools.files.tables import checked_table
from ...tools.files.texts import load_file, read_text
from ...tools.files.toml_lines import below
from ...tools.files.toml_text import read_toml
from .config import DeviceConfig, checked
from .devices_csv import rows
from .outputs.kinds import KINDS, keys_of, made
from .outputs.output import Output

__all__ = ["FleetFile", "FleetFileError", "load"]

KEYS = ("devices", "defaults", "device", "output", "engine")

DEVICE = tuple(each.name for each in fields(DeviceConfig) if each.init)

POINT = tuple(each.name for each in fields(Point) if each.init)

# A line of 150 characters for each of 100000 devices.
MOST_OF_CSV = 1 << 24

# What must not stand in a file that many can read.
SECRET = ("password",)

_DEVICE = re.compile(r"\bdevices\[(\d+)\](?:\.(\w+))?")

_NAME = re.compile(r"\$\{(\w*)\}")


class FleetFileError(ValueError):
    """A fleet file that cannot be: which file, line and key, and what is allowed."""


@dataclass(frozen=True)
class FleetFile:
    """
    What a fleet file describes.

    Attributes:
        devices: for `Fleet`.
        outputs: kind -> the arguments of its class, with secrets.
    """

    devices: list[DeviceConfig]
    outputs: dict[str, dict[str, Any]] = field(default_factory=dict, repr=False)

    def made_outputs(self) -> list[Output]:
        """Make the outputs; each is for one fleet."""
        return [made(kind, keys) for kind, keys in self.outputs.items()]


def load(path: str | PathLike[str]) -> FleetFile:
    """
    Read a fleet file, and the files that it names: beside it, unless it says where.

    Raises:
        FleetFileError: one of them cannot be read, or says what cannot be.
    """
    return load_file(path, _Reader(Path(path)).parse, FleetFileError)


class _Reader:
    """
    Reads one fleet file.

    Args:
        path: of it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._maps: dict[Path, RegisterMap] = {}
        self._places: list[str] = []
        self._defaults: dict[str, Any] = {}

    def parse(self, text: str) -> FleetFile:
        try:
            given = checked_table("", read_toml(text), KEYS)
            self._defaults = _defaults(given.get("defaults", {}))
            devices = [
                *self._of_toml(given.get("device", [])),
                *self._of_csv(given.get("devices")),
            ]
            if not devices:
                raise ValueError("device must hold at least one table: [[device]]")
            self._check(devices)
            return FleetFile(devices, self._outputs(given.get("output", {})))
        except (TypeError, ValueError) as error:
            raise FleetFileError(str(error)) from None

    def _check(self, devices: list[DeviceConfig]) -> None:
        try:
            checked(devices)
        except ValueError as error:
            raise ValueError(_DEVICE.sub(self._place, str(error))) from None

    def _place(self, found: re.Match[str]) -> str:
        """Where a device stands, and its key if one is named."""
        place, key = self._places[int(found[1])], found[2]
        between = "." if place.startswith("device[") else ", column "
        return place + (between + key if key else "")

    # --- devices ----------------------------------------------------------------------------

    def _of_toml(self, given: object) -> Iterable[DeviceConfig]:
        if not isinstance(given, list):
            raise TypeError("device must be an array of tables: [[device]]")
        for at, each in enumerate(given):
            where = below("device", at)
            keys = dict(checked_table(where, each, (*DEVICE, "point")))
            if "point" in keys:
                if "map" in keys:
                    raise ValueError(f"{where}.point: there is a map already")
                keys["map"] = _points(f"{where}.point", keys.pop("point"))
            self._places.append(where)
            yield self._device(keys, self._path.parent, f"{where}.")

    def _of_csv(self, given: object) -> Iterable[DeviceConfig]:
        if given is None:
            return
        if not isinstance(given, str) or not given:
            raise TypeError(f"devices must be the name of a file in CSV, not {given!r}")
        path = self._path.parent / given
        try:
            text = read_text(path, FleetFileError, MOST_OF_CSV)
        except FleetFileError as error:
            raise ValueError(f"devices: {error}") from None
        try:
            for line, keys in rows(text):
                self._places.append(f"devices: {path}, line {line}")
                yield self._device(keys, path.parent, f"line {line}: ")
        except (TypeError, ValueError) as error:
            raise ValueError(f"devices: {path}, {error}") from None

    def _device(self, keys: dict[str, Any], folder: Path, where: str) -> DeviceConfig:
        keys = _with_defaults(self._defaults, keys)
        for key in ("name", "url", "map"):
            if key not in keys:
                raise ValueError(f"{where}{key} is missing")
        if not isinstance(keys["map"], RegisterMap):
            base = self._path.parent if keys["map"] is self._defaults.get("map") else folder
            keys["map"] = self._map(where, keys["map"], base)
        try:
            return DeviceConfig(**keys)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{where}{error}") from None

    def _map(self, where: str, given: object, folder: Path) -> RegisterMap:
        if not isinstance(given, str) or not given:
            raise TypeError(f"{where}map must be the name of a file, not {given!r}")
        path = folder / given
        if path not in self._maps:
            try:
                self._maps[path] = load_map(path)
            except MapError as error:
                raise ValueError(f"{where}map: {error}") from None
        return self._maps[path]

    # --- outputs ----------------------------------------------------------------------------

    def _outputs(self, given: object) -> dict[str, dict[str, Any]]:
        tables = checked_table("output", given, tuple(KINDS))
        found: dict[str, dict[str, Any]] = {}
        for kind, each in tables.items():
            where = f"output.{kind}"
            allowed = keys_of(kind)
            allowed += [f"{key}_file" for key in SECRET if key in allowed]
            keys = self._secrets(where, dict(checked_table(where, each, allowed)))
            if "path" in keys and isinstance(keys["path"], str) and keys["path"] != "-":
                keys["path"] = str(self._path.parent / keys["path"])
            try:
                made(kind, keys)
            except (TypeError, ValueError) as error:
                raise type(error)(f"{where}.{error}") from None
            found[kind] = keys
        return found

    def _secrets(self, where: str, keys: dict[str, Any]) -> dict[str, Any]:
        for key in SECRET:
            file = keys.pop(f"{key}_file", None)
            if file is not None:
                keys[key] = self._secret_of(f"{where}.{key}_file", file)
            elif isinstance(keys.get(key), str) and not _NAME.search(keys[key]):
                raise ValueError(
                    f"{where}.{key} must not stand here: write ${{NAME}}, a variable of the"
                    f" environment, or {key}_file"
                )
        return {
            key: _filled(f"{where}.{key}", value) if isinstance(value, str) else value
            for key, value in keys.items()
        }

    def _secret_of(self, where: str, file: object) -> str:
        if not isinstance(file, str):
            raise TypeError(f"{where} must be the name of a file, not {file!r}")
        try:
            return read_text(self._path.parent / file, ValueError, 4096).rstrip("\r\n")
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None


def _filled(where: str, text: str) -> str:
    def value(found: re.Match[str]) -> str:
        if found[1] not in os.environ:
            raise ValueError(f"{where}: {found[0]}: the environment has no such variable")
        return os.environ[found[1]]

    return _NAME.sub(value, text)


def _defaults(given: object) -> dict[str, Any]:
    keys = dict(checked_table("defaults", given, tuple(key for key in DEVICE if key != "name")))
    if "map" in keys and not isinstance(keys["map"], str):
        raise TypeError(f"defaults.map must be the name of a file, not {keys['map']!r}")
    return keys


def _with_defaults(defaults: Mapping[str, Any], keys: dict[str, Any]) -> dict[str, Any]:
    """Tables are put together: labels of both, bands of both."""
    merged = {**defaults, **keys}
    for key in ("labels", "dead_bands"):
        ours, own = defaults.get(key), keys.get(key)
        if isinstance(ours, dict) and isinstance(own, dict):
            merged[key] = {**ours, **own}
    if "dead_bands" in defaults and "items" in keys and isinstance(merged["dead_bands"], dict):
        items = keys["items"]  # bands of what this one does not read
        own = keys.get("dead_bands", {})
        merged["dead_bands"] = {
            name: band
            for name, band in merged["dead_bands"].items()
            if name in own or name in items
        }
    return merged


def _points(where: str, given: object) -> RegisterMap:
    if not isinstance(given, list) or not given:
        raise TypeError(f"{where} must be an array of tables: [[device.point]]")
    points = []
    for at, each in enumerate(given):
        place = below(where, at)
        keys = checked_table(place, each, POINT)
        for key in ("name", "table", "address"):
            if key not in keys:
                raise ValueError(f"{place}.{key} is missing")
        try:
            points.append(Point(**keys))
        except (TypeError, ValueError) as error:
            raise type(error)(f"{place}.{error}") from None
    try:
        return RegisterMap(points)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
