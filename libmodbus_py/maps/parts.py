"""
Parts of registers: single bits, some bits as a number, one byte; and bits with names.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping
from typing import NamedTuple

from ..protocol.checks import integer, shown
from ..protocol.mistakes import Path, WrongType, WrongValue

__all__ = ["BYTES", "Part", "part_of", "parts_of", "put_named", "span_text"]

_SPAN = re.compile(r"\s*([0-9]{1,3})\s*(?:\.\.\s*([0-9]{1,3})\s*)?", re.ASCII)

BYTES = {"high": "8..15", "low": "0..7"}
"""Byte of a register -> its bits."""


class Part(NamedTuple):
    """
    Some adjacent bits of a value.

    Attributes:
        shift: the number of the lowest bit; 0 is the lowest of the value.
        width: how many bits.
        is_flag: True if the value is True or False, not a number.
        is_signed: True if the highest bit of the part is a sign.
    """

    shift: int
    width: int
    is_flag: bool = False
    is_signed: bool = False

    @property
    def mask(self) -> int:
        """The bits of the part, as a number of all bits."""
        return (1 << self.width) - 1 << self.shift

    @property
    def limits(self) -> tuple[int, int]:
        """The lowest and the highest number."""
        if self.is_signed:
            return -1 << self.width - 1, (1 << self.width - 1) - 1
        return 0, (1 << self.width) - 1

    def of(self, number: int) -> int:
        """Return the part of a number; True or False for a flag."""
        found = (number & self.mask) >> self.shift
        if self.is_flag:
            return bool(found)
        return found - (1 << self.width) if self.is_signed and found >> self.width - 1 else found

    def put(self, name: str | Path, value: object) -> int:
        """
        Return a value in its place, with all other bits 0.

        Raises:
            TypeError, ValueError: the part cannot hold the value.
        """
        if self.is_flag and isinstance(value, bool):
            value = int(value)
        held = integer(name, value, *self.limits)
        return held << self.shift & self.mask


def part_of(path: str | Path, given: object, bits: int, *, is_signed: bool = False) -> Part:
    """
    Return the part that a number such as 3, or a text such as "4..7", names.

    Args:
        bits: of the type.

    Raises:
        TypeError, ValueError: it names no bits, or bits that the type does not have.
    """
    if isinstance(given, int) and not isinstance(given, bool):
        return Part(integer(path, given, 0, bits - 1), 1, is_flag=True)
    if not isinstance(given, str):
        raise WrongType(path, f"must be a bit such as 3, or bits such as '4..7', not {given!r}")
    found = _SPAN.fullmatch(given)
    if found is None:
        wanted = "a bit such as 3, or bits such as '4..7'"
        raise WrongValue(path, f"must be {wanted}, not {reprlib.repr(given)}")
    if found[2] is None:
        return part_of(path, int(found[1]), bits)
    first, last = int(found[1]), int(found[2])
    if not first <= last < bits:
        wanted = f"within 0..{bits - 1}, the lower number first"
        raise WrongValue(path, f"must be {wanted}, not {reprlib.repr(given)}")
    return Part(first, last - first + 1, is_signed=is_signed)


def parts_of(path: str, given: Mapping[int | str, str], bits: int) -> dict[str, Part]:
    """
    Return the part of each name.

    Raises:
        TypeError, ValueError: a name occurs twice; bits overlap, or lie outside the type.
    """
    found: dict[str, Part] = {}
    taken = 0
    for key, name in given.items():
        where = (path, str(key))
        part = part_of(where, key, bits)
        if part.mask & taken:
            raise WrongValue(where, "overlaps bits before it")
        if name in found:
            raise WrongValue(where, f"must have a name of its own; {name!r} occurs twice")
        taken |= part.mask
        found[name] = part
    return found


def span_text(part: Part) -> int | str:
    """Return a part as `part_of` takes it."""
    return part.shift if part.is_flag else f"{part.shift}..{part.shift + part.width - 1}"


def put_named(parts: Mapping[str, Part], value: object) -> tuple[int, int]:
    """
    Return the bits of a mapping of names to values, and the mask of those bits.

    Raises:
        TypeError, ValueError: no mapping, an unknown name, or a value that its part cannot hold.
    """
    if not isinstance(value, Mapping):
        raise WrongType("value", f"must be a dict of named bits, not {type(value).__name__}")
    bits = mask = 0
    for name, each in value.items():
        if name not in parts:
            allowed = ", ".join(parts)
            raise WrongValue("value", f"must have names of {allowed}, not {shown(name)}")
        bits |= parts[name].put(("value", name), each)
        mask |= parts[name].mask
    return bits, mask
