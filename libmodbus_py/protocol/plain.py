"""
Values as JSON can contain them and its encoders, text for terminals, and points in time.

Files, JSON, CSV, logs and messages have times of ISO 8601 in UTC, so that they sort, and do not
depend on the place. Lines that a person watches have the clock of the place.
"""

from __future__ import annotations

import enum
import json
import math
import re
from collections.abc import Iterable
from typing import Any

from .mistakes import WrongValue
from .pdu import Request
from .pdu.request import arguments

# fmt: off
__all__ = [
    "COMPACT_JSON", "CONTROL", "JSON", "SORTED_JSON", "clock_text", "each_once", "json_text",
    "plain", "time_text", "without_controls",
]
# fmt: on

# All JSON of the package is encoded by one of these, which raise a ValueError for a nan or an
# infinity, in place of which `plain` returns None.
JSON = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
"""Encodes text as it is."""

COMPACT_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
"""Encodes text in ASCII, without spaces."""

SORTED_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), sort_keys=True)
"""Encodes the same for equal values, without spaces."""

json_text = json.JSONEncoder(allow_nan=False).encode
"""Returns a value as JSON, in ASCII."""

CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")
"""Control characters (Cc of Unicode) beside the line feed: terminals obey them."""


def plain(value: Any) -> Any:
    """
    Return a value, or a request, made of what JSON has.

    Bytes are hexadecimal text; nan and infinities, which JSON lacks, are None; times are text as in
    ISO 8601; requests and named tuples are objects with the names of their fields, requests with
    the name of their class too.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, int | str):
        return value
    if isinstance(value, Request):
        given = {name: plain(each) for name, each in arguments(value).items()}
        return {"name": type(value).__name__, **given}
    if isinstance(value, bytes):
        return value.hex()
    if hasattr(value, "isoformat"):  # a datetime, whose module most commands never load
        return value.isoformat()
    if isinstance(value, enum.Enum):
        return value.value
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value


def each_once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """
    Return the dict of names and values, as `object_pairs_hook` of ``json.loads``, too.

    Raises:
        WrongValue: a name occurs twice, of which json would take the last.
    """
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise WrongValue.about((name,), "occurs twice")
        found[name] = value
    return found


def without_controls(text: str) -> str:
    """Return a text with ``\\x1b`` and so on in place of control characters, for terminals."""
    return CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


# --- times ---------------------------------------------------------------------------


def time_text(seconds: float) -> str:
    """
    Return a time in ISO 8601, in UTC, with milliseconds, such as 2026-07-01T12:00:00.250Z.

    A time that no year of 1..9999 has is shown in seconds, such as 253402300800.000s.

    Args:
        seconds: since 1970, as `time.time` returns them.
    """
    from datetime import UTC, datetime  # which most commands never load

    try:
        shown = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    except (OverflowError, ValueError, OSError):  # of a year that datetime, or the system, lacks
        return _seconds_text(seconds)
    return f"{shown[:-6]}Z"


def clock_text(seconds: float, *, with_milliseconds: bool = False) -> str:
    """
    Return the time of day at this place, such as 14:00:00 or 14:00:00.250; else as `time_text`.

    Args:
        seconds: since 1970, as `time.time` returns them.
    """
    from datetime import datetime

    whole, part = divmod(round(seconds * 1000), 1000)
    try:
        clock = datetime.fromtimestamp(whole).strftime("%H:%M:%S")
    except (OverflowError, ValueError, OSError):  # as in `time_text`
        return _seconds_text(seconds)
    return f"{clock}.{part:03}" if with_milliseconds else clock


def _seconds_text(seconds: float) -> str:
    return f"{seconds:.3f}s"
