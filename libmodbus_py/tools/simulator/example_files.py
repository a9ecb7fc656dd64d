"""
The device files that come with the package, and their register maps, by name: in ``examples`` of
a checkout, and beside this module where the package was built.
"""

from __future__ import annotations

import os

__all__ = ["DEVICES", "described", "map_file", "maps", "path_of"]

# CSV files in the folder that are not register maps.
LISTS = ("fleet",)

# The other TOML files in the folder describe gateways and fleets.
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


def map_file(word: str) -> str:
    """
    Return the path of a register map; a word without folder and suffix names an example.

    Raises:
        ValueError: there is no example of that name.
    """
    if os.path.basename(word) != word or os.path.splitext(word)[1]:
        return word
    known = maps()
    if word not in known:
        raise ValueError(
            f"{word!r} is neither the path of a register map, which ends with .csv or .toml, "
            f"nor an example; the examples are {', '.join(known)}"
        )
    return os.path.join(_folder(), f"{word}.csv")


def maps() -> dict[str, str]:
    """Return the name of each register map with the description in its first line."""
    folder = _folder()
    names = sorted(
        each.removesuffix(".csv") for each in os.listdir(folder) if each.endswith(".csv")
    )
    found = {name: _first_comment(os.path.join(folder, f"{name}.csv")) for name in names}
    return {name: text for name, text in found.items() if name not in LISTS}


def _folder() -> str:
    # The files are never in a zip, because the compiled modules of the package cannot be either.
    here = os.path.dirname(__file__)
    built = os.path.join(here, "examples")
    return built if os.path.isdir(built) else os.path.join(here, *[".."] * 3, "examples")


def _first_comment(path: str) -> str:
    """Return the first sentence of the comment with which a file begins; "" without one."""
    with open(path, encoding="utf-8") as file:
        line = file.readline()
    return line.strip("# \n").partition(". ")[0].rstrip(".") if line.startswith("#") else ""


def _first_line(path: str) -> str:
    with open(path, encoding="utf-8") as file:
        return file.readline().strip("# \n")
