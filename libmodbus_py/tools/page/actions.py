"""
Handles the requests of a page: set a value, switch a fault.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from ...maps.point import Point
from ...protocol.checks import integer
from ...protocol.tables import TABLE_SIZE, TABLES
from ..faults.fault import Fault
from .setting import readings_at, set_cells, set_point
from .shown import CanHold, ShownUnit
from .source import Action

if TYPE_CHECKING:
    from .fault_list import FaultList
    from .log import Log

__all__ = ["Actions", "Changed"]

Given = Mapping[str, Any]

# The settings of a fault that a page can choose.
SETTINGS = ("kind", "function", "every", "probability", "seconds", "code", "length")


class Changed(Protocol):
    """
    The parts of a server that the requests change.

    Attributes:
        log: records the values that are set.
        faults: the faults to switch.
    """

    log: Log
    faults: FaultList

    def unit(self, number: object) -> ShownUnit:
        """
        Return the unit of a number.

        Raises:
            ValueError: there is no such unit.
        """
        ...


class Actions:
    """
    Functions by path: each takes the JSON object of a request, and returns that of the response.

    They raise TypeError, ValueError or KeyError if the object is wrong or lacks a key.
    """

    def __init__(self, source: Changed) -> None:
        self._source = source
        self.by_path: dict[str, Action] = {
            "/value": self._set,
            "/readings": self._read,
            "/hold": self._hold,
            "/fault": self._switch,
            "/faults": self._add,
        }

    def _hold(self, given: Given) -> None:
        unit = self._source.unit(given["unit"])
        point = _point(unit, given)
        if not isinstance(unit.device, CanHold):
            raise ValueError(f"{point.name} never moves by itself")
        unit.device.hold(point, is_on=given["on"] is True)

    def _set(self, given: Given) -> None:
        unit, text = self._source.unit(given["unit"]), given["text"]
        if not isinstance(text, str):
            raise TypeError("text must be a string")
        if "point" in given:
            point = _point(unit, given)
            set_point(unit, point, text)
            self._note(unit, point.table, point.cells)
        else:
            table, address = _table(given["table"]), _address("address", given["address"])
            cells = set_cells(unit, table, address, text, given["type"], given["order"])
            self._note(unit, table, cells)

    def _note(self, unit: ShownUnit, table: str, cells: range) -> None:
        self._source.log.wrote(unit.number, table, cells.start, cells.stop, "this page")

    def _read(self, given: Given) -> object:
        unit = self._source.unit(given["unit"])
        return readings_at(unit, _table(given["table"]), _address("address", given["address"]))

    def _switch(self, given: Given) -> None:
        number = integer("number", given["number"], 0, 1_000_000_000)
        self._source.faults.turn(number, is_on=given["on"] is True)

    def _add(self, given: Given) -> None:
        unit = None if given["unit"] is None else self._source.unit(given["unit"]).number
        fault = Fault(**{name: given[name] for name in SETTINGS if given.get(name) is not None})
        self._source.faults.add(unit, fault)


def _point(unit: ShownUnit, given: Given) -> Point:
    point = unit.points[integer("point", given["point"], 0, len(unit.points) - 1)]
    if point.name != given["name"]:
        raise ValueError("this point no longer exists")
    return point


def _table(name: object) -> str:
    if not isinstance(name, str) or name not in TABLES:
        raise ValueError(f"table must be one of {', '.join(TABLES)}")
    return name


def _address(name: str, value: object) -> int:
    return integer(name, value, 0, TABLE_SIZE)
