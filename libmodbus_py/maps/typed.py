"""
Values of points and registers from the text that a person typed.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..protocol.checks import shown
from ..protocol.json_text import each_once
from ..protocol.mistakes import WrongValue, inside
from ..protocol.spelling import BITS, bit_of, decimal_of, number_of, value_of

if TYPE_CHECKING:
    from decimal import Decimal

    from .point import Point

__all__ = ["json_value", "typed_register", "typed_value"]


def typed_value(point: Point, text: str) -> Any:
    """
    Return one value of a point, as `Point.encode` takes it.

    Spaces around the text are ignored, except in strings. Scaled numbers are decimal and exact:
    one that a float cannot hold becomes an int or a Decimal. A state is its name or its number;
    named bits are like "door=1, mode=5", or a JSON object.

    Raises:
        ValueError: the text is no value of this type; the message begins with "value".
    """
    if point.states is not None:
        return _state(point.states, text.strip())
    if point.bits is not None:
        return _named_bits(text)
    kind, meaning = point.read.kind, point.meaning
    part = None if meaning is None else meaning.part
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


def _state(states: Mapping[int, str], text: str) -> str | int:
    if text in states.values():
        return text
    try:
        return number_of("value", text)
    except ValueError:
        allowed = ", ".join(states.values())
        raise ValueError(f"value must be one of {allowed}, or a number, not {text!r}") from None


def _named_bits(text: str) -> dict[str, int]:
    """Return the bits of "door=1, mode=5", or of a JSON object."""
    if text.lstrip().startswith("{"):
        return _object(text)
    found: list[tuple[str, int]] = []
    for each in text.split(","):
        name, separator, value = each.partition("=")
        if not separator:
            raise ValueError(f"value must be like name=1, other=0, not {text!r}")
        value = value.strip().lower()
        bits = BITS[value] if value in BITS else number_of("value", value)
        found.append((name.strip(), bits))
    with inside("value"):
        return each_once(found)


def json_value(point: Point, value: Any) -> Any:
    """
    Return a value of JSON as `Point.encode` takes it: times are text (ISO 8601).

    Raises:
        ValueError: a text is no time; the message begins with "value".
    """
    kind = point.read.kind
    if kind is None or not kind.is_time:
        return value
    if point.count > 1 and isinstance(value, list):
        return [value_of(each, kind) if isinstance(each, str) else each for each in value]
    return value_of(value, kind) if isinstance(value, str) else value


def _object(text: str) -> dict[str, int]:
    try:
        found: dict[str, int] = json.loads(text, object_pairs_hook=each_once)
    except WrongValue as mistake:
        raise mistake.under(("value",)) from None
    except (ValueError, RecursionError):
        raise ValueError(f"value must be a JSON object, not {reprlib.repr(text)}") from None
    return found


def typed_register(text: str) -> int:
    """
    Return one register, 0..65535; -1 is 65535, because both are the same 16 bits.

    Raises:
        ValueError: the text is no number in -32768..65535; the message begins with "value".
    """
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
