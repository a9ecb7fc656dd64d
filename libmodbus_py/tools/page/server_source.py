"""
The source of the page of a server: units, values, log, counters and faults.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ...maps.point import Point
from ...protocol.checks import integer, number
from ...protocol.tables import TABLE_SIZE, TABLES
from ...protocol.values import ORDERS, TYPES
from ..faults.fault import KINDS, OPTIONAL
from ..faults.server import Server
from .actions import Actions
from .fault_list import FaultList
from .log import Log
from .samples import Samples, charted
from .shown import ShownServer, ShownUnit, shown_of
from .source import Action, Changes, Download, PageView
from .views import CellsView, PointsView

__all__ = ["ServerSource"]

# The choices that the page offers; for each kind of fault, the setting that it needs, if any.
WORDS: dict[str, Any] = {
    "types": list(TYPES),
    "orders": list(ORDERS),
    "kinds": {
        kind: setting or next((each for each in OPTIONAL.get(kind, ()) if each == "length"), None)
        for kind, setting in KINDS.items()
    },
}

MOST_SAMPLED = 5000
"""The most points whose samples are kept."""

# The view of a page: unit, table or "points", the first of them, and the end.
Key = tuple["int | None", str, int, int]


class ServerSource:
    """
    The `PageSource` of a server.

    Args:
        server: the server, whose devices may be replaced meanwhile.

    Attributes:
        log, faults: shown on all pages.
    """

    document = "page.html"

    def __init__(self, server: Server) -> None:
        self._server = server
        self._shown = shown_of(server)
        self.log: Log = Log(lambda: self._shown)
        self.faults: FaultList = FaultList(server.fault_switch)
        self.actions: Mapping[str, Action] = {
            **Actions(self).by_path,
            "/history": self._history,
        }
        self._samples: dict[tuple[int | None, str], Samples] = {}
        self.downloads: Mapping[str, Download] = {"/log.csv": self.log.download}
        self._counters: dict[str, int] = {}
        self._told = (0, 0, -1)  # the last transaction, write and version of the faults

    def structure(self) -> ShownServer:
        """Return the devices that the server has now."""
        if self._server.devices is not self._shown.given:
            self._shown = shown_of(self._server)
        return self._shown

    def unit(self, number: object) -> ShownUnit:
        """
        Return the unit of a number.

        Raises:
            ValueError: there is no such unit.
        """
        units = self.structure().units
        found = units.get(number) if isinstance(number, int | None) else None
        if found is None:
            raise ValueError(f"there is no unit {number}")
        return found

    def described(self) -> Changes:
        return {"units": self._shown.as_json()}

    def everything(self) -> Changes:
        return {
            "log": self.log.rows(),
            "written": self.log.written(),
            "counters": self._counters,
            "faults": self.faults.as_json(),
            "words": WORDS,
        }

    def changes(self) -> Changes:
        passed, written, version = self._told
        found: Changes = {"log": self.log.rows(passed), "written": self.log.written(written)}
        counters: dict[str, int] = {
            name: value
            for name, value in asdict(self._server.statistics).items()
            if isinstance(value, int)
        }
        found["counters"] = {
            name: value for name, value in counters.items() if value != self._counters.get(name)
        }
        self._counters = counters
        if version != (latest := self.faults.version):
            version, found["faults"] = latest, self.faults.as_json()
        if found["log"]:
            passed = found["log"][-1].number
        if found["written"]:
            written = found["written"][-1].number
        self._told = passed, written, version
        return {name: value for name, value in found.items() if value or name == "faults"}

    # --- history -------------------------------------------------------------------------------

    def _samples_of(self, unit: ShownUnit, point: Point) -> Samples:
        """Return the samples of a point; those of points not shown for longest make room."""
        key = unit.number, point.name
        samples = self._samples.pop(key, None) or Samples()
        while len(self._samples) >= MOST_SAMPLED:
            self._samples.pop(next(iter(self._samples)))
        self._samples[key] = samples
        return samples

    def _history(self, given: Mapping[str, Any]) -> Changes:
        row = given["row"]
        if not isinstance(row, list) or len(row) != 2 or not isinstance(row[1], str):
            raise ValueError("row must be a unit and a name")
        unit = self.unit(row[0])
        samples = self._samples.get((unit.number, row[1]))
        points = [each for each in unit.points if each.name == row[1]]
        if samples is None or not points:
            raise ValueError("this value no longer exists")
        now = time.time()
        since = now - number("seconds", given["seconds"], 1, 86_400)
        return charted(samples.pairs(since), now, points[0].units)

    # --- views ---------------------------------------------------------------------------------

    def key(self, given: Mapping[str, Any]) -> Key:
        first, stop = (integer(name, given[name], 0, TABLE_SIZE) for name in ("first", "stop"))
        unit, what = self.unit(given["unit"]), given["what"]
        if not isinstance(what, str) or (what != "points" and what not in TABLES):
            raise ValueError("what must be points or a table")
        return unit.number, what, first, stop

    def view(self, key: Key) -> PageView | None:
        number, what, first, stop = key
        unit = self._shown.units.get(number)
        if unit is None:  # the unit is gone
            return None
        if what == "points":
            return PointsView(unit, first, stop, self._samples_of)
        return CellsView(unit, what, first, stop)

    def is_current(self, view: PointsView | CellsView) -> bool:
        return view.unit is self._shown.units.get(view.unit.number)

    def named(self, key: Key) -> Changes:
        return {"unit": key[0], "what": key[1]}
