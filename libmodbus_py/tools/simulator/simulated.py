"""
Simulated devices: they have named points, and can take over the values of former devices.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from ...device.access import Access
from ...device.caller import values_at
from ...device.device import Device
from ...device.hooks import Hook
from ...device.mapping import Mapping as Tables
from ...device.named_values import RuledCells, known_point
from ...maps.point import Point
from ...maps.point_plan import sources_of
from ...maps.register_map import RegisterMap
from ...protocol.mistakes import WrongValue
from ...protocol.tables import TABLES
from ..faults.fault import Fault
from .clockwork import Clockwork, SimulatedPoint

__all__ = ["SimulatedDevice", "Simulation"]


class SimulatedDevice(Device):
    """
    A device of a device file.

    Attributes:
        name, description: as in the file; "" if missing.
    """

    def __init__(
        self,
        mapping: Tables,
        *,
        name: str,
        description: str,
        definition: object,
        contents: list[SimulatedPoint],
        mapped: Mapping[str, Point],
        clockwork: Clockwork,
        **options: Any,
    ) -> None:
        self._contents = contents  # which make the rules of the device, and so do its maps
        self._mapped = mapped
        moving = [each for each in contents if each.behaviour]
        hook = _refreshing(clockwork, moving) if moving else None
        super().__init__(mapping, before_read=hook, **options)
        self.has_points = True
        self.name: str = name
        self.description: str = description
        self._definition = definition
        self._clockwork = clockwork
        self._first_fifos = {address: tuple(queue) for address, queue in self.fifos.items()}

    @property
    def points(self) -> RegisterMap:
        """
        The points of the tables, by name: those of its register maps, and its own.

        Points without a name are named after their table and address, such as
        "holding_registers_100".
        """
        return self._all_points

    @cached_property
    def _all_points(self) -> RegisterMap:
        points = dict(self._mapped)
        own = [each for each in self._contents if each.table in TABLES and not each.is_mapped]
        for each in sorted(own, key=lambda each: not each.is_named):
            name = each.point.name
            while name in points:
                name += "_"
            points[name] = replace(each.point, name=name, access=each.access)
        return RegisterMap(points.values())

    def __getitem__(self, name: str) -> Any:
        point = known_point(self.points, name)
        with self.mapping:
            self._refresh(point, *sources_of([point], self.points).values())
            return super().__getitem__(name)

    def update(self, values: Mapping[str, Any]) -> None:
        with self.mapping:
            for name in values:
                point = self.points.get(name)
                if point is not None and self._clockwork.moves(point.table, point.cells):
                    raise WrongValue.about(name, "the device computes this value itself")
                if point is not None:
                    self._refresh(*sources_of([point], self.points).values())
            super().update(values)

    def _refresh(self, *points: Point) -> None:
        for point in points:
            self._clockwork.refresh(point.table, point.address, len(point.cells))

    def movement(self, point: Point) -> bool | None:
        """Return True if a point moves, False if it is held, None if it never moves."""
        with self.mapping:
            if self._clockwork.moves(point.table, point.cells):
                return True
            return False if self._clockwork.holds(point.table, point.cells) else None

    def hold(self, point: Point, *, is_on: bool) -> None:
        """
        Hold a moving point at its value, or let it go on as if it had never been held.

        Raises:
            ValueError: the point never moves.
        """
        with self.mapping:
            if self.movement(point) is None:
                raise WrongValue.about(point.name, "never moves by itself")
            self._refresh(point)
            self._clockwork.hold(point.table, point.cells, is_on=is_on)

    def _ruled_cells(self) -> Iterable[RuledCells]:
        for each in self._contents:
            cells = range(each.first, each.stop)
            yield RuledCells(each.area, cells, each.access, each.point)
        # Points that share cells with others are in pieces there, which have no bounds.
        whole = {id(each.point) for each in self._contents}
        for point in self._mapped.values():
            if point.has_bounds and id(point) not in whole:
                yield RuledCells.of(point)._replace(access=None)

    def first_values(self) -> Iterator[Access]:
        """
        Yield the first values that are not 0, and the values that behaviours compute now.

        Hold the mapping's lock.
        """
        for each in self._contents:
            if each.behaviour is not None or any(each.cells):
                count = each.stop - each.first
                access = Access(each.table, each.first, count, tuple(each.all_cells), each.file)
                if each.behaviour is not None:
                    present = values_at(access, self.mapping, self.files)
                    access = replace(access, values=present or ())
                yield access

    def is_as(self, other: SimulatedDevice) -> bool:
        """Return True if the file describes both devices alike."""
        return self._definition == other._definition

    def go_on_from(self, before: SimulatedDevice) -> None:
        """Take over values that clients wrote into ranges and queues alike in both files."""
        self._clockwork.go_on_from(before._clockwork)
        self.diagnostic_register: int = before.diagnostic_register
        known = {each.identity for each in before._contents}
        with before.mapping, self.mapping:
            for each in self._contents:
                if each.identity in known and each.table in TABLES:
                    self._copy(before, each)
                elif each.identity in known:
                    self._copy_records(before, each)
            for address, first in self._first_fifos.items():
                if before._first_fifos.get(address) == first:
                    self.fifos[address] = before.fifos[address]

    def _copy(self, before: SimulatedDevice, each: SimulatedPoint) -> None:
        old = getattr(before.mapping, each.table)
        new = getattr(self.mapping, each.table)
        first, stop = each.first, each.stop
        # Equal cells are not written, because untouched pages of zeros take no memory.
        if _cells(old, first, stop) != _cells(new, first, stop):
            new[first:stop] = old[first:stop]

    def _copy_records(self, before: SimulatedDevice, each: SimulatedPoint) -> None:
        first, length = each.first, each.stop - each.first
        written = before.files[each.file].read(first, length)
        self.files[each.file].write(first, tuple(written))


def _refreshing(clockwork: Clockwork, moving: Iterable[SimulatedPoint]) -> Hook:
    """Return the hook that computes moving values when they are read."""

    def refresh(access: Access) -> None:
        clockwork.refresh(access.table, access.address, access.count)

    ranges: dict[str, list[range]] = {}
    for each in moving:
        ranges.setdefault(each.table, []).append(range(each.first, each.stop))
    return Hook(refresh, **ranges)


def _cells(table: Any, first: int, stop: int) -> bytes:
    start = table.addresses.start
    return bytes(table.view[first - start : stop - start])


@dataclass(frozen=True)
class Simulation:
    """
    The content of a device file; ``Server(*load("plant.toml"))`` serves it.

    Attributes:
        by_unit: devices by unit; None for one that answers every unit.
        faults: faults by unit; those of None are for every unit.
        files: paths of the register maps used.
    """

    by_unit: dict[int | None, SimulatedDevice]
    faults: dict[int | None, list[Fault]]
    files: tuple[str, ...] = ()

    @property
    def devices(self) -> SimulatedDevice | dict[int, SimulatedDevice]:
        """Devices by unit, or one device that answers every unit."""
        by_unit = {unit: device for unit, device in self.by_unit.items() if unit is not None}
        return self.by_unit.get(None, by_unit)

    def __iter__(self) -> Iterator[Any]:
        """Yield the devices and the faults, which are the arguments of `Server`."""
        yield self.devices
        yield self.faults

    def going_on_from(self, before: Simulation) -> Simulation:
        """
        Return a simulation that keeps the devices of another one where the files describe a unit
        alike.

        In other units, values that clients wrote are kept in ranges whose addresses, type and first
        values are alike in both files; moving values continue. The other one must not be used any
        more.
        """
        devices = dict(self.by_unit)
        for unit in devices.keys() & before.by_unit.keys():
            if devices[unit].is_as(before.by_unit[unit]):
                devices[unit] = before.by_unit[unit]
            else:
                devices[unit].go_on_from(before.by_unit[unit])
        return replace(self, by_unit=devices)
