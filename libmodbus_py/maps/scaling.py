"""
Scaling of raw numbers without the noise of binary fractions: 2305 * 0.1 is 230.5.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex

from ..protocol import checks
from ..protocol.checks import shown
from ..protocol.mistakes import WrongType, WrongValue

if TYPE_CHECKING:
    # Imported where needed: it takes as long as a read, and most programs scale nothing.
    from fractions import Fraction

__all__ = ["Scaling", "exact", "number", "scaling_by"]

# Far beyond any measured quantity, and small enough for exact arithmetic.
LARGEST, SMALLEST = 1e30, 1e-30

# A float that has as many digits, and is the quotient of 1 and a whole number, is the result of
# that division.
DIGITS_OF_DIVISION = 14


def number(name: str, value: object) -> int | float:
    """Check a number of a map: an int or float in -1e30..1e30, not True or False."""
    found = checks.number(name, value, -LARGEST, LARGEST)
    return int(found) if isinstance(found, int) else float(found)


class Scaling:
    """
    value = raw * scale * factor + offset, computed exactly and rounded once, to the nearest float.

    Scale and offset are taken as they are written: 0.1 is a tenth. Where all are whole, integers
    give integers. The scale is not nearer to 0 than 1e-30.
    """

    __slots__ = ("_divisor", "_factor", "_shift")

    def __init__(self, scale: float, offset: float, factor: Fraction | None = None) -> None:
        if abs(number("scale", scale)) < SMALLEST:
            raise WrongValue("scale", f"must not be nearer to 0 than {SMALLEST:g}: {shown(scale)}")
        times, plus = exact_scale(scale), exact(number("offset", offset))
        if factor is not None:
            times *= factor
        self._divisor = math.lcm(times.denominator, plus.denominator)
        self._factor = int(times * self._divisor)
        self._shift = int(plus * self._divisor)

    def to_value(self, raw: float) -> int | float:
        """Return the scaled value of a raw number; infinity and nan stay what they are."""
        if not isinstance(raw, float):
            scaled = raw * self._factor + self._shift
            # Python divides integers exactly, and rounds once.
            return scaled if self._divisor == 1 else scaled / self._divisor
        if not math.isfinite(raw):
            return raw * self._factor
        above, below = raw.as_integer_ratio()
        scaled = above * self._factor + below * self._shift
        try:
            return scaled / (below * self._divisor)
        except OverflowError:
            return math.inf if scaled > 0 else -math.inf  # too large for copysign, too

    def to_whole(self, value: object) -> int:
        """Return the nearest raw number; of two equally near ones, the even one."""
        return round(self._to_raw(value))

    def to_float(self, value: object) -> float:
        """Return the raw number as a float; infinity and nan stay what they are."""
        if isinstance(value, float) and not math.isfinite(value):
            return value * self._factor
        try:
            return float(self._to_raw(value))
        except OverflowError:
            raise WrongValue("value", f"is too large: {shown(value)}") from None

    def _to_raw(self, value: object) -> Fraction:
        return (exact(value) * self._divisor - self._shift) / self._factor


LARGEST_EXPONENT = round(math.log10(LARGEST))
"""Powers of ten that a device may name: those of `LARGEST` and `SMALLEST`."""


@lru_cache(maxsize=1024)
def scaling_by(scale: float, offset: float, how: str, source: float) -> Scaling:
    """
    Return the scaling with a power of ten, or a factor, that the device tells; or raise ValueError.
    """
    from fractions import Fraction

    if how == "exponent":
        if source != source or abs(source) > LARGEST_EXPONENT or source != int(source):
            raise ValueError(f"a power of ten in -30..30, not {shown(source)}")
        return Scaling(scale, offset, Fraction(10) ** int(source))
    if not SMALLEST <= abs(source) <= LARGEST:
        raise ValueError(f"a factor in 1e-30..1e30, not {shown(source)}")
    return Scaling(scale, offset, exact(source))


def exact(value: Any) -> Fraction:
    """
    Return a number as it is written; of a float, the shortest text that Python reads as that float.
    """
    from fractions import Fraction

    if isinstance(value, bool) or not isinstance(value, SupportsFloat | SupportsIndex):
        raise WrongType("value", f"must be a number, not {type(value).__name__}")
    if isinstance(value, SupportsIndex):
        return Fraction(value.__index__())
    if not math.isfinite(value):
        raise WrongValue("value", f"must be a finite number, not {value}")
    # str() of a Decimal is exact, too; Fractions have a numerator.
    return Fraction(str(value) if _is_exact(value) else repr(float(value)))


def exact_scale(scale: float) -> Fraction:
    """Return a scale as it is written, and 1/n where a file has the divisor n, such as 3."""
    from fractions import Fraction

    written = exact(scale)
    divisor = round(1 / scale)
    # No text of a person has as many digits as the nearest float of a third.
    if divisor and 1 / divisor == scale and len(str(written.numerator)) >= DIGITS_OF_DIVISION:
        return Fraction(1, divisor)
    return written


def _is_exact(value: object) -> bool:
    return hasattr(value, "as_tuple") or hasattr(value, "numerator")
