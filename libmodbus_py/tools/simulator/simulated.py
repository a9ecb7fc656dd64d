"""Simulated devices: they have named points, and can take over the values of former devices."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...device.access import Access, values_at
from ...device.device import Device
from ...device.hooks import Hook
from ...device.mapping import Mapping as Tables
from ...device.named_values import RuledCells, known_point
from ...maps.point import Point
from ...maps.point_plan import sources_of
from ...maps.register_map import RegisterMap
from ...protocol.mistakes import WrongValue, placed
from ...protocol.tables import TABLES
from ..faults.fault import Fault
from .movements import Movements, SimulatedPoint


class SimulatedDevice(Device):
    """
    A device of a device file.

    Attributes:
        name, description: as in the file; "" if missing.
        points: the points of the tables, by name: those of its register maps, and its own. Points
            without a name are named after their table and address, such as
            "holding_registers_100".
    """

    def __init__(
        self,
        mapping: Tables,
        *,
        name: str,
        description: str,
        definition: object,
        contents: list[SimulatedPoint],
        movements: Movements,
        **options: Any,
    ) -> None:
        self._contents = contents
        self._moving = [point for point in contents if point.behaviour]
        points = [
            # A value that moves could be written, but would be lost at the next read.
            replace(point.point, access="read")
            if movements.movement(point.table, point.span)
            else point.point
            for point in contents
            if point.table in TABLES
        ]
        spans: dict[str, list[range]] = {}
        for point in self._moving:
            spans.setdefault(point.table, []).append(point.span)
        self._refresh_hook = Hook(self._refresh_access, **spans) if spans else None
        super().__init__(mapping, points=RegisterMap(points), **options)
        self.name: str = name
        self.description: str = description
        self._definition = definition
        self._movements = movements
        self._first_fifos = {address: tuple(queue) for address, queue in self.fifos.items()}

    def _ruled_cells(self) -> Iterable[RuledCells]:
        yield from super()._ruled_cells()
        for point in self._contents:
            if point.file:
                yield RuledCells(point.area, point.span, point.point.access, point.point)

    def __getitem__(self, name: str) -> Any:
        point = known_point(self.points, name)
        with self.mapping:
            self._refresh(point, *sources_of([point], self.points).values())
            return super().__getitem__(name)

    def update(self, values: Mapping[str, Any]) -> None:
        with self.mapping:
            for point in [self.points[name] for name in values if name in self.points]:
                if self.movement(point):
                    raise WrongValue.about(point.name, "the device computes this value itself")
                self._refresh(*sources_of([point], self.points).values())
            super().update(values)

    def _refresh(self, *points: Point) -> None:
        for point in points:
            self._movements.refresh(point.table, point.address, len(point.cells))

    def _refresh_access(self, access: Access) -> None:
        self._movements.refresh(access.table, access.address, access.count)

    def movement(self, point: Point) -> bool | None:
        """Return True if a point moves, False if it is held, None if it never moves."""
        with self.mapping:
            return self._movements.movement(point.table, point.cells)

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
            self._movements.hold(point.table, point.cells, is_on=is_on)

    def set_first_values(self) -> None:
        """Set the values that the device file gives; errors have the path of their key."""
        # Points that scale others come first.
        scales = sources_of(self.points.values(), self.points)
        order = {name: at for at, name in enumerate(scales)}
        points = [point for point in self._contents if point.value is not None]
        for point in sorted(points, key=lambda point: order.get(point.point.name, len(order))):
            try:
                if point.file:
                    cells = tuple(point.point.encode(point.value))
                    self.files[point.file].write(point.span.start, cells)
                else:
                    super().update({point.point.name: point.value})
            except (TypeError, ValueError) as error:
                reason = placed(error, ()).reason
                about = reason.removeprefix("value ")
                between = ": " if about == reason else " "
                raise WrongValue(point.source, about, between) from None
        for at, point in enumerate(self._contents):
            cells = self._present(point)
            self._contents[at] = replace(point, cells=cells if any(cells) else ())

    def first_values(self) -> Iterator[Access]:
        """Yield the first values that are not 0, and the present ones of points that move."""
        for point in self._contents:
            if point.cells:
                yield _access(point, point.cells)
        for point in self._moving:
            yield _access(point, self._present(point))

    def _present(self, point: SimulatedPoint) -> tuple[Any, ...]:
        return values_at(_access(point), self.mapping, self.files) or ()

    def is_as(self, other: SimulatedDevice) -> bool:
        """Return True if the file describes both devices alike."""
        return self._definition == other._definition

    def take_state_of(self, before: SimulatedDevice) -> None:
        """Keep values that clients wrote, in ranges and queues that both files describe alike."""
        self._movements.take_state_of(before._movements)
        self.diagnostic_register: int = before.diagnostic_register
        identities = {point.identity for point in before._contents}
        with before.mapping, self.mapping:
            for point in self._contents:
                if point.identity in identities and point.file:
                    self.files[point.file].write(point.span.start, before._present(point))
                elif point.identity in identities:
                    table = getattr(self.mapping, point.table)
                    table[point.span.start : point.span.stop] = before._present(point)
            for address, first in self._first_fifos.items():
                if before._first_fifos.get(address) == first:
                    self.fifos[address] = before.fifos[address]


def _access(point: SimulatedPoint, values: tuple[Any, ...] = ()) -> Access:
    return Access(point.table, point.span.start, len(point.span), values, point.file)


@dataclass(frozen=True)
class Simulation:
    """
    The content of a device file.

    ``Server(plant.devices, faults=plant.faults)`` serves ``plant = load("plant.toml")``.

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

    def with_state_of(self, before: Simulation) -> Simulation:
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
                devices[unit].take_state_of(before.by_unit[unit])
        return replace(self, by_unit=devices)
