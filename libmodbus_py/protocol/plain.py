"""
Values as text: as people read and type them, in JSON, and points in time.

Files, JSON, CSV, logs and messages have times of ISO 8601 in UTC, so that they sort, and do not
depend on the place. Lines that a person watches have the clock of the place.
"""

from __future__ import annotations

import enum
import math
import re
import reprlib
from collections.abc import Callable
from struct import Struct
from typing import TYPE_CHECKING, Any

from .pdu import Request
from .pdu.request import arguments

if TYPE_CHECKING:
    from datetime import datetime

    from .value_types import ValueType

CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")
"""Control characters (Cc of Unicode) beside the line feed: terminals obey them."""


def plain(value: Any) -> Any:
    """
    Return a value, or a request, made of types that JSON has.

    Bytes are hexadecimal text, nan and infinities None; requests and named tuples are objects.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, int | str):
        return value
    if isinstance(value, Request):
        fields = {name: plain(item) for name, item in arguments(value).items()}
        return {"name": type(value).__name__, **fields}
    if isinstance(value, bytes):
        return value.hex()
    if hasattr(value, "isoformat"):  # a datetime, whose module most commands never load
        return value.isoformat()
    if isinstance(value, enum.Enum):
        return value.value
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def without_controls(text: str) -> str:
    """Return a text with ``\\x1b`` and so on in place of control characters, for terminals."""
    return CONTROL.sub(lambda match: f"\\x{ord(match[0]):02x}", text)


# --- times ---------------------------------------------------------------------------


def time_text(seconds: float) -> str:
    """Return seconds since 1970 as 2026-07-01T12:00:00.250Z; as 253402300800.000s from 10000 on."""
    from datetime import UTC, datetime  # which most commands never load

    try:
        text = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    except (OverflowError, ValueError, OSError):  # of a year that datetime, or the system, lacks
        return f"{seconds:.3f}s"
    return f"{text[:-6]}Z"


def clock_text(seconds: float, *, with_milliseconds: bool = False) -> str:
    """Return the time of day here, such as 14:00:00 or 14:00:00.250; else as `time_text`."""
    from datetime import datetime

    whole, part = divmod(round(seconds * 1000), 1000)
    try:
        clock = datetime.fromtimestamp(whole).strftime("%H:%M:%S")
    except (OverflowError, ValueError, OSError):  # as in `time_text`
        return f"{seconds:.3f}s"
    return f"{clock}.{part:03}" if with_milliseconds else clock


# --- values of types -------------------------------------------------------------------

BITS = {"0": False, "1": True, "off": False, "on": True, "false": False, "true": True}


def _family(kind: ValueType) -> str:
    return kind.name.rstrip("0123456789")


# Type -> forms with as many digits as every value keeps (IEEE 754), and with more, of which the
# last tell every two values apart; and what packs it. Python shows the shortest of float64.
SHORT_FLOATS: dict[str, tuple[tuple[str, ...], Callable[[float], bytes]]] = {
    "float16": (("%.3g", "%.4g", "%.5g"), Struct("e").pack),
    "float32": (("%.6g", "%.7g", "%.8g", "%.9g"), Struct("f").pack),
}


def shortest(value: float, name: str) -> float:
    """Return the number with the fewest digits that a type has as this value: 230.1 for float32."""
    if name not in SHORT_FLOATS or not math.isfinite(value):
        return value
    forms, pack = SHORT_FLOATS[name]
    data = pack(value)
    for form in forms:
        number = float(form % value)
        if pack(number) == data:
            return number
    return value


SHOWN: dict[str, Callable[[Any, ValueType], str]] = {
    "float": lambda value, kind: str(shortest(value, kind.name)),
    "bits": lambda value, _: "".join(str(int(bit)) for bit in value),
    "string:": lambda value, _: repr(value),
}
"""Family of types -> how a value of it is printed; others as numbers."""


def text_of(value: Any, kind: ValueType) -> str:
    """Return a value of a type as text: the shortest number, the lowest bit first, quoted text."""
    show = SHOWN.get(_family(kind))
    if show:
        return show(value, kind)
    return str(value.isoformat()) if kind.is_time else str(value)


def number_of(name: str, text: str) -> int:
    """Read an integer as Python writes them, such as 31 or 0x1F."""
    try:
        return int(text, 0)
    except ValueError:
        raise ValueError(f"{name} must be a number, not {text!r}") from None


def bit_of(text: str) -> bool:
    """Read one of 0, 1, off, on, false, true."""
    try:
        return BITS[text.lower()]
    except KeyError:
        raise ValueError(f"value must be one of {', '.join(BITS)}, not {text!r}") from None


def decimal_of(text: str) -> float:
    """Read a number such as 21.5, inf or nan."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"value must be a number, not {text!r}") from None
    if math.isinf(value) and "inf" not in text.lower():  # 1e400 is not read as infinity
        raise ValueError(f"value is too large: {reprlib.repr(text)}")
    return value


def time_of(text: str) -> datetime:
    """Read a date and time with its time zone (ISO 8601), such as 2026-07-01T12:00:00Z."""
    from datetime import datetime

    try:
        time = datetime.fromisoformat(text.strip())
    except ValueError:
        time = None
    if time is None or time.utcoffset() is None:
        form = "a date and time with a time zone, such as 2026-07-01T12:00:00Z"
        raise ValueError(f"value must be {form}, not {reprlib.repr(text)}")
    return time


def _bits(text: str) -> list[int]:
    if not re.fullmatch("[01]+", text):
        raise ValueError(f"value must be digits 0 and 1, lowest bit first, not {text!r}")
    return [int(digit) for digit in text]


PARSERS: dict[str, Callable[[str], Any]] = {
    "float": decimal_of,
    "bits": _bits,
    "string:": str,
    "eui": str,
}
"""Family of types -> how a value of it is typed; others as numbers."""


def value_of(text: str, kind: ValueType) -> Any:
    """Read a value of a type, as `text_of` returns it; text without quotes."""
    if kind.is_time:
        return time_of(text)
    parse = PARSERS.get(_family(kind))
    return number_of("value", text) if parse is None else parse(text)


_UNITS = re.compile(r"\s*([0-9]{1,3})\s*(?:-\s*([0-9]{1,3})\s*)?", re.ASCII)


def units_of(text: str) -> list[int]:
    """Read units 0..255 in the order of the text: numbers and ranges, such as "1-10,17"."""
    units: list[int] = []
    for part in text.split(","):
        match = _UNITS.fullmatch(part)
        if match is None:
            raise ValueError(f"{reprlib.repr(part)} must be a unit, or a range such as 1-247")
        first, last = int(match[1]), int(match[2] or match[1])
        if not first <= last <= 255:
            verb = "be" if match[2] is None else "go up,"
            raise ValueError(f"{part!r} must {verb} within 0..255")
        units += range(first, last + 1)
    return units
