"""
The requests of a page: choose another view, set a value, switch a fault.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ...protocol.checks import integer
from ...protocol.tables import TABLE_SIZE, TABLES
from ...server.faults.fault import Fault
from .setting import readings_at, set_cells, set_point
from .shown import ShownUnit
from .streams import Streams

__all__ = ["Actions"]

Given = Mapping[str, Any]

# The settings of a fault that a page can give.
SETTINGS = ("kind", "function", "every", "probability", "seconds", "code", "length")


class Actions:
    """
    Functions by path: each takes the JSON object of a request, and returns that of the response.

    They raise TypeError, ValueError or KeyError if the object is wrong or lacks a key.
    """

    def __init__(self, streams: Streams) -> None:
        self._streams = streams
        self.by_path: dict[str, Callable[[Given], object]] = {
            "/view": self._look,
            "/value": self._set,
            "/readings": self._read,
            "/fault": self._switch,
            "/faults": self._add,
        }

    def _look(self, given: Given) -> None:
        first, stop = (_address(name, given[name]) for name in ("first", "stop"))
        self._streams.look_at(given["stream"], given["unit"], given["what"], first, stop)

    def _set(self, given: Given) -> None:
        unit, text = self._streams.unit(given["unit"]), given["text"]
        if not isinstance(text, str):
            raise TypeError("text must be a string")
        if "point" in given:
            point = unit.points[integer("point", given["point"], 0, len(unit.points) - 1)]
            if point.name != given["name"]:
                raise ValueError("there is no such point any more")
            set_point(unit, point, text)
            self._note(unit, point.table, point.cells)
        else:
            table, address = _table(given["table"]), _address("address", given["address"])
            cells = set_cells(unit, table, address, text, given["type"], given["order"])
            self._note(unit, table, cells)

    def _note(self, unit: ShownUnit, table: str, cells: range) -> None:
        self._streams.log.wrote(unit.number, table, cells.start, cells.stop, "this page")

    def _read(self, given: Given) -> object:
        unit = self._streams.unit(given["unit"])
        return readings_at(unit, _table(given["table"]), _address("address", given["address"]))

    def _switch(self, given: Given) -> None:
        number = integer("number", given["number"], 0, 1_000_000_000)
        self._streams.faults.turn(number, is_on=given["on"] is True)

    def _add(self, given: Given) -> None:
        unit = None if given["unit"] is None else self._streams.unit(given["unit"]).number
        fault = Fault(**{name: given[name] for name in SETTINGS if given.get(name) is not None})
        self._streams.faults.add(unit, fault)


def _table(name: object) -> str:
    if not isinstance(name, str) or name not in TABLES:
        raise ValueError(f"table must be one of {', '.join(TABLES)}")
    return name


def _address(name: str, value: object) -> int:
    return integer(name, value, 0, TABLE_SIZE)
