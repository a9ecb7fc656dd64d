"""Loads files of any kind: register maps, devices, gateways and fleets."""

from __future__ import annotations

import reprlib
from os import PathLike, fspath
from pathlib import PurePath
from typing import TYPE_CHECKING

from ..files.texts import FileError, FilePlace, read_text, read_toml

if TYPE_CHECKING:
    from ..maps.register_map import RegisterMap
    from ..tools.simulator.simulated import Simulation
    from .fleet.files import FleetFile
    from .gateway.config import GatewayFile

KINDS: dict[str, str] = {
    "point": "map",
    "unit": "device",
    "route": "gateway",
    "listen": "gateway",
    "device": "fleet",
    "devices": "fleet",
}
"""Key at the top level of a TOML file -> what such a file describes."""


def load(path: str | PathLike[str]) -> RegisterMap | Simulation | GatewayFile | FleetFile:
    """
    Load a register map, or a device, gateway or fleet file. The contents decide which it is.

    Args:
        path: the path of the file. A name that ends with ``.csv``, ``.tsv``, ``.txt``, ``.md`` or
            ``.xlsx`` is that of a register map; other files are TOML.

    Returns:
        What the file describes: a `RegisterMap`; a `Simulation`, whose `devices` a
        `Server` serves; a `GatewayFile` or a `FleetFile`.

    Raises:
        FileError: a ValueError: the file cannot be read, is not of one of these kinds, or contains
            a mistake. The message names the file and, where it can, the line and the key.
    """
    place = FilePlace(fspath(path))
    kinds = {"map"}
    if PurePath(path).suffix.lower() not in (".csv", ".tsv", ".txt", ".md", ".xlsx"):
        text = read_text(path, FileError)
        try:
            content = read_toml(text)
        except ValueError as error:
            raise FileError.of(error, place) from None
        kinds = {KINDS[key] for key in content if key in KINDS}
        if len(kinds) != 1:
            names, keys = ", ".join(KINDS), reprlib.repr(list(content))
            reason = f"must have top-level keys of exactly one kind of file ({names}), not {keys}"
            raise FileError((), reason, place=place)
    match kinds.pop():
        case "map":
            from ..maps.register_map import load_map

            return load_map(path)
        case "device":
            from ..tools.simulator.device_file import load as load_devices

            return load_devices(path)
        case "gateway":
            from .gateway.config import load as load_gateway

            return load_gateway(path)
        case _:
            from .fleet.files import load as load_fleet

            return load_fleet(path)
