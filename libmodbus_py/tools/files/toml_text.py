"""
TOML that costs what its size lets expect: the bounds that tomllib leaves to its caller.
"""

from __future__ import annotations

import re
import reprlib
import tomllib
from typing import Any

from ...protocol.checks import shown
from .toml_lines import below

__all__ = ["MAX_SIZE", "read_toml"]

# A table of 65536 registers, each written out, is smaller.
MAX_SIZE = 1 << 19

# unit[0].holding_registers[0].values[0][0] is the deepest that means anything: 7.
MAX_DEPTH = 10

# Each takes tomllib a kilobyte for each of its levels.
MAX_TABLES = 10_000

# Text fills at most 125 registers.
MAX_TEXT = 250

# TOML has integers of 64 bits (1.0.0, "Integer"); uint64 is one of our types.
LOWEST, HIGHEST = -(1 << 63), (1 << 64) - 1

# tomllib takes the square of their depth. Possessive, and none begins within another: so
# this looks at each character a few times at most.
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")

_HEADER = re.compile(r"^[ \t]*\[", re.MULTILINE)

# More digits Python does not read.
_LONG_NUMBER = re.compile(r"[0-9][0-9_]{4300}")


def read_toml(text: str, max_text: int = MAX_TEXT) -> dict[str, Any]:
    """
    Read a TOML document of at most 512 KiB, with at most 10000 headers, ten levels, texts of
    `max_text` characters and integers of 64 bits.

    Raises:
        ValueError: it is no TOML, or more than that; with the path of a value that is.
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
            raise ValueError(f"more digits than a number has (at {_line(text, found)})") from None
        raise
    _check(content, max_text)
    return content


def _line(text: str, found: re.Match[str]) -> str:
    return f"line {text.count(chr(10), 0, found.start()) + 1}"


def _check(content: dict[str, Any], max_text: int) -> None:
    to_check: list[tuple[str, int, Any]] = [("", 1, content)]
    while to_check:
        path, depth, holder = to_check.pop()
        if depth > MAX_DEPTH:
            raise ValueError(f"{path} lies deeper than {MAX_DEPTH} levels")
        for key, value in holder.items() if isinstance(holder, dict) else enumerate(holder):
            if isinstance(value, dict | list):
                to_check.append((below(path, key), depth + 1, value))
            elif isinstance(value, str) and len(value) > max_text:
                wanted = f"0..{max_text} characters"
                raise ValueError(f"{below(path, key)} must have {wanted}, not {len(value)}")
            elif isinstance(value, int) and not LOWEST <= value <= HIGHEST:
                wanted = f"{LOWEST}..{HIGHEST}"
                raise ValueError(f"{below(path, key)} must be in {wanted}, not {shown(value)}")
