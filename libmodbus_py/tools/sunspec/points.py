"""
The points of one SunSpec model, from its definition: types, scale factors, repeated groups.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from ...maps.point import Point
from ...maps.point_checks import MAX_DESCRIPTION
from ...protocol.tables import TABLE_SIZE, Table
from .chain import HEADER

__all__ = ["MOST_POINTS", "Laid", "ModelLayout", "counters_of"]

TABLE: Table = "holding_registers"

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


class Laid(NamedTuple):
    """
    The points of a model, with the number of registers that they use, and notes.

    Attributes:
        points: in the order of their addresses.
        used: registers that they take, with the header and paddings.
        notes: what does not fit, each as one sentence.
    """

    points: list[Point]
    used: int
    notes: list[str]


class ModelLayout:
    """
    Lays the points of a definition over the registers of a model.

    Args:
        group: the top-level group of the definition.
        address: the address of the register with the id.
        length: the registers after the header.
        counts: values of the points by which groups are repeated, by name.
        room: the most points that are made.
    """

    def __init__(
        self,
        group: Mapping[str, Any],
        address: int,
        length: int,
        counts: Mapping[str, int],
        room: int = MOST_POINTS,
    ) -> None:
        self._group, self._at = group, address
        self._start, self._stop = address, address + HEADER + length
        self._counts, self._room = counts, room
        self._points: list[Point] = []
        self._notes: list[str] = []

    def laid(self) -> Laid:
        """Return the points that fit, and notes about the rest."""
        self._lay(self._group, "", {})
        names = {None, *(point.name for point in self._points)}
        points = [point for point in self._points if point.scale_from in names]
        if unscaled := len(self._points) - len(points):
            self._notes.append(f"{unscaled} points are left out with their scale factors")
        return Laid(points, self._at - self._start, self._notes)

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
                    self._notes.append(f"{prefix}{each['name']} and what follows do not fit")
                return False
            if len(self._points) >= self._room:
                self._notes.append(f"there are too many points: {prefix}{each['name']} is left out")
                return False
            if (keys := _keys(each, known)) is not None:
                self._points.append(Point(prefix + each["name"], TABLE, self._at, **keys))
            self._at += each["size"]
        return all(self._lay_all(inner, prefix, known) for inner in group.get("groups", ()))

    def _lay_all(self, group: Mapping[str, Any], prefix: str, scales: Mapping[str, str]) -> bool:
        """Lay a group as often as it is repeated; return False if one does not fit."""
        name, count = f"{prefix}{group['name']}", group.get("count", 1)
        if count == 0:
            count = self._as_many_as_fit(group, name)
        elif isinstance(count, str):
            count = self._counts.get(count, 0)
        if "count" not in group:
            return self._lay(group, f"{name}.", scales)
        return all(self._lay(group, f"{name}.{at}.", scales) for at in range(1, count + 1))

    def _as_many_as_fit(self, group: Mapping[str, Any], name: str) -> int:
        size = _size(group)
        count, rest = divmod(self._stop - self._at, size)
        if rest:
            self._notes.append(
                f"{name} takes {size} registers each, and {self._stop - self._at} is not a multiple"
            )
        return count


def _size(group: Mapping[str, Any]) -> int:
    """Return the registers of a group whose inner groups are not repeated."""
    own: int = sum(each["size"] for each in group["points"])
    return own + sum(_size(inner) for inner in group.get("groups", ()))


def counters_of(group: Mapping[str, Any]) -> dict[str, int]:
    """
    Return the top-level points by which groups are repeated: name -> offset from the id.

    The definitions of SunSpec name no others.
    """
    wanted = set(_counted_by(group))
    found, at = {}, 0
    for each in group["points"]:
        if each["name"] in wanted:
            found[each["name"]] = at
        at += each["size"]
    return {name: at for name, at in found.items() if at < TABLE_SIZE}


def _counted_by(group: Mapping[str, Any]) -> Iterator[str]:
    for inner in group.get("groups", ()):
        if isinstance(count := inner.get("count"), str):
            yield count
        yield from _counted_by(inner)


# --- one point ---------------------------------------------------------------------------


def _keys(given: Mapping[str, Any], scales: Mapping[str, str]) -> dict[str, Any] | None:
    """Return the keys of a point but name and place; None for a padding."""
    kind, size = given["type"], given["size"]
    if kind == "pad":
        return None
    keys = {
        "access": "read_write" if given.get("access") == "RW" else "read",
        "units": given.get("units", "").strip(),
        "description": _text(given.get("desc") or given.get("label") or ""),
    }
    if kind == "string" and size <= LONGEST_TEXT:
        return {**keys, "type": f"string:{2 * size}", "encoding": "utf-8", "missing": "sunspec"}
    if kind not in _TYPES:  # an IPv6 address, or a long text
        return {**keys, "count": size}
    keys |= _TYPES[kind]
    if kind.startswith(("enum", "bitfield")):
        return keys | _named(kind, given.get("symbols") or (), 16 * size)
    return keys | _scale(given.get("sf"), scales)


def _named(kind: str, symbols: Any, width: int) -> dict[str, Any]:
    """Return the states or the bits of a point."""
    names: dict[int, str] = {}
    for each in symbols:
        number, name = each["value"], each["name"]
        if kind.startswith("bitfield") and not 0 <= number < width:
            continue
        names[number] = name if name not in names.values() else f"{name}_{number}"
    if not names:
        return {}
    return {"states" if kind.startswith("enum") else "bits": names}


def _scale(given: int | str | None, scales: Mapping[str, str]) -> dict[str, Any]:
    if isinstance(given, int):
        return {"scale": 10**given if given >= 0 else float(f"1e{given}")}
    return {} if given is None or given not in scales else {"scale_from": scales[given]}


def _text(text: str) -> str:
    words = " ".join(text.split())
    return "".join(each for each in words if each.isprintable())[:MAX_DESCRIPTION]
