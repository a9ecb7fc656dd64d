"""
Values of points and registers from the text that a person typed.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from ..protocol.checks import shown
from ..protocol.json_text import each_once
from ..protocol.mistakes import WrongValue, inside
from ..protocol.plain import BITS, bit_of, decimal_of, number_of, value_of

if TYPE_CHECKING:
    from decimal import Decimal

    from .point import Point

Each = TypeVar("Each")


def typed_value(point: Point, text: str) -> Any:
    """
    Return one value, as `Point.encode` takes it, or raise a ValueError that begins with "value".

    Spaces around the text are ignored, except in strings. Scaled numbers are decimal and exact:
    one that a float cannot hold becomes an int or a Decimal.
    """
    if point.states is not None:
        return _state(point, point.states, text.strip())
    if point.bits is not None:
        return _named_bits(text)
    kind, part = point.read.kind, point.meaning.part
    if kind is None or (part is not None and part.is_flag):
        return bit_of(text.strip())
    if kind.is_text:
        return value_of(text, kind)
    is_plain = (point.scale, point.offset, point.scale_from) == (1, 0, None)
    if is_plain and part is not None:
        return number_of("value", text.strip())
    if is_plain or (kind.limits is None and part is None):
        return value_of(text.strip(), kind)
    return _exact(text)


def typed_values(point: Point, text: str) -> Any:
    """
    Return the value of a point that a text says; a list, of values between commas, if it has some.

    Named bits contain commas themselves, and so may the names of states: these are a JSON array.
    """
    if point.count == 1:
        return typed_value(point, text)
    if point.bits is not None or (point.states is not None and text.lstrip().startswith("[")):
        return _json(text, list, "array")
    return [typed_value(point, word.strip()) for word in text.split(",")]


def _state(point: Point, states: Mapping[Any, str], text: str) -> Any:
    if text in states.values():
        return text
    kind = None if point.meaning.part is not None else point.read.kind
    try:
        return number_of("value", text) if kind is None else value_of(text, kind)
    except ValueError:
        allowed = ", ".join(states.values())
        raise ValueError(f"value must be one of {allowed}, or a number, not {text!r}") from None


def _named_bits(text: str) -> dict[str, int]:
    """Return the bits of "door=1, mode=5", or of a JSON object."""
    if text.lstrip().startswith("{"):
        return _json(text, dict, "object")
    found: list[tuple[str, int]] = []
    for each in text.split(","):
        name, separator, value = each.partition("=")
        if not separator:
            raise ValueError(f"value must be like name=1, other=0, or a JSON object, not {text!r}")
        value = value.strip().lower()
        bits = BITS[value] if value in BITS else number_of("value", value)
        found.append((name.strip(), bits))
    with inside("value"):
        return each_once(found)


def json_value(point: Point, value: Any) -> Any:
    """Return a value of JSON as `Point.encode` takes it: times are text (ISO 8601)."""
    kind = point.read.kind
    if kind is None or not kind.is_time:
        return value
    if point.count > 1 and isinstance(value, list):
        return [value_of(each, kind) if isinstance(each, str) else each for each in value]
    return value_of(value, kind) if isinstance(value, str) else value


def _json(text: str, kind: type[Each], name: str) -> Each:
    """Return the object or array that a text contains as JSON."""
    try:
        found = json.loads(text, object_pairs_hook=each_once)
    except WrongValue as mistake:
        raise mistake.under(("value",)) from None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, kind):
        raise ValueError(f"value must be a JSON {name}, not {reprlib.repr(text)}")
    return found


def typed_register(text: str) -> int:
    """Return one register; -1 is 65535, because both are the same 16 bits. Raises ValueError."""
    value = number_of("value", text)
    if not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"value must be in -32768..65535, not {shown(value)}")
    return value & 0xFFFF


def _exact(text: str) -> int | float | Decimal:
    nearest = decimal_of(text)  # which also limits the exponent of what is computed with
    if not nearest or not math.isfinite(nearest):
        return nearest
    from decimal import Decimal

    exact = Decimal(text)
    if exact == exact.to_integral_value():
        return int(exact)
    return nearest if exact == Decimal(repr(nearest)) else exact
