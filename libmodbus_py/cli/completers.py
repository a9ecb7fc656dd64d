"""
Completions besides commands and options: words, names of examples and maps.

The functions are those of argcomplete: called with the text so far and the arguments typed
before it. Options behind it are looked up in the whole line.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from ..ports.schemes import PARITIES

# fmt: off
__all__ = [
    "PARITY_WORDS", "behind", "completing", "encodings", "examples", "lists_of_parities", "maps",
    "names_of_maps", "sub_functions",
]
# fmt: on

Action = TypeVar("Action", bound=argparse.Action)

PARITY_WORDS = [word for word in PARITIES if len(word) > 1]


def completing(action: Action, completer: Iterable[str] | Callable[..., Iterable[str]]) -> Action:
    """Set the words that complete an argument, or a function of them; return the argument."""
    found = completer if callable(completer) else lambda **_: completer
    action.completer = found  # type: ignore[attr-defined]
    return action


def lists_of_parities(prefix: str, **_: Any) -> list[str]:
    """Return the words that continue a list of parities that was begun."""
    before, comma, _last = prefix.rpartition(",")
    return [f"{before}{comma}{each}" for each in PARITY_WORDS if each not in before.split(",")]


def encodings(**_: Any) -> list[str]:
    """Return the encodings of text."""
    from ..protocol.values import ENCODINGS

    return sorted(each.replace("_", "-") for each in ENCODINGS)


def sub_functions(**_: Any) -> list[str]:
    """Return the sub-functions of function 8."""
    from ..protocol.pdu import SubFunction

    return [each.name.lower().replace("_", "-") for each in SubFunction]


def examples(**_: Any) -> list[str]:
    """Return the device files that come with the package."""
    from ..tools.simulator.example_files import DEVICES

    return [*DEVICES]


def names_of_maps(**_: Any) -> list[str]:
    """Return the names of the register maps that come with the package."""
    from ..tools.simulator import example_files

    return [*example_files.maps()]


def maps(prefix: str, **_: Any) -> list[str]:
    """Return the register maps that come with the package, and files."""
    from argcomplete.completers import FilesCompleter

    return [*names_of_maps(), *FilesCompleter((".csv", ".toml"))(prefix)]


def behind(option: str) -> str:
    """Return the value of an option in the line that is completed; empty if it is not there."""
    import shlex  # which a command does not need

    words: list[str] = []
    for quote in ("", "'", '"'):  # one may be open still
        with contextlib.suppress(ValueError):
            words = words or shlex.split(f"{os.environ.get('COMP_LINE', '')}{quote}")
    for at, word in enumerate(words):
        if word.startswith(f"{option}="):
            return word.removeprefix(f"{option}=")
        if word == option:
            return next(iter(words[at + 1 :]), "")
    return ""
