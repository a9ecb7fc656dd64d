"""
Checks of the keys of a point from which its `Meaning` is made.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable, Mapping
from typing import Any

from ..protocol.checks import integer, number, shown
from ..protocol.mistakes import Path, WrongType, WrongValue, placed
from ..protocol.values import ValueType
from .meaning import Meaning, sunspec_missing
from .parts import BYTES, Part, part_of, parts_of, span_text

__all__ = ["SCALES", "checked_meaning", "has_numbers", "tidied"]

# A `Point` whose keys are not all checked yet, which imports this module.
Point = Any

SCALES = ("exponent", "factor")

MAX_NAME = 100
MAX_STATES = 1000
MAX_MISSING = 100

# Keys that need numbers, and the value that each has if it is not given.
_OF_NUMBERS = {
    "scale": 1,
    "offset": 0,
    "scale_from": None,
    "minimum": None,
    "maximum": None,
    "plausible_minimum": None,
    "plausible_maximum": None,
    "never_falls": False,
}

# Keys that need whole numbers or bits in registers.
_OF_BITS = ("bits", "bit", "byte")


def tidied(point: Point) -> dict[str, Any]:
    """
    Return the keys that can be written in several ways, as a point has them.

    Raises:
        TypeError, ValueError: a value of the wrong type.
    """
    missing = point.missing
    if missing is not None and not isinstance(missing, str):
        given = missing if isinstance(missing, Iterable) else (missing,)
        missing = tuple(given)
        if not 1 <= len(missing) <= MAX_MISSING:
            raise WrongValue("missing", f"must hold 1..{MAX_MISSING} numbers, not {len(missing)}")
    width = 64 if point.read.kind is None else 16 * point.read.kind.registers

    def span(where: str | Path, key: object) -> int | str:
        return span_text(part_of(where, key, width))

    return {
        "missing": missing,
        "bit": None if point.bit is None else span("bit", point.bit),
        "states": _named("states", point.states, _whole),
        "bits": _named("bits", point.bits, span),
    }


def _named(name: str, given: object, key_of: Any) -> dict[Any, str] | None:
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise WrongType(name, f"must be a table of names, not {type(given).__name__}")
    if not 1 <= len(given) <= MAX_STATES:
        raise WrongValue(name, f"must hold 1..{MAX_STATES} names, not {len(given)}")
    found: dict[Any, str] = {}
    for key, text in given.items():
        where = (name, str(key))
        _check_name(where, text)
        made = key_of(where, key)
        if made in found:
            raise WrongValue(where, "is given twice")
        if text in found.values() and name == "states":
            raise WrongValue(where, f"must have a name of its own; {text!r} occurs twice")
        found[made] = text
    return found


def _check_name(where: Path, text: object) -> None:
    if not isinstance(text, str):
        raise WrongType(where, f"must be a name, not {type(text).__name__}")
    if not 1 <= len(text) <= MAX_NAME or not text.isprintable() or text != text.strip():
        wanted = f"1..{MAX_NAME} printable characters, without spaces around"
        raise WrongValue(where, f"must have {wanted}: {reprlib.repr(text)}")


def _whole(where: Path, key: object) -> int:
    """Return the number of a state; keys of files are text."""
    if isinstance(key, str):
        try:
            return int(key[:40], 0)
        except ValueError:
            raise WrongValue.about(where, "the key must be a number") from None
    return integer(where, key, -(1 << 63), (1 << 64) - 1)


def has_numbers(point: Point) -> bool:
    """Return True if the values of a point are numbers."""
    kind = point.read.kind
    if kind is None or point.states is not None or point.bits is not None:
        return False
    if point.bit is not None or point.byte is not None:
        part = _part(point, kind)
        return part is not None and not part.is_flag
    return kind.limits is not None


def checked_meaning(point: Point) -> Meaning | None:
    """
    Return the meaning of a point; None if it has none of the keys.

    Raises:
        TypeError, ValueError: a key has a wrong value, or contradicts another.
    """
    kind = point.read.kind
    part = _part(point, kind)
    _check_numbers(point)
    bits = _bits(point, kind)
    span = _plausible(point)
    missing = _missing(point, kind, part)
    states = _states(point, kind, part)
    if not (part or bits or span or missing or states):
        return None
    return Meaning(
        point.name, kind, missing=missing, span=span, part=part, states=states, bits=bits
    )


def _part(point: Point, kind: ValueType | None) -> Part | None:
    given = [name for name in _OF_BITS if getattr(point, name) is not None]
    if not given:
        return None
    if len(given) > 1:
        raise WrongValue(given[1], f"cannot be given together with {given[0]}")
    name = given[0]
    if kind is None or not _has_bits(kind):
        raise WrongValue(name, f"must be left out for {point.type_name}, which has no single bits")
    width = 16 * kind.registers
    if name == "bit":
        return part_of("bit", point.bit, width, is_signed=_is_signed(kind))
    if name == "bits":
        return None
    if point.byte not in BYTES:
        raise WrongValue("byte", f"must be one of {', '.join(BYTES)}, not {point.byte!r}")
    if kind.registers != 1:
        raise WrongValue("byte", f"must be left out for {kind.name}, which has {width} bits")
    return part_of("byte", BYTES[point.byte], width, is_signed=_is_signed(kind))


def _has_bits(kind: ValueType) -> bool:
    return kind.name.startswith(("int", "uint", "bits"))


def _is_signed(kind: ValueType) -> bool:
    return kind.name.startswith("int")


def _check_numbers(point: Point) -> None:
    if point.scale_as not in SCALES:
        raise WrongValue("scale_as", f"must be one of {', '.join(SCALES)}, not {point.scale_as!r}")
    if point.scale_from is None and point.scale_as != "exponent":
        raise WrongValue("scale_as", "must be left out without scale_from")
    if not isinstance(point.never_falls, bool):
        raise WrongType("never_falls", f"must be true or false, not {point.never_falls!r}")
    if point.scale_from is not None:
        if not isinstance(point.scale_from, str):
            raise WrongType("scale_from", f"must be a name, not {type(point.scale_from).__name__}")
        if point.scale_from == point.name:
            raise WrongValue("scale_from", "must be another point, not the point itself")
    if point.never_falls and point.count > 1:
        raise WrongValue("never_falls", "must be left out where count is more than 1")
    if has_numbers(point):
        return
    for name, usual in _OF_NUMBERS.items():
        if getattr(point, name) != usual:
            wanted = "be left out" if usual is None or usual is False else f"be {usual}"
            raise WrongValue(name, f"must {wanted} for {_told(point)}, which has no numbers")


def _told(point: Point) -> str:
    given = [name for name in ("states", "bits", "bit") if getattr(point, name) is not None]
    return f"a point with {given[0]}" if given else point.type_name


def _bits(point: Point, kind: ValueType | None) -> dict[str, Part]:
    if point.bits is None:
        return {}
    if point.states is not None:
        raise WrongValue("states", "cannot be given together with bits")
    assert kind is not None
    return parts_of("bits", point.bits, 16 * kind.registers)


def _plausible(point: Point) -> tuple[float, float] | None:
    low, high = point.plausible_minimum, point.plausible_maximum
    for name, bound in (("plausible_minimum", low), ("plausible_maximum", high)):
        if bound is not None:
            number(name, bound, -1e300, 1e300)
    if low is not None and high is not None and low > high:
        told = f"must not be above plausible_maximum, {shown(high)}: {shown(low)}"
        raise WrongValue("plausible_minimum", told)
    if low is None and high is None:
        return None
    return -math.inf if low is None else low, math.inf if high is None else high


def _states(point: Point, kind: ValueType | None, part: Part | None) -> dict[int, str]:
    if point.states is None:
        return {}
    if kind is None or (part is not None and part.is_flag):
        limits: tuple[float, float] | None = (0, 1)
    else:
        limits = part.limits if part is not None else kind.limits
    if limits is None or isinstance(limits[0], float):
        raise WrongValue("states", f"must be left out for {point.type_name}: no whole numbers")
    low, high = int(limits[0]), int(limits[1])
    for key in point.states:
        integer(("states", str(key)), key, low, high)
    return dict(point.states)


# --- missing ------------------------------------------------------------------------------


def _missing(point: Point, kind: ValueType | None, part: Part | None) -> frozenset[Any]:
    if point.missing is None:
        return frozenset()
    if kind is None:
        raise WrongValue("missing", f"must be left out for {point.type_name}")
    if isinstance(point.missing, str):
        if point.missing != "sunspec":
            told = reprlib.repr(point.missing)
            raise WrongValue("missing", f'must be numbers or "sunspec", not {told}')
        if part is not None:
            raise WrongValue("missing", "must be numbers for a part of a register")
        bits = sunspec_missing(kind)
        return frozenset() if bits is None else frozenset(_raws_of_bits(point, kind, bits))
    found: set[Any] = set()
    for at, given in enumerate(point.missing):
        found.update(_raws(("missing", at), point, kind, part, given))
    return frozenset(found)


def _raws(
    where: Path, point: Point, kind: ValueType, part: Part | None, given: object
) -> Iterable[Any]:
    if part is not None:
        return [integer(where, given, *part.limits)]
    if kind.is_text:
        raise WrongValue(where, 'must be "sunspec" for strings')
    if kind.limits is None or point.bits is not None:
        return _raws_of_bits(point, kind, integer(where, given, 0, (1 << 16 * kind.registers) - 1))
    if _is_signed(kind):
        low, high = -1 << 16 * kind.registers - 1, (1 << 16 * kind.registers) - 1
        value = integer(where, given, low, high)
        # Manuals name the bits of a negative number, such as 0x8000.
        return [value if value <= kind.limits[1] else value - high - 1]
    try:
        return [kind.decode(kind.encode(given))]
    except (TypeError, ValueError) as error:
        raise placed(error, ()).renamed(where) from None


def _raws_of_bits(point: Point, kind: ValueType, bits: int) -> list[Any]:
    if kind.name.startswith("bits") or point.bits is not None:
        return [bits]
    try:
        return [kind.decode(kind.cells_of_number(bits))]
    except ValueError:
        return []  # registers that hold no time have no value anyway
