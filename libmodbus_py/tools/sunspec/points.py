"""
The points of one SunSpec model, from its definition: types, scale factors, repeated groups.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from ...maps.point import Point
from ...maps.point_checks import MAX_DESCRIPTION
from ...protocol.tables import Table

__all__ = ["HEADER", "MOST_POINTS", "NOT_IMPLEMENTED", "TABLE", "ModelLayout", "counters_of"]

TABLE: Table = "holding_registers"

HEADER = 2
"""Registers of the header of a model: id and length."""

MOST_POINTS = 10000
"""Points of one device, as many as a map file may have."""

# Registers; a longer text is kept as registers.
LONGEST_TEXT = 125

NOT_IMPLEMENTED = 0xFFFF
"""The register of a number of groups that the device does not have."""

# Type of SunSpec -> keys of a point. An accumulator that a device lacks is 0.
_TYPES: dict[str, dict[str, Any]] = {
    **{
        name: {"type": name, "missing": "sunspec"}
        for name in ("int16", "uint16", "int32", "uint32", "int64", "uint64")
    },
    **{f"acc{size}": {"type": f"uint{size}", "missing": 0} for size in (16, 32, 64)},
    **{f"enum{size}": {"type": f"uint{size}", "missing": "sunspec"} for size in (16, 32)},
    **{f"bitfield{size}": {"type": f"bits{size}", "missing": "sunspec"} for size in (16, 32, 64)},
    **{f"float{size}": {"type": f"float{size}"} for size in (32, 64)},
    "count": {"type": "uint16", "missing": "sunspec"},
    "sunssf": {"type": "int16", "missing": "sunspec"},
    "ipaddr": {"type": "uint32", "missing": 0},
    "eui48": {"type": "eui48", "missing": "sunspec"},
}


class ModelLayout:
    """The points of a definition, laid over the registers of a model, `room` of them at most."""

    def __init__(
        self,
        group: Mapping[str, Any],
        address: int,
        length: int,
        counts: Mapping[str, int],
        room: int = MOST_POINTS,
    ) -> None:
        self.points: list[Point] = []
        self.notes: list[str] = []
        self._at, self._stop = address, address + HEADER + length
        self._counts, self._room = counts, room
        self._lay(group, "", {})
        self.used: int = self._at - address
        names = {None, *(point.name for point in self.points)}
        points = [point for point in self.points if point.scale_from in names]
        if unscaled := len(self.points) - len(points):
            self.notes.append(f"{unscaled} points are left out with their scale factors")
        self.points = points

    def _lay(self, group: Mapping[str, Any], prefix: str, scales: Mapping[str, str]) -> bool:
        """Lay one group, and those inside it; return False if it does not fit."""
        own = {
            each["name"]: prefix + each["name"]
            for each in group["points"]
            if each["type"] == "sunssf"
        }
        known = {**scales, **own}
        for each in group["points"]:
            if self._at + each["size"] > self._stop:
                if each["type"] != "pad":
                    self.notes.append(f"{prefix}{each['name']} and what follows do not fit")
                return False
            if len(self.points) >= self._room:
                self.notes.append(f"there are too many points: {prefix}{each['name']} is left out")
                return False
            if each["type"] != "pad":
                self.points.append(
                    Point(prefix + each["name"], TABLE, self._at, **_keys(each, known))
                )
            self._at += each["size"]
        return all(self._lay_all(inner, prefix, known) for inner in group.get("groups", ()))

    def _lay_all(self, group: Mapping[str, Any], prefix: str, scales: Mapping[str, str]) -> bool:
        """Lay a group as often as it is repeated; return False if one does not fit."""
        name, count = f"{prefix}{group['name']}", group.get("count")
        if count is None:
            return self._lay(group, f"{name}.", scales)
        if count == 0:  # as many as fit
            size, room = _size(group), self._stop - self._at
            count = room // size
            if room % size:
                self.notes.append(
                    f"{name} takes {size} registers each, and {room} is not a multiple"
                )
        elif isinstance(count, str):
            count = self._counts.get(count, 0)
        return all(self._lay(group, f"{name}.{at}.", scales) for at in range(1, count + 1))


def _size(group: Mapping[str, Any]) -> int:
    """Return the registers of a group whose inner groups are not repeated."""
    own: int = sum(each["size"] for each in group["points"])
    return own + sum(_size(inner) for inner in group.get("groups", ()))


def counters_of(group: Mapping[str, Any]) -> dict[str, int]:
    """Return the top-level points by which groups are repeated: name -> offset from the id."""
    wanted = set(_counted_by(group))
    found, at = {}, 0
    for each in group["points"]:
        if each["name"] in wanted:
            found[each["name"]] = at
        at += each["size"]
    return found


def _counted_by(group: Mapping[str, Any]) -> Iterator[str]:
    for inner in group.get("groups", ()):
        if isinstance(count := inner.get("count"), str):
            yield count
        yield from _counted_by(inner)


# --- one point ---------------------------------------------------------------------------


def _keys(given: Mapping[str, Any], scales: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys of a point but its name and address."""
    kind, size = given["type"], given["size"]
    description = " ".join((given.get("desc") or given.get("label") or "").split())
    keys = {
        "access": "read_write" if given.get("access") == "RW" else "read",
        "units": given.get("units", "").strip(),
        "description": "".join(filter(str.isprintable, description))[:MAX_DESCRIPTION],
    }
    if kind == "string" and size <= LONGEST_TEXT:
        return {**keys, "type": f"string:{2 * size}", "encoding": "utf-8", "missing": "sunspec"}
    if kind not in _TYPES:  # an IPv6 address, or a long text
        return {**keys, "count": size}
    keys |= _TYPES[kind]
    if kind.startswith("enum"):
        keys |= _named("states", given)
    elif kind.startswith("bitfield"):
        keys |= _named("bits", given, 16 * size)
    elif isinstance(scale := given.get("sf"), int):
        keys["scale"] = 10**scale if scale >= 0 else float(f"1e{scale}")
    elif isinstance(scale, str) and scale in scales:
        keys["scale_from"] = scales[scale]
    return keys


def _named(key: str, given: Mapping[str, Any], width: float = math.inf) -> dict[str, Any]:
    """Return the states of a point, or its bits, of which there are `width`."""
    names: dict[int, str] = {}
    for each in given.get("symbols") or ():
        number, name = each["value"], each["name"]
        if 0 <= number < width:
            names[number] = name if name not in names.values() else f"{name}_{number}"
    return {key: names} if names else {}
