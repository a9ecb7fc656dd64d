"""
Values of points and registers from the text that a person typed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..protocol.checks import shown
from ..protocol.spelling import bit_of, decimal_of, number_of, value_of

if TYPE_CHECKING:
    from decimal import Decimal

    from .point import Point

__all__ = ["typed_register", "typed_value"]


def typed_value(point: Point, text: str) -> Any:
    """
    Return one value of a point, as `Point.encode` takes it.

    Spaces around the text are ignored, except in strings. Scaled numbers are decimal and exact:
    one that a float cannot hold becomes an int or a Decimal.

    Raises:
        ValueError: the text is no value of this type; the message begins with "value".
    """
    kind = point.read.kind
    if kind is None:
        return bit_of(text.strip())
    if kind.is_text:
        return value_of(text, kind)
    if kind.limits is None or (point.scale, point.offset) == (1, 0):
        return value_of(text.strip(), kind)
    return _exact(text)


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
