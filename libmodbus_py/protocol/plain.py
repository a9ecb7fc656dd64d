"""
Values as JSON can contain them, and text as terminals can show it.
"""

from __future__ import annotations

import enum
import math
import re
from typing import Any

from .pdu import Request
from .pdu.request import arguments

__all__ = ["CONTROL", "plain", "without_controls"]

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


def without_controls(text: str) -> str:
    """Return a text with ``\\x1b`` and so on in place of control characters, for terminals."""
    return CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", text)
