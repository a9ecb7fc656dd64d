"""Checks of the arguments of a point, from which its attributes are made."""

from __future__ import annotations

import contextlib
import math
import reprlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ..protocol.checks import choice, instance, integer, seconds, shown, string
from ..protocol.mistakes import Path, WrongType, WrongValue, placed
from ..protocol.pdu.request import store
from ..protocol.plain import shortest
from ..protocol.tables import TABLES, checked_table
from ..protocol.values import ValueType
from .items import Read
from .meaning import Meaning, Part, part_of
from .scaling import NumberSpan, Scaling, States, check_spans, number, state_key

# A `Point` whose arguments are not all checked yet; its module imports this one.
Point = Any

ACCESSES = ("read", "write", "read_write")
SCALES = ("exponent", "factor")

BYTES = {"high": "8..15", "low": "0..7"}
"""Byte of a register -> its bits."""

HAVE_NO_VALUE = ("bcd", "sbcd", "mod10k", "umod10k")
"""Types of numbers for which some data is no value, such as 0xFFFF."""

BYTE_TYPES = ("int8", "uint8")
"""Types that are the low byte of a register, if nothing else is said."""

TEXTS = {"name": (1, 100), "units": (0, 100), "group": (0, 100), "description": (0, 2000)}
"""Argument -> the fewest and the most characters."""

NEED_NUMBERS: dict[str, Any] = {
    "scale": 1,
    "offset": 0,
    **dict.fromkeys(("scale_from", "minimum", "maximum"), None),
    **dict.fromkeys(("plausible_minimum", "plausible_maximum"), None),
    "never_falls": False,
}
"""Argument that needs numbers -> its value if it is not given."""

NEED_BITS = ("bits", "bit", "byte")
"""Arguments that need whole numbers or bits in registers."""

SUNSPEC_MISSING: dict[str, int | None] = {
    "int16": 0x8000,
    "int32": 0x8000_0000,
    "int64": 0x8000_0000_0000_0000,
    **dict.fromkeys(("uint16", "bits16"), 0xFFFF),
    **dict.fromkeys(("uint32", "bits32"), 0xFFFF_FFFF),
    **dict.fromkeys(("uint64", "bits64"), 0xFFFF_FFFF_FFFF_FFFF),
    **dict.fromkeys(("float32", "float64"), None),
    "eui48": 0xFFFF_FFFF_FFFF,
}
"""Type -> the bits of "not implemented" in SunSpec; None for floats: a nan is no value anyway."""


def check_point(point: Point) -> None:
    """Check the arguments of a point; store each in one spelling, and what is made of them."""
    for name, (least, most) in TEXTS.items():
        _check_text(name, getattr(point, name), least, most)
    for name in ("encoding", "padding"):
        string(name, getattr(point, name))
    table = checked_table(point.table)
    is_bits = TABLES[table].is_bits
    type_: Any = "uint16" if point.type is None and not is_bits else point.type
    layout = point.order, point.encoding, point.padding
    read = Read(table, point.address, point.count, type_, *layout)
    order = "ABCD" if read.kind is None else read.kind.order
    place = {"table": table, "address": read.address, "count": read.count}
    store(point, read=read, type=read.type, order=order, **place)
    if point.time_zone != "UTC":
        store(read, kind=_local(read.kind, point))
    for name in ("interval", "rewrite"):
        if getattr(point, name) is not None:
            checked_interval(name, getattr(point, name))
    if point.write_function is not None:
        choice("write_function", point.write_function, ("single", "multiple"))
    for name in ("border", "never_falls"):
        if not isinstance(getattr(point, name), bool):
            raise WrongType(name, f"must be true or false, not {getattr(point, name)!r}")
    store(point, access=_access(point), meaning=_meaning(point, read.kind))
    if point.rewrite is not None and point.access == "read":
        raise WrongValue("rewrite", "must be left out where access is read")
    for name in ("scale", "offset"):
        number(name, getattr(point, name))
    is_scaled = (point.scale, point.offset) != (1, 0)
    store(point, _scaling=Scaling(point.scale, point.offset) if is_scaled else None)
    _check_bounds(point, "minimum", "maximum")
    if point.initial is not None and point.scale_from is None:
        try:
            point.cells_for([point.initial] if point.count == 1 else point.initial)
        except (TypeError, ValueError) as error:
            raise placed(error, ()).renamed(("initial",)) from None


def checked_interval(name: str, value: object) -> float:
    """Return the seconds from poll to poll: 0.01 or more, up to a day."""
    return seconds(name, value, 0.01)


