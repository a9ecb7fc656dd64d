"""A gateway as a page shows it: its lines, the units behind them, its clients, and a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from ...ports.hosts import host_of_peer
from ...ports.trace import TracedFrame
from ...protocol.pdu.function_codes import REQUESTS
from ...tools.page.log import Log, request_name
from ...tools.page.samples import Counts, RowHistory, Series
from ...tools.page.table_source import Column, Older, PageRow, problem_text
from ...tools.page.text import cell_text, first_names
from ...tools.page.units import ShownServer
from .gateway import Gateway
from .statistics import LineStatistics, UnitStatistics

MOST_ASKING = 2000
"""Clients, units and functions that are counted; the first is dropped for one more."""

Name = tuple[str, str]

Spark = Callable[[Name, str], list[int]]

COLUMNS = (
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


class GatewayRow(NamedTuple):
    """See `PageRow`; `make` makes all cells but the name, when a page shows the row."""

    name: Name
    is_problem: bool
    counts: Counts
    make: Callable[[], dict[str, Any]]
    more_words: str = ""

    @property
    def words(self) -> str:
        return " ".join([*self.name, self.more_words]).strip().lower()

    def cells(self) -> dict[str, Any]:
        return {"name": {"group": self.name[0], "own": self.name[1]}, **self.make()}


class ShownGateway:
    """See `ShownTable` of the page; the trace of the gateway must call `note`."""

    kind = "gateway"
    older: Older | None = None
    columns: Sequence[Column] = COLUMNS

    def __init__(self, title: str, gateway: Gateway) -> None:
        self.title = title
        self._gateway = gateway
        self._log = Log(lambda: ShownServer({}, {}))
        self.log: Log | None = self._log
        self._history = RowHistory(lambda: ((row.name, row.counts) for row in self._behind()))
        self._clients = Clients()

    def note(self, frame: TracedFrame) -> None:
        """Note a traced frame; quickly, because the gateway waits."""
        self._log.note(frame)
        self._clients.note(frame)
        self._history.sample()  # whether a page is open or not

    def status(self) -> tuple[str, bool]:
        """Return which lines are down, and which units are silent, or that there are none."""
        lines = self._lines()
        units = [(line, *entry) for line in lines for entry in line.units.copy().items()]
        down = [line.url.partition("?")[0] for line in lines if line.is_down]
        silent = [_unit_name(line, at) for line, at, unit in units if unit.is_silent]
        new = [_unit_name(line, at) for line, at, unit in units if _has_only_failed(unit)]
        problems = [f"{len(down)} of {len(lines)} lines down{first_names(down)}"] if down else []
        if silent:
            problems.append(f"silent units: {len(silent)}{first_names(silent)}")
        if new:
            problems.append(f"units that have never answered: {len(new)}{first_names(new)}")
        return ("; ".join(problems), True) if problems else ("no line is down", False)

    def figures(self) -> Mapping[str, float]:
        self._history.sample()
        server, traffic, lines = self._gateway.statistics, self._gateway.traffic, self._lines()
        return {
            "clients": server.connections,
            "requests": traffic.requests,
            "waiting": sum(line.waiting for line in lines),
            "refused": traffic.refused + traffic.no_route + traffic.malformed,
            "down": sum(line.is_down for line in lines),
        }

    def rows(self) -> Sequence[PageRow]:
        return [*self._behind(), *self._clients.rows()]

    def series(self, name: Name, column: str) -> Series | None:
        return self._history.series(name, column)

    def _lines(self) -> list[LineStatistics]:
        return list(self._gateway.traffic.lines.copy().values())

    def _behind(self) -> Iterator[GatewayRow]:
        """Yield each line, and then its units by their numbers."""
        spark = self._history.spark
        for line in self._lines():
            yield _line_row(("", cell_text(line.url)), line, spark)
            for number, unit in sorted(line.units.copy().items()):
                yield _unit_row((cell_text(line.url), f"unit {number}"), unit, spark)


def _unit_name(line: LineStatistics, number: int) -> str:
    return f"{line.url.partition('?')[0]} unit {number}"


def _has_only_failed(unit: UnitStatistics) -> bool:
    """Return True if requests failed, the unit has never answered, and is not paused."""
    failures = unit.timeouts or unit.invalid  # without a connection, the line is down
    return bool(failures) and not unit.answers and not unit.is_silent


def _line_row(name: Name, line: LineStatistics, spark: Spark) -> GatewayRow:
    def cells() -> dict[str, Any]:
        word = "down" if line.trouble else "open" if line.connection.connects else "new"
        reason = problem_text(line.trouble) if line.trouble else ""
        state = {"word": word, "reason": reason, "since": round(line.since, 1)}
        totals = {"requests": line.connection.requests, "answers": line.connection.responses}
        details = _listed(waiting=line.waiting, in_flight=line.in_flight, refused=line.full)
        sparks = {key: spark(name, key) for key in ("rate", "queue")}
        return {"state": state, **totals, **sparks, "details": details}

    counts = Counts(line.connection.requests, waiting=line.waiting)
    return GatewayRow(name, line.is_down, counts, cells)


def _unit_row(name: Name, unit: UnitStatistics, spark: Spark) -> GatewayRow:
    def cells() -> dict[str, Any]:
        word = "silent" if unit.is_silent else "answers" if unit.answers else "new"
        if _has_only_failed(unit):
            word = "no answer"
        reason = f"{unit.refused} requests refused meanwhile" if unit.is_silent else ""
        mean = f"mean {unit.mean_us / 1000:.1f} ms" if unit.answers else ""
        numbers = _listed(
            exceptions=unit.exceptions,
            timeouts=unit.timeouts,
            invalid=unit.invalid,
            refused=unit.refused,
            cached=unit.cached,
        )
        totals = {"requests": unit.requests, "answers": unit.answers}
        details = ", ".join(filter(None, [mean, numbers]))
        sparks = {key: spark(name, key) for key in ("rate", "time")}
        return {"state": {"word": word, "reason": reason}, **totals, **sparks, "details": details}

    counts = Counts(unit.requests, unit.answers, unit.seconds)
    return GatewayRow(name, unit.is_silent or _has_only_failed(unit), counts, cells)


def _listed(**numbers: int) -> str:
    """Return the numbers that are not 0 with their names."""
    items = ((name.replace("_", " "), count) for name, count in numbers.items())
    return ", ".join(f"{name} {count}" for name, count in items if count)


class Clients:
    """Counts which client asks which unit with which function."""

    def __init__(self) -> None:
        # Host, unit and function -> requests, exceptions, and the time of the last request.
        self._client_counts: dict[tuple[str, int, int], tuple[int, int, float]] = {}

    def note(self, frame: TracedFrame) -> None:
        """Count a request or a response."""
        if frame.unit is None or frame.function is None:
            return
        key = host_of_peer(frame.peer or ""), frame.unit, frame.function & 0x7F
        entry = self._client_counts.get(key)
        if frame.direction == "received":
            if entry is None and len(self._client_counts) >= MOST_ASKING:
                self._client_counts.pop(next(iter(self._client_counts)), None)
            requests, exceptions, _ = entry or (0, 0, 0.0)
            self._client_counts[key] = requests + 1, exceptions, frame.time
        elif entry is not None and frame.function & 0x80:
            requests, exceptions, time = entry
            self._client_counts[key] = requests, exceptions + 1, time

    def rows(self) -> list[GatewayRow]:
        return [_client_row(*item) for item in sorted(self._client_counts.copy().items())]


def _client_row(key: tuple[str, int, int], counts: tuple[int, int, float]) -> GatewayRow:
    host, unit, function = key
    requests, exceptions, time = counts
    request = REQUESTS.get(function)
    title = f"{function} {'' if request is None else request_name(request)}".rstrip()
    state = {"word": "client", "reason": _listed(exceptions=exceptions)}
    cells = {"state": state, "requests": requests, "last": round(time, 1)}
    name = cell_text(host), f"unit {unit}, {title}"
    words = f"function {function}"
    return GatewayRow(name, exceptions > 0, Counts(requests), lambda: cells, words)
