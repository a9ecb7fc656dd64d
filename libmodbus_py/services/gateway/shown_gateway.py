"""
A gateway as a page shows it: its lines, the units behind them, its clients, and a log.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from ...ports.trace import Traced
from ...protocol.pdu.function_codes import REQUESTS
from ...tools.page.log import Log, request_name
from ...tools.page.samples import Samples
from ...tools.page.shown import ShownServer
from ...tools.page.table_source import Older
from ...tools.page.tables import SPARK, Column, PageTable, cell_text
from .gateway import Gateway
from .statistics import LineStatistics, UnitStatistics

__all__ = ["ClientCount", "ShownGateway"]

MOST_ASKING = 2000
"""Clients, units and functions that are counted; the first is dropped for one more."""

# Seconds between two samples of a line.
SAMPLED = 1.0

NOTHING = ShownServer({}, {})


class ShownGateway:
    """
    See `Shown` of the page.

    Args:
        title: the name of the gateway.
        gateway: its trace must call `note`.
    """

    kind = "gateway"
    older: Older | None = None

    def __init__(self, title: str, gateway: Gateway) -> None:
        self.title = title
        self._gateway = gateway
        self.log: Log = Log(lambda: NOTHING)
        self._lines = LinesTable(gateway)
        self._clients = ClientsTable()
        self.tables: Sequence[PageTable] = (self._lines, UnitsTable(gateway), self._clients)

    def note(self, traced: Traced) -> None:
        """Take what a trace is called with; quickly, because the gateway waits."""
        self.log.note(traced)
        self._clients.note(traced)

    def figures(self) -> Mapping[str, float]:
        self._lines.sample()
        server, traffic = self._gateway.statistics, self._gateway.traffic
        lines = traffic.lines.copy().values()
        return {
            "clients": server.connections,
            "requests": traffic.requests,
            "waiting": sum(each.waiting for each in lines),
            "refused": traffic.refused + traffic.no_route + traffic.malformed,
            "down": sum(bool(each.trouble) for each in lines),
        }


class LinesTable:
    """See `PageTable`: each line, its queue and its state."""

    name: str = "lines"
    title: str = "Lines"
    columns: Sequence[Column] = (
        Column("line", "row"),
        Column("state", "state"),
        Column("since", "since", is_wide=True),
        Column("waiting", "number"),
        Column("in flight", "number", is_wide=True),
        Column("rate", "spark"),
        Column("requests", "number", is_wide=True),
        Column("answers", "number", is_wide=True),
        Column("full", "number", is_wide=True),
    )

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._rows: list[LineStatistics] = []
        self._samples: dict[str, tuple[Samples, int]] = {}
        self._sampled = 0.0

    def sample(self) -> None:
        """Count the requests of each line since the last sample."""
        now = time.time()
        if (passed := now - self._sampled) < SAMPLED:
            return
        before, self._samples, self._sampled = self._samples, {}, now
        for each in self.rows():
            count = each.connection.requests
            samples, last = before.get(each.url) or (Samples(SPARK), count)
            samples.add(now, max(0, count - last) / passed)
            self._samples[each.url] = samples, count

    def rows(self) -> list[LineStatistics]:
        rows = list(self._gateway.traffic.lines.copy().values())
        if len(rows) != len(self._rows) or any(
            a is not b for a, b in zip(rows, self._rows, strict=True)
        ):
            self._rows = rows
        return self._rows

    def words(self, row: LineStatistics) -> str:
        return row.url.lower()

    def is_trouble(self, row: LineStatistics) -> bool:
        return bool(row.trouble)

    def stamp(self, row: LineStatistics) -> object:
        return row.connection.requests, row.waiting, row.in_flight, row.trouble, self._sampled

    def cells(self, row: LineStatistics) -> list[Any]:
        samples = self._samples.get(row.url)
        state = "down" if row.trouble else "open" if row.connection.connects else "new"
        return [
            ["", cell_text(row.url)],
            [state, cell_text(row.trouble.rpartition("): ")[2]), cell_text(row.trouble)],
            round(row.since, 1),
            row.waiting,
            row.in_flight,
            [] if samples is None else samples[0].spark(SPARK),
            row.connection.requests,
            row.connection.responses,
            row.full,
        ]


class UnitsTable:
    """See `PageTable`: each unit that requests were sent to, and whether it answers."""

    name: str = "units"
    title: str = "Units"
    columns: Sequence[Column] = (
        Column("unit", "row"),
        Column("state", "state"),
        Column("requests", "number"),
        Column("answers", "number", is_wide=True),
        Column("exceptions", "number", is_wide=True),
        Column("timeouts", "number"),
        Column("invalid", "number", is_wide=True),
        Column("resting", "number", is_wide=True),
        Column("cached", "number", is_wide=True),
        Column("mean", "number", is_wide=True),
    )

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._rows: list[tuple[str, int, UnitStatistics]] = []

    def rows(self) -> list[tuple[str, int, UnitStatistics]]:
        rows = [
            (line.url, number, unit)
            for line in self._gateway.traffic.lines.copy().values()
            for number, unit in sorted(line.units.copy().items())
        ]
        if [each[:2] for each in rows] != [each[:2] for each in self._rows]:
            self._rows = rows
        return self._rows

    def words(self, row: tuple[str, int, UnitStatistics]) -> str:
        return f"{row[0]} unit {row[1]}".lower()

    def is_trouble(self, row: tuple[str, int, UnitStatistics]) -> bool:
        return row[2].is_silent

    def stamp(self, row: tuple[str, int, UnitStatistics]) -> object:
        unit = row[2]
        return unit.requests, unit.answers, unit.resting, unit.cached, unit.is_silent

    def cells(self, row: tuple[str, int, UnitStatistics]) -> list[Any]:
        url, number, unit = row
        mean = f"{unit.seconds / unit.answers * 1000:.1f} ms" if unit.answers else ""
        state = "silent" if unit.is_silent else "answers" if unit.answers else "new"
        return [
            [cell_text(url), f"unit {number}"],
            [state, f"{unit.resting} refused meanwhile" if unit.is_silent else ""],
            unit.requests,
            unit.answers,
            unit.exceptions,
            unit.timeouts,
            unit.invalid,
            unit.resting,
            unit.cached,
            mean,
        ]


class ClientCount:
    """
    The requests of one client with one function to one unit.

    Attributes:
        host, unit, function: of the requests.
        requests, exceptions: their number, and that of exceptions among the responses.
        time: of the last request, in seconds since the epoch.
    """

    __slots__ = ("exceptions", "function", "host", "requests", "time", "unit")

    def __init__(self, host: str, unit: int, function: int) -> None:
        self.host: str = host
        self.unit: int = unit
        self.function: int = function
        self.requests: int = 0
        self.exceptions: int = 0
        self.time: float = 0.0


class ClientsTable:
    """See `PageTable`: which client asks which unit with which function, and how often."""

    name: str = "clients"
    title: str = "Clients"
    columns: Sequence[Column] = (
        Column("client", "row"),
        Column("function", "note"),
        Column("requests", "number"),
        Column("exceptions", "number", is_wide=True),
        Column("last", "age", is_wide=True),
    )

    def __init__(self) -> None:
        self._asking: dict[tuple[str, int, int], ClientCount] = {}
        self._rows: list[ClientCount] = []

    def note(self, traced: Traced) -> None:
        """Count a request or a response."""
        if traced.unit is None or traced.function is None:
            return
        host = _host(traced.peer or "")
        key = host, traced.unit, traced.function & 0x7F
        found = self._asking.get(key)
        if traced.direction == "sent":
            if found is not None and traced.function & 0x80:
                found.exceptions += 1
            return
        if found is None:
            if len(self._asking) >= MOST_ASKING:
                self._asking.pop(next(iter(self._asking)), None)
            found = self._asking[key] = ClientCount(*key)
        found.requests += 1
        found.time = traced.time

    def rows(self) -> list[ClientCount]:
        rows = sorted(self._asking.copy().values(), key=_asking_order)
        if rows != self._rows:
            self._rows = rows
        return self._rows

    def words(self, row: ClientCount) -> str:
        words = f"{row.host} unit {row.unit} function {row.function} {_function(row)}"
        return words.lower()

    def is_trouble(self, row: ClientCount) -> bool:
        return row.exceptions > 0

    def stamp(self, row: ClientCount) -> object:
        return row.requests, row.exceptions

    def cells(self, row: ClientCount) -> list[Any]:
        return [
            [cell_text(row.host), f"unit {row.unit}"],
            f"{row.function} {_function(row)}",
            row.requests,
            row.exceptions,
            round(row.time, 1),
        ]


def _asking_order(row: ClientCount) -> tuple[str, int, int]:
    return row.host, row.unit, row.function


def _function(row: ClientCount) -> str:
    """Return the name of a function, such as "read holding registers"."""
    known = REQUESTS.get(row.function)
    return "" if known is None else request_name(known)


def _host(peer: str) -> str:
    """Return the host of "HOST:PORT", or the path of a serial port."""
    return peer if peer.startswith("/") else peer.rpartition(":")[0].strip("[]")