def _check_text(name: str | Path, value: Any, least: int, most: int) -> None:
    if not least <= len(string(name, value)) <= most:
        raise WrongValue(name, f"must have {least}..{most} characters, not {len(value)}")
    spaces = "\n\t" if name == "description" else ""
    is_printable = all(letter.isprintable() or letter in spaces for letter in value)
    if not is_printable or (name != "description" and value != value.strip()):
        form = "printable characters, without spaces around"
        raise WrongValue(name, f"must be {form}: {reprlib.repr(value)}")


def _local(kind: ValueType | None, point: Point) -> ValueType:
    """Return the type of a point whose registers hold the local time of a zone."""
    from ..protocol.times import checked_time_zone, in_time_zone  # which few programs need

    zone = checked_time_zone("time_zone", point.time_zone)
    if kind is None or not kind.is_time:
        reason = f"must be left out for {point.type_name}, which is not a time"
        raise WrongValue("time_zone", reason)
    return in_time_zone(kind, zone)


def _access(point: Point) -> str:
    can_be_written = TABLES[point.table].most_written > 0
    if point.access is None:
        return "read_write" if can_be_written else "read"
    if choice("access", point.access, ACCESSES) != "read" and not can_be_written:
        raise WrongValue("access", f"must be 'read' for {point.table}, not {point.access!r}")
    return str(point.access)


def _check_bounds(point: Point, least: str, most: str) -> None:
    low, high = getattr(point, least), getattr(point, most)
    for name, bound in ((least, low), (most, high)):
        if bound is not None:
            number(name, bound)
    if low is not None and high is not None and low > high:
        raise WrongValue(least, f"must not be above {most}, {shown(high)}: {shown(low)}")


# --- the meaning --------------------------------------------------------------------------


def _meaning(point: Point, kind: ValueType | None) -> Meaning:
    """Return the meaning of the raw values; store the arguments that describe it."""
    missing = _listed(point.missing)
    part = _part(point, kind)
    states = _states(point, kind, part)
    bits = _bits(point, kind)
    if states and bits:
        raise WrongValue("states", "cannot be given together with bits")
    _check_bounds(point, "plausible_minimum", "plausible_maximum")
    low, high = point.plausible_minimum, point.plausible_maximum
    span = (-math.inf if low is None else low, math.inf if high is None else high)
    meaning = Meaning(
        point.name,
        kind,
        missing=_missing(point, missing, kind, part),
        span=None if low is None and high is None else span,
        part=part,
        states=States(states) if states else None,
        bits=bits,
    )
    _check_numbers(point, meaning)
    bit = None if point.bit is None or part is None else part.key
    names = {key.key if isinstance(key, NumberSpan) else key: states[key] for key in states}
    parts = {part.key: name for name, part in bits.items()}
    store(point, missing=missing, bit=bit, states=names or None, bits=parts or None)
    return meaning


def _part(point: Point, kind: ValueType | None) -> Part | None:
    """Return the bits that form the raw value; None for all."""
    names = [name for name in NEED_BITS if getattr(point, name) is not None]
    if not names:
        if kind is None or kind.name not in BYTE_TYPES:
            return None
        return part_of("byte", BYTES["low"], 16, is_signed=kind.name.startswith("int"))
    if len(names) > 1:
        raise WrongValue(names[1], f"cannot be given together with {names[0]}")
    name = names[0]
    if kind is None or not kind.name.startswith(("int", "uint", "bits")):
        raise WrongValue(name, f"must be left out for {point.type_name}, which has no single bits")
    width, is_signed = 16 * kind.registers, kind.name.startswith("int")
    if name == "bit":
        return part_of("bit", point.bit, width, is_signed=is_signed)
    if name == "bits":
        return None
    bits = BYTES[choice("byte", point.byte, BYTES)]
    if kind.registers != 1:
        raise WrongValue("byte", f"must be left out for {kind.name}, which has {width} bits")
    return part_of("byte", bits, width, is_signed=is_signed)


def _names(
    name: str, names: Any, key_of: Callable[[Path, Any], Any], *, are_unique: bool = True
) -> dict[Any, str]:
    """Return the names that an argument gives to numbers or bits; the keys of files are text."""
    if names is None:
        return {}
    if not instance(name, names, Mapping, "a table of names"):
        raise WrongValue(name, "must not be empty")
    result: dict[Any, str] = {}
    for key, text in names.items():
        path = (name, str(key))
        _check_text(path, text, *TEXTS["name"])
        name_key = key_of(path, key)
        if name_key in result:
            raise WrongValue(path, "is given twice")
        if are_unique and text in result.values():
            raise WrongValue(path, f"must have a name of its own; {text!r} occurs twice")
        result[name_key] = text
    return result


