"""
Loads files of any kind: register maps, devices, gateways and fleets.
"""

from __future__ import annotations

import reprlib
from importlib import import_module
from os import PathLike, fspath
from pathlib import PurePath
from typing import TYPE_CHECKING

from ..files.texts import FileError, FilePlace, read_text, read_toml

if TYPE_CHECKING:
    from ..maps.register_map import RegisterMap
    from ..tools.simulator.simulated import Simulation
    from .fleet.files import FleetFile
    from .gateway.config import GatewayFile

__all__ = ["load"]

LOADERS: dict[str, tuple[str, str]] = {
    "point": ("maps.register_map", "load_map"),
    "unit": ("tools.simulator.device_file", "load"),
    "route": ("services.gateway.config", "load"),
    "listen": ("services.gateway.config", "load"),
    "device": ("services.fleet.files", "load"),
    "devices": ("services.fleet.files", "load"),
}
"""Key at the top level of a TOML file -> module and function that load such a file."""


def load(path: str | PathLike[str]) -> RegisterMap | Simulation | GatewayFile | FleetFile:
    """
    Load a register map, or a device, gateway or fleet file. The contents decide which it is.

    Args:
        path: the path of the file. A register map in CSV has a name that ends with ``.csv``,
            ``.tsv`` or ``.txt``; other files are TOML.

    Returns:
        What the file describes: a `RegisterMap`; a `Simulation`, whose `devices` a
        `Server` serves; a `GatewayFile` or a `FleetFile`.

    Raises:
        FileError: a ValueError: the file cannot be read, is not of one of these kinds, or contains
            a mistake. The message names the file and, where it can, the line and the key.
    """
    place = FilePlace(fspath(path))
    kinds = {LOADERS["point"]}
    if PurePath(path).suffix.lower() not in (".csv", ".tsv", ".txt"):
        text = read_text(path, FileError)
        try:
            content = read_toml(text)
        except ValueError as error:
            raise FileError.of(error, place) from None
        kinds = {LOADERS[key] for key in content if key in LOADERS}
        if len(kinds) != 1:
            known, found = ", ".join(LOADERS), reprlib.repr(list(content))
            reason = f"must have top-level keys of exactly one kind of file ({known}), not {found}"
            raise FileError((), reason, place=place)
    module, function = kinds.pop()
    imported = import_module(f"...{module}", __name__)
    return getattr(imported, function)(path)  # type: ignore[no-any-return]
