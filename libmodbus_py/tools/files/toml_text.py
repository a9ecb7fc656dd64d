"""
TOML with bounded cost: the limits that tomllib leaves to its caller.
"""

from __future__ import annotations

import re
import reprlib
import tomllib
from typing import Any

from ...protocol.checks import shown
from ...protocol.mistakes import Path, WrongValue
from .toml_lines import shown_key

__all__ = ["MAX_SIZE", "read_toml"]

# A table of 65536 registers, each written out, is smaller.
MAX_SIZE = 1 << 19

# unit[0].holding_registers[0].values[0][0] is the deepest that means anything: 7.
MAX_DEPTH = 10

# tomllib needs a kilobyte for each level of each header.
MAX_TABLES = 10_000

# The description of a point may be as long; other texts have bounds of their own.
MAX_TEXT = 2000

# TOML has integers of 64 bits (1.0.0, "Integer"); uint64 is one of our types.
LOWEST, HIGHEST = -(1 << 63), (1 << 64) - 1

# The time of tomllib grows with the square of their depth. Possessive, and none begins within
# another: so this looks at each character a few times at most.
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")

_HEADER = re.compile(r"^[ \t]*\[", re.MULTILINE)

# Python refuses to read more digits.
_LONG_NUMBER = re.compile(r"[0-9][0-9_]{4300}")


def read_toml(text: str) -> dict[str, Any]:
    """
    Read a TOML document of at most 512 KiB, with at most 10000 headers, ten levels, texts of
    2000 characters and integers of 64 bits.

    Raises:
        ValueError: the text is not TOML, or has more than that; a value that is too long or too
            large is named by its path.
    """
    if len(text) > MAX_SIZE:
        raise ValueError(f"more than {MAX_SIZE} characters")
    if sum(1 for _ in _HEADER.finditer(text)) > MAX_TABLES:
        raise ValueError(f"more than {MAX_TABLES} headers of tables")
    if found := _DEEP_KEY.search(text):
        key = reprlib.repr(found[0])
        raise ValueError(f"more than {MAX_DEPTH} levels: {key} (at {_line(text, found)})")
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"more than {MAX_DEPTH} levels") from None
    except ValueError:
        if found := _LONG_NUMBER.search(text):
            raise ValueError(f"a number has too many digits (at {_line(text, found)})") from None
        raise
    _check(content)
    return content


def _line(text: str, found: re.Match[str]) -> str:
    return f"line {text.count(chr(10), 0, found.start()) + 1}"


def _check(content: dict[str, Any]) -> None:
    to_check: list[tuple[Path, Any]] = [((), content)]
    while to_check:
        path, holder = to_check.pop()
        if len(path) >= MAX_DEPTH:
            raise WrongValue(path, f"lies deeper than {MAX_DEPTH} levels")
        for key, value in holder.items() if isinstance(holder, dict) else enumerate(holder):
            place = (*path, key if isinstance(key, int) else shown_key(key))
            if isinstance(value, dict | list):
                to_check.append((place, value))
            elif isinstance(value, str) and len(value) > MAX_TEXT:
                raise WrongValue(place, f"must have 0..{MAX_TEXT} characters, not {len(value)}")
            elif isinstance(value, int) and not LOWEST <= value <= HIGHEST:
                raise WrongValue(place, f"must be in {LOWEST}..{HIGHEST}, not {shown(value)}")
