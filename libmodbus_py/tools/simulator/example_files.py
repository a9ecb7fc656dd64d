"""
The device files that come with the package, and their register maps, by name: in ``examples`` of
a checkout, and beside this module where the package was built.
"""

from __future__ import annotations

import os

# CSV files in the folder that are not register maps.
LISTS = ("fleet",)

# The other TOML files in the folder describe gateways and fleets.
DEVICES = ("iem3155", "meter", "plant", "sdm630", "victron_gx")


def descriptions() -> dict[str, str]:
    """Return the name of each example with the description in its first line."""
    return {name: _first_line(f"{name}.toml") for name in DEVICES}


def path_of(name: str) -> str:
    """Return the path of the device file of an example; raise ValueError if there is none."""
    if name not in DEVICES:
        raise ValueError(f"there is no example {name!r}; there are {', '.join(DEVICES)}")
    return os.path.join(_folder(), f"{name}.toml")


def map_file(word: str) -> str:
    """Return the path of a register map; a word without folder and suffix is a name."""
    if os.path.basename(word) != word or os.path.splitext(word)[1]:
        return word
    files = maps()
    if word not in files:
        raise ValueError(
            f"{word!r} is neither the path of a register map, which ends with .csv or .toml, "
            f"nor an example; the examples are {', '.join(files)}"
        )
    return os.path.join(_folder(), f"{word}.csv")


def maps() -> dict[str, str]:
    """Return the name of each register map with the first sentence of its first comment."""
    stems = sorted(os.path.splitext(name) for name in os.listdir(_folder()))
    lines = {
        stem: _first_line(stem + suffix)
        for stem, suffix in stems
        if suffix == ".csv" and stem not in LISTS
    }
    return {stem: line.partition(". ")[0].rstrip(".") for stem, line in lines.items()}


def _folder() -> str:
    # The files are never in a zip, because the compiled modules of the package cannot be either.
    here = os.path.dirname(__file__)
    folder = os.path.join(here, "examples")
    return folder if os.path.isdir(folder) else os.path.join(here, *[".."] * 3, "examples")


def _first_line(name: str) -> str:
    """Return the comment with which a file begins; "" without one."""
    with open(os.path.join(_folder(), name), encoding="utf-8") as file:
        line = file.readline()
    return line.strip("# \n") if line.startswith("#") else ""
