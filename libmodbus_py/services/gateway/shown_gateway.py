"""
A gateway as a page shows it: its lines, the units behind them, its clients, and a log.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from ...ports.hosts import host_of_peer
from ...ports.trace import Traced
from ...protocol.pdu.function_codes import REQUESTS
from ...tools.page.log import Log, request_name
from ...tools.page.row_history import RowHistory
from ...tools.page.shown import ShownServer
from ...tools.page.table_source import Older
from ...tools.page.tables import Column, PageTable, Series, cell_text
from .gateway import Gateway
from .statistics import LineStatistics, UnitStatistics

__all__ = ["ClientCount", "ShownGateway"]

MOST_ASKING = 2000
"""Clients, units and functions that are counted; the first is dropped for one more."""

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
        lines, units = LinesTable(gateway), UnitsTable(gateway)
        self._histories = (lines.history, units.history)
        self._clients = ClientsTable()
        self.tables: Sequence[PageTable] = (lines, units, self._clients)

    def note(self, traced: Traced) -> None:
        """Take what a trace is called with; quickly, because the gateway waits."""
        self.log.note(traced)
        self._clients.note(traced)
        self._sample()

    def _sample(self) -> None:
        """Sample numbers over time, whether a page is open or not."""
        for each in self._histories:
            each.sample()

    def figures(self) -> Mapping[str, float]:
        self._sample()
        server, traffic = self._gateway.statistics, self._gateway.traffic
        lines = traffic.lines.copy().values()
        return {
            "clients": server.connections,
            "requests": traffic.requests,
            "waiting": sum(each.waiting for each in lines),
            "refused": traffic.refused + traffic.no_route + traffic.malformed,
            "down": sum(bool(each.trouble) for each in lines),
        }


class LineCounts(NamedTuple):
    """Counters of a line, from which its numbers over time are made."""

    requests: int
    waiting: int


def _line_counts(line: LineStatistics) -> LineCounts:
    return LineCounts(line.connection.requests, line.waiting)


def _line_figures(before: LineCounts, now: LineCounts, passed: float) -> dict[str, float | None]:
    return {"rate": _rate(before.requests, now.requests, passed), "queue": now.waiting}


class LinesTable:
    """
    See `PageTable`: each line, its queue and its state.

    Attributes:
        history: requests a second, and how many wait.
    """

    name: str = "lines"
    title: str = "Lines"
    columns: Sequence[Column] = (
        Column("line", "row"),
        Column("state", "state"),
        Column("since", "since", is_wide=True),
        Column("waiting", "number"),
        Column("in flight", "number", is_wide=True),
        Column("rate", "spark"),
        Column("queue", "spark", is_wide=True),
        Column("requests", "number", is_wide=True),
        Column("answers", "number", is_wide=True),
        Column("full", "number", is_wide=True),
    )

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._rows: list[LineStatistics] = []
        self.history = RowHistory(
            self._named, _line_counts, _line_figures, {"rate": "requests/s", "queue": "requests"}
        )

    def _named(self) -> Iterator[tuple[tuple[str, str], LineStatistics]]:
        return (
            (("", cell_text(each.url)), each)
            for each in self._gateway.traffic.lines.copy().values()
        )

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
        return row.connection.requests, row.waiting, row.in_flight, row.trouble, self.history.at

    def cells(self, row: LineStatistics) -> list[Any]:
        name = "", cell_text(row.url)
        state = "down" if row.trouble else "open" if row.connection.connects else "new"
        return [
            [*name],
            [state, cell_text(row.trouble.rpartition("): ")[2]), cell_text(row.trouble)],
            round(row.since, 1),
            row.waiting,
            row.in_flight,
            self.history.spark(name, "rate"),
            self.history.spark(name, "queue"),
            row.connection.requests,
            row.connection.responses,
            row.full,
        ]

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return self.history.series(name, column)


UnitRow = tuple[str, int, UnitStatistics]


class UnitCounts(NamedTuple):
    """Counters of a unit, from which its numbers over time are made."""

    requests: int
    answers: int
    seconds: float


def _unit_counts(row: UnitRow) -> UnitCounts:
    return UnitCounts(row[2].requests, row[2].answers, row[2].seconds)


def _unit_figures(before: UnitCounts, now: UnitCounts, passed: float) -> dict[str, float | None]:
    answers = now.answers - before.answers
    took = round((now.seconds - before.seconds) / answers * 1000, 2) if answers > 0 else None
    return {"rate": _rate(before.requests, now.requests, passed), "time": took}


def _rate(before: int, now: int, passed: float) -> float:
    return round(max(0, now - before) / passed, 2)


class UnitsTable:
    """
    See `PageTable`: each unit that requests were sent to, and whether it answers.

    Attributes:
        history: requests a second, and the mean time of the answers.
    """

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
        Column("rate", "spark"),
        Column("time", "spark", is_wide=True),
    )

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._rows: list[UnitRow] = []
        self.history = RowHistory(
            self._named, _unit_counts, _unit_figures, {"rate": "requests/s", "time": "ms"}
        )

    def _named(self) -> Iterator[tuple[tuple[str, str], UnitRow]]:
        return ((_unit_name(row), row) for row in self._units())

    def _units(self) -> Iterator[UnitRow]:
        for line in self._gateway.traffic.lines.copy().values():
            for number, unit in line.units.copy().items():
                yield line.url, number, unit

    def rows(self) -> list[UnitRow]:
        rows = sorted(self._units(), key=lambda row: row[:2])
        if [each[:2] for each in rows] != [each[:2] for each in self._rows]:
            self._rows = rows
        return self._rows

    def words(self, row: UnitRow) -> str:
        return f"{row[0]} unit {row[1]}".lower()

    def is_trouble(self, row: UnitRow) -> bool:
        return row[2].is_silent

    def stamp(self, row: UnitRow) -> object:
        unit = row[2]
        counts = unit.requests, unit.answers, unit.resting, unit.cached
        return *counts, unit.is_silent, self.history.at

    def cells(self, row: UnitRow) -> list[Any]:
        unit, name = row[2], _unit_name(row)
        mean = f"{unit.seconds / unit.answers * 1000:.1f} ms" if unit.answers else ""
        state = "silent" if unit.is_silent else "answers" if unit.answers else "new"
        return [
            [*name],
            [state, f"{unit.resting} refused meanwhile" if unit.is_silent else ""],
            unit.requests,
            unit.answers,
            unit.exceptions,
            unit.timeouts,
            unit.invalid,
            unit.resting,
            unit.cached,
            mean,
            self.history.spark(name, "rate"),
            self.history.spark(name, "time"),
        ]

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return self.history.series(name, column)


def _unit_name(row: UnitRow) -> tuple[str, str]:
    return cell_text(row[0]), f"unit {row[1]}"


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
        host = host_of_peer(traced.peer or "")
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

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return None


def _asking_order(row: ClientCount) -> tuple[str, int, int]:
    return row.host, row.unit, row.function


def _function(row: ClientCount) -> str:
    """Return the name of a function, such as "read holding registers"."""
    known = REQUESTS.get(row.function)
    return "" if known is None else request_name(known)
