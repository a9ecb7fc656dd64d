"""
The units of a server, with their tables and points, as a page shows them.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

from ...device.device import Device
from ...maps.point import Point
from ...protocol.tables import TABLES
from ...server.units import SERVER_ITSELF
from ..faults.server import Server

__all__ = ["CanHold", "ShownServer", "ShownUnit", "shown_of"]


@runtime_checkable
class CanHold(Protocol):
    """A device that computes values, and can hold them."""

    def movement(self, point: Point) -> bool | None:
        """Return True if a point moves, False if it is held, None if it never moves."""
        ...

    def hold(self, point: Point, *, is_on: bool) -> None:
        """
        Hold a moving point at its value, or let it move again.

        Raises:
            ValueError: the point never moves.
        """
        ...


@dataclass(frozen=True)
class ShownUnit:
    """
    One device.

    Attributes:
        number: 0..255; None for a device that answers every unit.
        name, description: the texts in its device file; empty without a device file.
        points: the named values of the device.
    """

    number: int | None
    device: Device
    name: str
    description: str
    points: tuple[Point, ...]

    def movement(self, point: Point) -> bool | None:
        """Return True if a point moves, False if it is held, None if it never moves by itself."""
        return self.device.movement(point) if isinstance(self.device, CanHold) else None

    @cached_property
    def _by_address(self) -> dict[str, list[Point]]:
        found: dict[str, list[Point]] = {}
        for each in sorted(self.points, key=_place):
            found.setdefault(each.table, []).append(each)
        return found

    def points_from(self, table: str, address: int) -> Iterator[Point]:
        """Yield the points of a table that begin at or after an address, in order."""
        points = self._by_address.get(table, [])
        yield from points[bisect_left(points, (table, address), key=_place) :]

    def as_json(self) -> dict[str, Any]:
        mapping = self.device.mapping
        tables = {table: getattr(mapping, table).ranges for table in TABLES}
        return {
            "number": self.number,
            "name": self.name,
            "description": self.description,
            "tables": {
                table: [[each.start, each.stop] for each in ranges]
                for table, ranges in tables.items()
                if ranges
            },
            "points": [_point_as_json(each) for each in self.points],
        }


def _place(point: Point) -> tuple[str, int]:
    return point.table, point.address


def _point_as_json(point: Point) -> list[Any]:
    many = f" x {point.count}" if point.count > 1 else ""
    order = "" if point.order == "ABCD" else f" {point.order}"
    kind = f"{point.type or 'bit'}{order}{many}"
    return [
        point.name,
        point.table,
        point.address,
        kind,
        point.units,
        point.access,
        point.description,
    ]


@dataclass(frozen=True)
class ShownServer:
    """
    All devices of a server.

    Attributes:
        given: the devices of the server; if the server has other ones, this object is out of date.
    """

    given: Device | Mapping[int, Device]
    units: dict[int | None, ShownUnit]

    def as_json(self) -> list[dict[str, Any]]:
        return [unit.as_json() for unit in self.units.values()]

    def units_of(self, number: int, *, is_line: bool) -> list[int | None]:
        """Return the units that a request addresses, by its unit and kind of connection."""
        if is_line and number == 0:
            return list(self.units)
        if None in self.units:
            return [None]
        # The server itself is its only device (messaging guide, 4.4.2).
        if len(self.units) == 1 and number in SERVER_ITSELF and not is_line:
            return list(self.units)
        return [number] if number in self.units else []


def shown_of(server: Server) -> ShownServer:
    """Return the devices that a server has now."""
    given = server.devices
    devices = {None: given} if isinstance(given, Device) else dict(sorted(given.items()))
    return ShownServer(given, {number: _unit(number, device) for number, device in devices.items()})


def _unit(number: int | None, device: Device) -> ShownUnit:
    """Return a unit; only devices of device files have names."""
    name, description = (str(getattr(device, key, "")) for key in ("name", "description"))
    return ShownUnit(number, device, name, description, tuple(device.points.values()))
