"""
The device files that come with the package, and their register maps, by name: in ``examples`` of
a checkout, and beside this module where the package was built.
"""

from __future__ import annotations

import os

__all__ = ["DEVICES", "described", "map_of", "path_of"]

# The other files in the folder describe gateways and fleets.
DEVICES = ("iem3155", "meter", "plant", "sdm630", "victron_gx")


def described() -> dict[str, str]:
    """Return the name of each example with the description in its first line."""
    folder = _folder()
    return {name: _first_line(os.path.join(folder, f"{name}.toml")) for name in DEVICES}


def path_of(name: str) -> str:
    """
    Return the path of the device file of an example.

    Raises:
        ValueError: there is no example of that name.
    """
    if name not in (known := described()):
        raise ValueError(f"there is no example {name!r}; there are {', '.join(known)}")
    return os.path.join(_folder(), f"{name}.toml")


def map_of(name: str) -> str:
    """
    Return the path of the register map of an example.

    Raises:
        ValueError: there is no example of that name.
    """
    folder = _folder()
    known = [each for each in DEVICES if os.path.exists(os.path.join(folder, f"{each}.csv"))]
    if name not in known:
        raise ValueError(
            f"{name!r} is no file of a register map, which ends with .csv or .toml, "
            f"and no example, which are {', '.join(known)}"
        )
    return os.path.join(folder, f"{name}.csv")


def _folder() -> str:
    # The files are never in a zip, because the compiled modules of the package cannot be either.
    here = os.path.dirname(__file__)
    built = os.path.join(here, "examples")
    return built if os.path.isdir(built) else os.path.join(here, *[".."] * 3, "examples")


def _first_line(path: str) -> str:
    with open(path, encoding="utf-8") as file:
        return file.readline().strip("# \n")
