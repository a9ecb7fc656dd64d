"""
The bounds of points, in cells that someone else has encoded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..protocol.checks import shown
from ..protocol.mistakes import WrongValue
from .point import Point

__all__ = ["check_cells", "has_bounds"]


def has_bounds(point: Point) -> bool:
    """Return True if a point has a minimum or a maximum."""
    return point.minimum is not None or point.maximum is not None


def check_cells(point: Point, cells: Sequence[Any], *, source: Any = None) -> None:
    """
    Check all values that the cells of a point hold against its `minimum` and `maximum`.

    The nearest value to a bound that the type has is within it: 0.1 as a float32 is not above 0.1.

    Args:
        source: the value of the point that scales this one.

    Raises:
        ValueError: a value is outside, is not a number, or the cells hold none; the message names
            the point and the bounds. Or `source` is not a scale.
    """
    if not has_bounds(point):
        return
    scaling = point.scaling_for(source)
    try:
        values = point.values_in(cells, scaling)
    except ValueError as error:
        raise WrongValue.about(point.name, str(error)) from None
    for value in values:
        if value is None or not (_is_above(point, value) and _is_below(point, value)):
            low, high = ("" if each is None else each for each in (point.minimum, point.maximum))
            raise WrongValue.about(
                point.name, f"value must be in {low}..{high}, not {_told(value)}"
            )


def _told(value: float | None) -> str:
    return "a raw value that means no value" if value is None else shown(value)


def _is_above(point: Point, value: float) -> bool:
    low = point.minimum
    return low is None or value >= low or value == _held(point, low)


def _is_below(point: Point, value: float) -> bool:
    high = point.maximum
    return high is None or value <= high or value == _held(point, high)


def _held(point: Point, bound: float) -> Any:
    """Return the value that cells hold for a bound; None if they cannot hold any."""
    # Integers hold it, or it lies between two of them; so do those that another point scales.
    if point.step or point.scale_from is not None:
        return None
    try:
        return point.values_in(point.cells_for([bound]))[0]
    except ValueError:
        return None