def _states(point: Point, kind: ValueType | None, part: Part | None) -> dict[Any, str]:
    """Return names by number, by `NumberSpan`, and by `ELSE`."""
    if point.states is None:
        return {}
    limits = (0, 1) if kind is None else kind.limits if part is None else part.limits
    if limits is None:
        raise WrongValue("states", f"must be left out for {point.type_name}, which has no numbers")
    floats = kind if part is None and isinstance(limits[0], float) else None

    def key_of(path: Path, key: object) -> object:
        return state_key(path, key, limits, floats)

    names = _names("states", point.states, key_of, are_unique=False)
    check_spans(names)
    return names


def _bits(point: Point, kind: ValueType | None) -> dict[str, Part]:
    width = 0 if kind is None else 16 * kind.registers
    parts: dict[str, Part] = {}
    used_mask = 0
    names = _names("bits", point.bits, lambda path, key: part_of(path, key, width))
    for part, name in names.items():
        if part.mask & used_mask:
            raise WrongValue(("bits", str(part.key)), "overlaps bits before it")
        used_mask |= part.mask
        parts[name] = part
    return parts


def _check_numbers(point: Point, meaning: Meaning) -> None:
    if choice("scale_as", point.scale_as, SCALES) != "exponent" and point.scale_from is None:
        raise WrongValue("scale_as", "must be left out without scale_from")
    source = point.scale_from
    if source is not None and instance("scale_from", source, str, "a name") == point.name:
        raise WrongValue("scale_from", "must be another point, not the point itself")
    if point.never_falls and point.count > 1:
        raise WrongValue("never_falls", "must be left out where count is more than 1")
    if meaning.has_numbers:
        return
    names = [name for name in ("states", "bits", "bit") if getattr(point, name) is not None]
    about = f"a point with {names[0]}" if names else point.type_name
    for name, usual in NEED_NUMBERS.items():
        if getattr(point, name) != usual:
            form = "be left out" if usual is None or usual is False else f"be {usual}"
            raise WrongValue(name, f"must {form} for {about}, which has no numbers")


# --- missing ------------------------------------------------------------------------------


def _listed(missing: Any) -> Any:
    """Return the argument `missing`: a text, a tuple of numbers, or None."""
    if missing is None or isinstance(missing, str):
        return missing
    values = tuple(missing) if isinstance(missing, Iterable) else (missing,)
    if not values:
        raise WrongValue("missing", "must not be empty")
    return values


def _missing(
    point: Point, missing: Any, kind: ValueType | None, part: Part | None
) -> frozenset[Any]:
    """Return the raw values that mean no value."""
    if missing is None:
        return frozenset()
    if kind is None:
        raise WrongValue("missing", f"must be left out for {point.type_name}")
    if missing == "sunspec":
        if part is not None:
            raise WrongValue("missing", "must be numbers for a part of a register")
        if kind.name not in SUNSPEC_MISSING and not kind.is_text:
            reason = f"must be numbers for {kind.name}, which SunSpec does not have"
            raise WrongValue("missing", reason)
        bits = 0 if kind.is_text else SUNSPEC_MISSING[kind.name]
        return frozenset() if bits is None else frozenset([_raw_of_bits(point, kind, bits)])
    if isinstance(missing, str):
        raise WrongValue("missing", f'must be numbers or "sunspec", not {reprlib.repr(missing)}')
    numbers = enumerate(missing)
    return frozenset(_raw(("missing", at), point, kind, part, number) for at, number in numbers)


def _raw(path: Path, point: Point, kind: ValueType, part: Part | None, value: Any) -> Any:
    # Manuals name the bits of a negative number, such as 0x8000.
    if part is not None:
        bits = integer(path, value, part.limits[0], (1 << part.width) - 1)
        return part.of(bits << part.shift)
    if kind.is_text:
        raise WrongValue(path, 'must be "sunspec" for strings')
    most = (1 << 16 * kind.registers) - 1
    if kind.limits is None or point.bits is not None:
        return _raw_of_bits(point, kind, integer(path, value, 0, most))
    low, high = kind.limits
    if kind.name.startswith("int"):
        number = integer(path, value, int(low), 2 * int(high) + 1)
        return number if number <= high else number - 2 * (int(high) + 1)
    if kind.name.startswith(HAVE_NO_VALUE) and isinstance(value, int) and value > high:
        return _raw_of_bits(point, kind, integer(path, value, int(low), most))
    try:
        raw = kind.decode(kind.encode(value))
        return shortest(raw, kind.name) if isinstance(raw, float) else raw
    except (TypeError, ValueError) as error:
        raise placed(error, ()).renamed(path) from None


def _raw_of_bits(point: Point, kind: ValueType, bits: int) -> Any:
    if not (kind.name.startswith("bits") or point.bits is not None):
        with contextlib.suppress(ValueError):  # of registers that hold no time, or no digits
            return kind.decode(kind.cells_of_number(bits))
    return bits
