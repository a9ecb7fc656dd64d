"""
The source of the page of a server: units, values, log, counters and faults, and their changes.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

from ...device.named_values import cells_after
from ...maps.point import Point
from ...maps.writing import typed_register, typed_value, typed_values
from ...protocol.checks import integer, number
from ...protocol.plain import text_of
from ...protocol.tables import TABLE_SIZE, TABLES
from ...protocol.values import ORDERS, TYPES, readings, value_type
from ...server.server import Server
from ..faults.fault import KINDS, OPTIONAL, Fault
from ..simulator.simulated import SimulatedDevice
from .log import Log
from .samples import chart_of
from .streams import Action, Download, Tables
from .units import SAMPLED, ShownUnit, cell_rows, point_rows, shown_of

# Characters of a value that is typed, and faults of a server to which pages can add others.
MOST_TEXT = 2000
MOST_FAULTS = 200

# Seconds of the longest chart.
MOST_SECONDS = 86_400.0

# The choices that the page offers; for each kind of fault, the setting that it needs, if any.
WORDS: dict[str, Any] = {
    "types": list(TYPES),
    "orders": list(ORDERS),
    "kinds": {
        kind: setting or ("length" if "length" in OPTIONAL.get(kind, ()) else None)
        for kind, setting in KINDS.items()
    },
}

# The settings of a fault that a page can choose.
SETTINGS = ("kind", "function", "every", "probability", "seconds", "code", "length")

Given = Mapping[str, Any]

# Unit, table or "points", the first of them, and the end.
View = tuple["int | None", str, int, int]


def set_point(unit: ShownUnit, point: Point, text: str) -> None:
    """Set a point to the values in a text; raise ValueError if they are wrong or computed."""
    with unit.device.mapping as mapping:
        try:
            unit.device.update({point.name: typed_values(point, text)})
        except TypeError as error:
            raise ValueError(str(error)) from None
        _check_set(unit, point, cells_after(point, mapping))


def _set_cells(unit: ShownUnit, query: Given, text: str) -> Point:
    """Set cells from an address on to a value of a type, and return them as a point."""
    table, address = _table(query["table"]), _address(query)
    kind = None if TABLES[table].is_bits else query["type"]
    point = Point("value", table, address, type=kind, order=query["order"])  # type: ignore[arg-type]
    is_register = point.type == "uint16"
    value = typed_register(text) if is_register else typed_value(point, text)
    with unit.device.mapping as mapping:
        place, span = getattr(mapping, table), point.cells
        if not place.has(address, len(span)):
            raise ValueError(f"the device lacks {table} {address}..{span.stop - 1}")
        place[address : span.stop] = cells = point.cells_for([value])
        _check_set(unit, point, cells)
    return point


def _check_set(unit: ShownUnit, point: Point, cells: list[Any]) -> None:
    unit.refresh(point.table, point.cells)
    if cells_after(point, unit.device.mapping) != cells:
        raise ValueError("the device computes this value itself")


def _readings_at(unit: ShownUnit, table: str, address: int) -> list[dict[str, str]]:
    """Return type, order and text for each way to decode the cells from an address on."""
    texts: list[dict[str, str]] = []
    for registers in (1, 2, 4):
        with unit.device.mapping as mapping:
            place = getattr(mapping, table)
            if TABLES[table].is_bits or not place.has(address, registers):
                break
            cells = place[address : address + registers]
        for type, order, value in readings(cells):
            text = text_of(value, value_type(type, order=order))
            texts.append({"type": type, "order": order, "text": text})
    return texts


def _row(fault: Fault) -> dict[str, str]:
    """Return the kind, and all other settings, such as ``seconds 1.5, function 3``."""
    names = [field.name for field in fields(fault) if field.name != "kind"]
    options = {name: getattr(fault, name) for name in names}
    settings = ", ".join(
        f"{name} {value.hex(' ') if isinstance(value, bytes) else value}"
        for name, value in options.items()
        if value is not None
    )
    return {"kind": fault.kind, "settings": settings}


class ServerSource:
    """The `PageSource` of a server, whose devices may be replaced; `log` takes its trace."""

    script = "server.js"

    def __init__(self, server: Server) -> None:
        self._server = server
        self._shown_server = shown_of(server)
        self.log: Log = Log(lambda: self._shown_server)
        self.downloads: Mapping[str, Download] = {"/log.csv": self.log.download}
        self.actions: Mapping[str, Action] = {
            "/value": self._set,
            "/readings": self._read,
            "/hold": self._hold,
            "/fault": self._switch,
            "/faults": self._add,
            "/history": self._history,
        }

    def _units(self) -> dict[int | None, ShownUnit]:
        if self._server.devices is not self._shown_server.devices:
            self._shown_server = shown_of(self._server)
        return self._shown_server.units

    def _unit(self, query: Given) -> ShownUnit:
        units, number = self._units(), query["unit"]
        unit = units.get(number) if isinstance(number, int | None) else None
        if unit is None:
            raise ValueError(f"there is no unit {number}")
        return unit

    def common(self) -> Tables:
        counters = asdict(self._server.statistics)
        faults = sorted(self._server.fault_switch.states(), key=lambda state: state.number)
        return {
            "words": WORDS,
            "units": {_name(number): unit.row for number, unit in self._units().items()},
            "faults": {
                state.number: {"unit": state.unit, "is_on": state.is_on} | _row(state.fault)
                for state in faults
                if isinstance(state.fault, Fault)
            },
            "counters": {name: count for name, count in counters.items() if isinstance(count, int)},
            **self.log.tables(),
        }

    def view(self, query: Given) -> View:
        first, stop = (integer(name, query[name], 0, TABLE_SIZE) for name in ("first", "stop"))
        what = query["what"]
        if what != "points":
            _table(what)
        return self._unit(query).number, what, first, stop

    def tables_of(self, view: View) -> Tables:
        """Return a table whose name is that of the unit and of the table that are shown."""
        number, what, first, stop = view
        unit = self._shown_server.units.get(number)
        if unit is None:
            return {}
        if what == "points":
            rows = point_rows(unit, first, stop)
        else:
            rows = cell_rows(unit, what, first, stop)
        return {f"{_name(number)}/{what}": rows}

    def _history(self, query: Given) -> dict[str, Any]:
        row = query["row"]
        if not isinstance(row, list) or len(row) != 2 or not isinstance(row[1], str):
            raise ValueError("row must be a unit and a name")
        unit = self._unit({"unit": row[0]})
        samples = unit.samples.get(row[1])
        units = [point.units for point in unit.points if point.name == row[1]]
        if samples is None:
            raise ValueError("this value no longer exists")
        now = time.time()
        since = now - number("seconds", query["seconds"], 1, MOST_SECONDS)
        return chart_of(samples.pairs(since), now, units[0], SAMPLED)

    def _set(self, query: Given) -> None:
        unit, text = self._unit(query), query["text"]
        if not isinstance(text, str):
            raise TypeError("text must be a string")
        if len(text) > MOST_TEXT:
            raise ValueError(f"value must have at most {MOST_TEXT} characters")
        if "point" in query:
            point = _point(unit, query)
            set_point(unit, point, text)
        else:
            point = _set_cells(unit, query, text)
        self.log.note_write(unit.number, point.table, point.cells, "this page")

    def _read(self, query: Given) -> object:
        table = _table(query["table"])
        return {"readings": _readings_at(self._unit(query), table, _address(query))}

    def _hold(self, query: Given) -> None:
        unit = self._unit(query)
        point = _point(unit, query)
        if not isinstance(unit.device, SimulatedDevice):
            raise ValueError(f"{point.name} never moves by itself")
        unit.device.hold(point, is_on=query["on"] is True)

    def _switch(self, query: Given) -> None:
        switch = self._server.fault_switch
        number = integer("number", query["number"], 0, 1_000_000_000)
        states = [state for state in switch.states() if state.number == number]
        if not states:
            raise ValueError("this fault no longer exists")
        switch.turn(states[0], is_on=query["on"] is True)

    def _add(self, query: Given) -> None:
        switch = self._server.fault_switch
        unit = None if query["unit"] is None else self._unit(query).number
        fault = Fault(**{name: query[name] for name in SETTINGS if query.get(name) is not None})
        if len(switch.states()) >= MOST_FAULTS:
            raise ValueError(f"there are {MOST_FAULTS} faults already, which is the maximum")
        switch.switch_on(fault, unit=unit)


def _name(number: int | None) -> str:
    return "every" if number is None else str(number)


def _point(unit: ShownUnit, query: Given) -> Point:
    point = unit.points[integer("point", query["point"], 0, len(unit.points) - 1)]
    if point.name != query["name"]:
        raise ValueError("this point no longer exists")
    return point


def _table(name: object) -> str:
    if not isinstance(name, str) or name not in TABLES:
        raise ValueError(f"table must be one of {', '.join(TABLES)}")
    return name


def _address(query: Given) -> int:
    return integer("address", query["address"], 0, TABLE_SIZE)
