"""
A gateway as a page shows it: its lines, the units behind them, its clients, and a log.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ...ports.hosts import host_of_peer
from ...ports.trace import Traced
from ...protocol.pdu.function_codes import REQUESTS
from ...tools.page.log import Log, request_name
from ...tools.page.samples import Counts, RowHistory, Series
from ...tools.page.table_source import Column, Older, PageRow, problem_text
from ...tools.page.text import cell_text
from ...tools.page.units import ShownServer
from .gateway import Gateway
from .statistics import LineStatistics, UnitStatistics

__all__ = ["ShownGateway"]

# Clients, units and functions that are counted; the first is dropped for one more.
MOST_ASKING = 2000

NOTHING = ShownServer({}, {})

Name = tuple[str, str]


class ShownGateway:
    """
    See `Shown` of the page.

    Args:
        title: the name of the gateway.
        gateway: its trace must call `note`.
    """

    kind = "gateway"
    older: Older | None = None
    columns: Sequence[Column] = (
        Column("name", "row"),
        Column("state", "state"),
        Column("requests", "number"),
        Column("answers", "number", is_wide=True),
        Column("rate", "spark"),
        Column("time", "spark", is_wide=True),
        Column("queue", "spark", is_wide=True),
        Column("details", "note", is_wide=True),
        Column("last", "age", is_wide=True),
    )

    def __init__(self, title: str, gateway: Gateway) -> None:
        self.title = title
        self._gateway = gateway
        self._log = Log(lambda: NOTHING)
        self.log: Log | None = self._log
        self._history = RowHistory(self._counts)
        self._clients = Clients()

    def note(self, traced: Traced) -> None:
        """Take what a trace is called with; quickly, because the gateway waits."""
        self._log.note(traced)
        self._clients.note(traced)
        self._history.sample()  # whether a page is open or not

    def status(self) -> tuple[str, bool]:
        """Return which lines are down, or that none is."""
        lines = self._lines()
        down = sum(bool(each.trouble) for each in lines)
        silent = sum(each.is_silent for line in lines for each in line.units.copy().values())
        problems = [f"{down} of {len(lines)} lines down"] if down else []
        if silent:
            problems.append(f"silent units: {silent}")
        return ("; ".join(problems), True) if problems else ("no line is down", False)

    def figures(self) -> Mapping[str, float]:
        self._history.sample()
        server, traffic, lines = self._gateway.statistics, self._gateway.traffic, self._lines()
        return {
            "clients": server.connections,
            "requests": traffic.requests,
            "waiting": sum(each.waiting for each in lines),
            "refused": traffic.refused + traffic.no_route + traffic.malformed,
            "down": sum(bool(each.trouble) for each in lines),
        }

    def _lines(self) -> list[LineStatistics]:
        return list(self._gateway.traffic.lines.copy().values())

    def _behind(self) -> Iterator[LineRow | UnitRow]:
        """Yield each line, and then its units by their numbers."""
        for line in self._lines():
            yield LineRow(line, self._history)
            for number, unit in sorted(line.units.copy().items()):
                yield UnitRow(line.url, number, unit, self._history)

    def _counts(self) -> Iterator[tuple[Name, Counts]]:
        return ((each.name, each.counts) for each in self._behind())

    def rows(self) -> Sequence[PageRow]:
        return [*self._behind(), *self._clients.rows()]

    def series(self, name: Name, column: str) -> Series | None:
        return self._history.series(name, column)


class LineRow:
    """See `PageRow`: a line, its queue and its state."""

    def __init__(self, line: LineStatistics, history: RowHistory) -> None:
        self._line = line
        self._history = history
        self.name: Name = ("", cell_text(line.url))

    @property
    def words(self) -> str:
        return self._line.url.lower()

    @property
    def is_problem(self) -> bool:
        return bool(self._line.trouble)

    @property
    def counts(self) -> Counts:
        return Counts(self._line.connection.requests, waiting=self._line.waiting)

    def cells(self) -> list[Any]:
        line, history = self._line, self._history
        word = "down" if line.trouble else "open" if line.connection.connects else "new"
        numbers = {"waiting": line.waiting, "in flight": line.in_flight, "refused": line.full}
        return [
            [*self.name],
            [word, problem_text(line.trouble) if line.trouble else "", round(line.since, 1)],
            line.connection.requests,
            line.connection.responses,
            history.spark(self.name, "rate"),
            None,
            history.spark(self.name, "queue"),
            _listed(numbers),
            0,
        ]


class UnitRow:
    """See `PageRow`: a unit that requests were sent to, and whether it answers."""

    def __init__(self, url: str, number: int, unit: UnitStatistics, history: RowHistory) -> None:
        self._unit = unit
        self._history = history
        self.name: Name = (cell_text(url), f"unit {number}")

    @property
    def words(self) -> str:
        return " ".join(self.name).lower()

    @property
    def is_problem(self) -> bool:
        return self._unit.is_silent

    @property
    def counts(self) -> Counts:
        return Counts(self._unit.requests, self._unit.answers, self._unit.seconds)

    def cells(self) -> list[Any]:
        unit, history = self._unit, self._history
        word = "silent" if unit.is_silent else "answers" if unit.answers else "new"
        reason = f"{unit.resting} requests refused meanwhile" if unit.is_silent else ""
        numbers = {
            "exceptions": unit.exceptions,
            "timeouts": unit.timeouts,
            "invalid": unit.invalid,
            "refused": unit.resting,
            "cached": unit.cached,
        }
        mean = f"mean {unit.seconds / unit.answers * 1000:.1f} ms" if unit.answers else ""
        return [
            [*self.name],
            [word, reason, 0],
            unit.requests,
            unit.answers,
            history.spark(self.name, "rate"),
            history.spark(self.name, "time"),
            None,
            ", ".join(filter(None, [mean, _listed(numbers)])),
            0,
        ]


def _listed(numbers: Mapping[str, int]) -> str:
    """Return the numbers that are not 0 with their names."""
    return ", ".join(f"{name} {count}" for name, count in numbers.items() if count)


class ClientRow:
    """
    See `PageRow`: the requests of one client with one function to one unit.

    Attributes:
        requests, exceptions: their number, and that of exceptions among the responses.
        time: of the last request, in seconds since the epoch.
    """

    __slots__ = ("exceptions", "key", "requests", "time")

    def __init__(self, key: tuple[str, int, int]) -> None:
        self.key: tuple[str, int, int] = key
        self.requests: int = 0
        self.exceptions: int = 0
        self.time: float = 0.0

    @property
    def words(self) -> str:
        host, unit, function = self.key
        return f"{host} unit {unit} function {function} {_function(function)}".lower()

    @property
    def is_problem(self) -> bool:
        return self.exceptions > 0

    def cells(self) -> list[Any]:
        host, unit, function = self.key
        details = _listed({"exceptions": self.exceptions})
        return [
            [cell_text(host), f"unit {unit}, {function} {_function(function)}".rstrip()],
            ["client", details, 0],
            self.requests,
            "",
            None,
            None,
            None,
            "",
            round(self.time, 1),
        ]


class Clients:
    """Counts which client asks which unit with which function."""

    def __init__(self) -> None:
        self._asking: dict[tuple[str, int, int], ClientRow] = {}

    def note(self, traced: Traced) -> None:
        """Count a request or a response."""
        if traced.unit is None or traced.function is None:
            return
        key = host_of_peer(traced.peer or ""), traced.unit, traced.function & 0x7F
        found = self._asking.get(key)
        if traced.direction == "sent":
            if found is not None and traced.function & 0x80:
                found.exceptions += 1
            return
        if found is None:
            if len(self._asking) >= MOST_ASKING:
                self._asking.pop(next(iter(self._asking)), None)
            found = self._asking[key] = ClientRow(key)
        found.requests += 1
        found.time = traced.time

    def rows(self) -> list[ClientRow]:
        """Return the clients in the order of their addresses, units and functions."""
        return [row for _, row in sorted(self._asking.copy().items())]


def _function(number: int) -> str:
    """Return the name of a function, such as "read holding registers"."""
    known = REQUESTS.get(number)
    return "" if known is None else request_name(known)
