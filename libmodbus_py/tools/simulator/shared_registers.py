"""
Points of a device file that are different bits of the same registers.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import replace

from ...maps.point import Point
from .simulated_point import SimulatedPoint

__all__ = ["without_parts"]


def without_parts(
    found: Iterable[SimulatedPoint],
) -> tuple[list[SimulatedPoint], dict[str, Point]]:
    """
    Return the points, each with cells of its own, and by name the points that share their cells.

    The first point of some registers gets the initial bits of the others. Points that move, and
    those that have a bit in common, are all kept.
    """
    kept: dict[object, SimulatedPoint] = {}
    taken: dict[object, list[int]] = {}
    others: dict[str, Point] = {}
    for each in found:
        key: object = (each.place, each.first, each.stop)
        masks = _masks(each)
        if masks and key in taken and not any(map(int.__and__, masks, taken[key])):
            first = kept[key]
            bits = map(int.__or__, first.all_cells, each.all_cells)
            kept[key] = replace(first, cells=array("H", bits))
            taken[key] = list(map(int.__or__, masks, taken[key]))
            name = each.point.name
            while name in others:
                name += "_"
            others[name] = replace(each.point, name=name)
        elif masks and key not in kept:
            kept[key], taken[key] = each, masks
        else:
            kept[id(each)] = each
    return list(kept.values()), others


def _masks(each: SimulatedPoint) -> list[int]:
    """Return the bits of a point in each of its registers; none if it does not leave others."""
    point, kind = each.point, each.point.read.kind
    if not point.is_part or each.behaviour is not None or kind is None or each.file:
        return []
    assert point.meaning is not None
    return kind.cells_of_number(point.meaning.mask) * point.count
