"""
Device files of the points of a map, for tests of values that scale each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from libmodbus_py import Point, RegisterMap

__all__ = ["file_of"]

KEYS = ("type", "missing", "scale", "scale_from", "scale_as", "minimum", "maximum")


def file_of(points: RegisterMap, values: Mapping[str, Any]) -> str:
    """Return a device file with these points and values."""
    lines = ["[[unit]]"]
    for each in (points[name] for name in points):
        plain = Point(each.name, each.table, each.address)
        lines += [f"[[unit.{each.table}]]", f"address = {each.address}", f'name = "{each.name}"']
        for key in KEYS:
            if (value := getattr(each, key)) != getattr(plain, key):
                lines.append(f"{key} = {value!r}".replace("'", '"'))
        lines.append(f"value = {values[each.name]!r}")
    return "\n".join(lines) + "\n"
