"""
The cells of requests and responses as values of points: names, scaled values and units.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...device.access import ACCESSES
from ...device.named_values import source_after
from ...maps.point import Point
from ...protocol.pdu import Request
from .shown import ShownUnit
from .tables import cell_text
from .views import point_text

__all__ = ["named_cells"]

NO_CALLER = (0, "", None)

MOST_POINTS = 6
"""The most points that are named; a request may contain more."""


def named_cells(unit: ShownUnit, request: Request[Any], response: Any) -> str:
    """
    Return the points that a request reads or writes as a whole, with their values.

    Args:
        unit: the unit of the request.
        request: the request.
        response: the result of the request; None unless the response contains values.

    Returns:
        Text such as "voltage 230.1 V, pump on"; empty if there are no such points.
    """
    kind = ACCESSES.get(type(request))
    if kind is None:
        return ""
    touched = kind.find(request, unit.device.mapping, NO_CALLER)
    found: list[str] = [
        text
        for each in touched.writes
        for text in _values(unit, each.table, each.address, each.values)
    ]
    if isinstance(response, list | tuple):
        for each in touched.reads:
            found += _values(unit, each.table, each.address, response[: each.count])
    more = ", ..." if len(found) > MOST_POINTS else ""
    return cell_text(", ".join(found[:MOST_POINTS]) + more)


def _values(unit: ShownUnit, table: str, first: int, cells: Sequence[Any]) -> list[str]:
    stop = first + len(cells)
    found: list[str] = []
    for point in unit.points_from(table, first):
        if point.address >= stop or len(found) > MOST_POINTS:
            break
        if point.cells.stop <= stop:
            own = list(cells[point.cells.start - first : point.cells.stop - first])
            found.append(f"{point.name} {_text(unit, point, own)}")
    return found


def _text(unit: ShownUnit, point: Point, cells: list[Any]) -> str:
    source = None
    if point.scale_from is not None:
        with unit.device.mapping as mapping:
            try:
                source = source_after(point, unit.device.points, mapping)
            except (IndexError, KeyError, ValueError):  # a map may have what the device lacks
                source = None
    text = point_text(point, cells, source)
    return f"{text} {point.units}" if point.units else text
