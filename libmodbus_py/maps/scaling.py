"""
What raw numbers stand for: scaled values, and the names of states.

Scaling adds no noise of binary fractions: 2305 * 0.1 is 230.5.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsFloat, SupportsIndex

from ..protocol import checks
from ..protocol.checks import integer, shown
from ..protocol.mistakes import Path, WrongType, WrongValue
from ..protocol.plain import shortest
from ..protocol.values import ValueType

if TYPE_CHECKING:
    # Imported where needed: it takes as long as a read, and most programs scale nothing.
    from fractions import Fraction

# Far beyond any measured quantity, and small enough for exact arithmetic.
LARGEST, SMALLEST = 1e30, 1e-30

ELSE = "else"
"""The key of the name of all numbers that have no other."""


def number(name: str, value: object) -> int | float:
    """Check a number of a map: an int or float in -1e30..1e30, not True or False."""
    amount = checks.number(name, value, -LARGEST, LARGEST)
    return int(amount) if isinstance(amount, int) else float(amount)


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
            value = raw * self._factor + self._shift
            # Python divides integers exactly, and rounds once.
            return value if self._divisor == 1 else value / self._divisor
        if not math.isfinite(raw):
            return raw * self._factor
        above, below = _as_written(raw)
        value = above * self._factor + below * self._shift
        try:
            return value / (below * self._divisor)
        except OverflowError:
            return math.inf if value > 0 else -math.inf  # too large for copysign, too

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


@lru_cache(maxsize=1024)
def scaling_by(scale: float, offset: float, how: str, source: float) -> Scaling:
    """Return the scaling with a power of ten, or a factor, of a device; or raise ValueError."""
    from fractions import Fraction

    if how == "exponent":
        if source != source or abs(source) > 30 or source != int(source):
            raise ValueError(f"a power of ten in -30..30, not {shown(source)}")
        return Scaling(scale, offset, Fraction(10) ** int(source))
    if not SMALLEST <= abs(source) <= LARGEST:
        raise ValueError(f"a factor in 1e-30..1e30, not {shown(source)}")
    return Scaling(scale, offset, exact(source))


def _as_written(value: float) -> tuple[int, int]:
    """Return a float as the quotient of two whole numbers, as `exact`, in a tenth of the time."""
    whole, _, decimals = repr(value).partition(".")
    if "e" in decimals or "e" in whole:
        return exact(value).as_integer_ratio()
    return int(whole + decimals), 10 ** len(decimals)


def exact(value: Any) -> Fraction:
    """Return a number as it is written; a float as the shortest text that Python reads as it."""
    from fractions import Fraction

    if isinstance(value, bool) or not isinstance(value, SupportsFloat | SupportsIndex):
        raise WrongType("value", f"must be a number, not {type(value).__name__}")
    if isinstance(value, SupportsIndex):
        return Fraction(value.__index__())
    if not math.isfinite(value):
        raise WrongValue("value", f"must be a finite number, not {value}")
    is_exact = hasattr(value, "as_tuple") or hasattr(value, "numerator")  # a Decimal, a Fraction
    return Fraction(str(value) if is_exact else repr(float(value)))


def exact_scale(scale: float) -> Fraction:
    """Return a scale as it is written, and 1/n where a file has the divisor n, such as 3."""
    from fractions import Fraction

    digits = exact(scale)
    divisor = round(1 / scale)
    # No text of a person has as many digits as the nearest float of a third.
    is_quotient = divisor and 1 / divisor == scale and len(str(digits.numerator)) >= 14
    return Fraction(1, divisor) if is_quotient else digits


# --- states ---------------------------------------------------------------------------------


class NumberSpan(NamedTuple):
    """The numbers from `low` to `high`, both included; `key` is how a map writes it."""

    low: float
    high: float
    key: str


class States(dict[Any, Any]):
    """
    The name of each number, which is the number itself if it has none.

    `names` are by number, by `NumberSpan` and by `ELSE`. A number of its own comes before a range,
    and a range before `ELSE`.
    """

    def __init__(self, names: Mapping[Any, str]) -> None:
        self._spans = [(key, name) for key, name in names.items() if isinstance(key, NumberSpan)]
        self._default = names.get(ELSE)
        self.is_simple: bool = not (self._spans or self._default)  # `get` does, which is faster
        spans = {key for key, _ in self._spans}
        super().__init__({key: names[key] for key in names if key not in spans and key != ELSE})

    def __missing__(self, number: Any) -> Any:
        for span, name in self._spans:
            if span.low <= number <= span.high:
                return name
        return number if self._default is None else self._default

    def number_of(self, name: str) -> Any:
        """Return the number of a name; raise WrongValue if there is none, or several."""
        keys = sorted(key for key, state in self.items() if state == name)
        spans = [span.key for span, state in self._spans if state == name]
        if len(keys) == 1 and not spans:
            return keys[0]
        if keys or spans:
            several = ", ".join(map(str, [*keys, *spans]))
            raise WrongValue("value", f"must be a number: {name!r} is the name of {several}")
        names = ", ".join(dict.fromkeys(self.values()))
        raise WrongValue("value", f"must be one of {names}, or a number, not {name!r}")


def state_key(
    path: Path, key: object, limits: tuple[float, float], floats: ValueType | None
) -> int | float | str | NumberSpan:
    """Return the number, range or `ELSE` of a key of a map; `floats` is the type of floats."""
    if key == ELSE:
        return ELSE
    if not isinstance(key, str) or ".." not in key:
        return _number_of(path, key, limits, floats)
    first, _, last = (word.strip() for word in key.partition(".."))
    low = _number_of(path, first, limits, floats) if first else limits[0]
    high = _number_of(path, last, limits, floats) if last else limits[1]
    if low > high:
        raise WrongValue(path, "must have the lower number first")
    return NumberSpan(low, high, f"{first}..{last}")


def check_spans(keys: Iterable[object]) -> None:
    """Raise WrongValue for ranges that have numbers in common."""
    spans = sorted(key for key in keys if isinstance(key, NumberSpan))
    for first, second in pairwise(spans):
        if second.low <= first.high:
            raise WrongValue(("states", second.key), f"overlaps {first.key}")


def _number_of(
    path: Path, key: object, limits: tuple[float, float], floats: ValueType | None
) -> int | float:
    if isinstance(key, str):
        key = _number_in(path, key, is_float=floats is not None)
    if floats is None:
        return integer(path, key, int(limits[0]), int(limits[1]))
    # As registers hold it: a float32 has fewer digits than a key may have.
    return shortest(
        floats.unpack(floats.pack(path, checks.number(path, key, *limits))), floats.name
    )


def _number_in(path: Path, text: str, *, is_float: bool) -> int | float:
    try:
        return int(text[:40], 0)
    except ValueError:
        if is_float:
            with contextlib.suppress(ValueError):
                return float(text[:40])
    raise WrongValue.about(path, "the key must be a number, a range such as 1..5, or else")
