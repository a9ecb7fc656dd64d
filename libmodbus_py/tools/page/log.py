"""
The log of a page: transactions as rows of text, and which client wrote which addresses last.
"""

from __future__ import annotations

import re
import reprlib
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

from ...device.access import ACCESSES
from ...maps.point import Point
from ...ports.schemes import framing_of
from ...ports.trace import Traced
from ...protocol import pdu
from ...protocol.pdu import Request
from ...protocol.pdu.request import arguments
from ...protocol.plain import time_text
from ..files.csv_text import csv_rows
from ..listener.pairing import Exchange, TracePairing
from .streams import Tables
from .text import cell_text, point_text
from .units import ShownServer, ShownUnit

__all__ = ["Log", "LogRow", "Written", "named_cells", "request_name"]

# The most ADUs that wait to be shown, and the most rows that are remembered.
MOST_ADUS = 2000
MOST_ROWS = 300

# The most ranges of addresses whose last write is remembered.
MOST_RANGES = 1000

# Values of a request that the log shows.
MOST_VALUES = 10

# Points of a request that the log names.
MOST_POINTS = 6

NO_CALLER = (0, "", None)

_short = reprlib.Repr()
_short.maxlist = _short.maxtuple = _short.maxdict = 8
_short.maxstring = _short.maxother = 80

WRITES = frozenset(request.function for request, kind in ACCESSES.items() if kind.writes)

# Kinds of transactions after which the device has the written values.
DONE = ("answered", "broadcast", "late", "invalid")

GOOD = ("answered", "broadcast")

HEAD = (
    *("time", "client", "unit", "function", "request", "points", "response", "kind", "seconds"),
)

# Characters with which formulas of spreadsheets begin.
FORMULAS = ("=", "+", "-", "@", "\t", "\r")


class LogRow(NamedTuple):
    """
    A transaction as a row of the log.

    Attributes:
        number: the number of the row, counted since the page was opened.
        named: the points that are read or written, with their values.
        writes: True for a write.
    """

    number: int
    time: float
    peer: str
    unit: int | None
    function: int | None
    asked: str
    outcome: str
    kind: str
    seconds: float | None
    named: str = ""
    writes: bool = False


class Written(NamedTuple):
    """The last write to some addresses; `number` is counted since the page was opened."""

    number: int
    unit: int | None
    table: str
    start: int
    stop: int
    time: float
    who: str


class Log:
    """
    Collects the trace of a server, in the server's loop, and returns rows, in any thread.

    Args:
        shown: returns the units that the server has now.
    """

    def __init__(self, shown: Callable[[], ShownServer]) -> None:
        self._shown = shown
        self._adus: deque[Traced] = deque(maxlen=MOST_ADUS)
        self._pairing = TracePairing()
        self._rows: deque[LogRow] = deque(maxlen=MOST_ROWS)
        self._row_numbers = count(1)
        # Writes are paired at once, because pages that are opened later show them, too.
        self._writes = TracePairing()
        self._written: dict[tuple[int | None, str, int, int], Written] = {}
        self._write_numbers = count(1)

    # --- input --------------------------------------------------------------------------------

    def note(self, traced: Traced) -> None:
        """Take an ADU of the trace; returns quickly, because the server waits."""
        self._adus.append(traced)
        if traced.function is not None and traced.function & 0x7F in WRITES:
            self._note_write(traced)

    def wrote(self, unit: int | None, table: str, start: int, stop: int, who: str) -> None:
        """Remember that a client, or the page itself, wrote these addresses."""
        key = unit, table, start, stop
        self._written.pop(key, None)  # the latest is the last
        while len(self._written) >= MOST_RANGES:
            self._written.pop(next(iter(self._written)), None)
        number = next(self._write_numbers)
        self._written[key] = Written(number, *key, time.time(), who)

    def _note_write(self, traced: Traced) -> None:
        self._writes.take(traced)
        done, self._writes.done = self._writes.done, []
        for peer, each in done:
            if each.kind in DONE and each.request is not None and each.unit is not None:
                is_line = framing_of(traced.endpoint) in ("rtu", "ascii")
                self._note_written(each.unit, each.request, peer or "", is_line=is_line)

    def _note_written(self, unit: int, request: Request[Any], peer: str, *, is_line: bool) -> None:
        shown, kind = self._shown(), ACCESSES.get(type(request))
        for number in shown.units_of(unit, is_line=is_line):
            mapping = shown.units[number].device.mapping
            for access in kind.find(request, mapping, NO_CALLER).writes if kind else ():
                start = access.address
                self.wrote(number, access.table, start, start + access.count, peer)

    # --- output -------------------------------------------------------------------------------

    def tables(self) -> Tables:
        """Return the remembered rows and writes for a page, by their numbers."""
        return {
            "log": {each.number: each for each in self.rows()},
            "written": {each.number: each for each in self._written.copy().values()},
        }

    def rows(self) -> list[LogRow]:
        """Return the remembered rows, the oldest first."""
        # ADUs that arrive meanwhile wait: otherwise this might never return under load.
        for _ in range(len(self._adus)):
            self._pairing.take(self._adus.popleft())
        self._pairing.tick(time.time())
        done, self._pairing.done = self._pairing.done, []
        self._rows += [_row(next(self._row_numbers), each, self._named(each)) for each in done]
        return list(self._rows)

    def download(self, query: Mapping[str, str]) -> str:
        """
        Return the remembered rows as CSV.

        Args:
            query: "unit" selects the rows of a unit, "writes": "1" writes, and "errors": "1" failed
                requests; with both, either.
        """
        unit = query.get("unit", "")
        wanted = query.get("writes") == "1", query.get("errors") == "1"
        rows = [
            [time_text(each.time), *each[2:6], each.named, each.outcome, each.kind, each.seconds]
            for each in self.rows()
            if unit in ("", str(each.unit)) and _is_wanted(each, *wanted)
        ]
        return csv_rows([HEAD, *(map(_cell, row) for row in rows)])

    def _named(self, exchange: Exchange) -> str:
        """Return the points of a transaction with their values; "" if the server lacks its unit."""
        each, shown = exchange.transaction, self._shown()
        if each.request is None or each.unit is None or each.kind not in DONE:
            return ""
        for number in shown.units_of(each.unit, is_line=False):
            try:
                return named_cells(shown.units[number], each.request, each.response)
            except (ValueError, TypeError, LookupError):  # the device was replaced meanwhile
                return ""
        return ""


def _is_wanted(row: LogRow, writes: bool, errors: bool) -> bool:
    return not (writes or errors) or (writes and row.writes) or (errors and row.kind not in GOOD)


def _cell(value: Any) -> Any:
    """Return a cell of CSV that spreadsheets do not take for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in FORMULAS and value else value


def _row(number: int, exchange: Exchange, named: str) -> LogRow:
    peer, each = exchange
    return LogRow(
        number,
        each.time,
        peer or "",
        each.unit,
        each.function,
        "" if each.request is None else _words(each.request),
        cell_text(each.outcome(_listed)),
        each.kind,
        each.duration,
        named,
        each.function in WRITES,
    )


def _words(request: Request[Any]) -> str:
    """Return a text such as ``read holding registers 100..102``."""
    match request:
        case pdu.WriteCoil() | pdu.WriteRegister():
            return f"write {_place(request)} {request.address}: {int(request.value)}"
        case pdu.WriteCoils() | pdu.WriteRegisters():
            span = _span(request.address, len(request.values))
            return f"write {_place(request)} {span}: {_listed(request.values)}"
        case (
            pdu.ReadCoils()
            | pdu.ReadDiscreteInputs()
            | pdu.ReadHoldingRegisters()
            | pdu.ReadInputRegisters()
        ):
            return f"read {_place(request)} {_span(request.address, request.count)}"
        case _:
            return _all_words(request)


def _place(request: Request[Any]) -> str:
    kind = ACCESSES[type(request)]
    return (kind.reads or kind.writes).replace("_", " ")


def _span(address: int, count: int) -> str:
    return str(address) if count == 1 else f"{address}..{address + count - 1}"


def _listed(values: Any) -> str:
    """Return the first few bits or registers as numbers; other values in the form of Python."""
    if not isinstance(values, list | tuple) or not all(isinstance(each, int) for each in values):
        return _short.repr(values)
    more = "" if len(values) <= MOST_VALUES else f", ... ({len(values)})"
    return ", ".join(str(int(each)) for each in values[:MOST_VALUES]) + more


def _all_words(request: Request[Any]) -> str:
    name = request_name(type(request))
    given = [
        f"{argument.replace('_', ' ')} {_short.repr(value)}"
        for argument, value in arguments(request).items()
    ]
    return f"{name}: {', '.join(given)}" if given else name


def request_name(kind: type[Request[Any]]) -> str:
    """Return the name of a kind of requests in words, such as "read holding registers"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", kind.__name__).lower()


def named_cells(unit: ShownUnit, request: Request[Any], response: Any) -> str:
    """
    Return the points that a request reads or writes as a whole, with their values.

    Args:
        unit: the unit of the request.
        request: the request.
        response: the result of the request; None unless the response contains values.

    Returns:
        Text such as "voltage 230.1 V, pump on"; empty if there are no such points.
    """
    kind = ACCESSES.get(type(request))
    if kind is None:
        return ""
    touched = kind.find(request, unit.device.mapping, NO_CALLER)
    found: list[str] = [
        text
        for each in touched.writes
        for text in _point_texts(unit, each.table, each.address, each.values)
    ]
    if isinstance(response, list | tuple):
        for each in touched.reads:
            found += _point_texts(unit, each.table, each.address, response[: each.count])
    more = ", ..." if len(found) > MOST_POINTS else ""
    return cell_text(", ".join(found[:MOST_POINTS]) + more)


def _point_texts(unit: ShownUnit, table: str, first: int, cells: Sequence[Any]) -> list[str]:
    stop = first + len(cells)
    found: list[str] = []
    for point in unit.points_from(table, first):
        if point.address >= stop or len(found) > MOST_POINTS:
            break
        if point.cells.stop <= stop:
            own = list(cells[point.cells.start - first : point.cells.stop - first])
            found.append(f"{point.name} {_with_units(unit, point, own)}")
    return found


def _with_units(unit: ShownUnit, point: Point, cells: list[Any]) -> str:
    with unit.device.mapping:
        try:
            source = unit.source(point)
        except (IndexError, KeyError, ValueError):  # a map may have what the device lacks
            source = None
    text = point_text(point, cells, source)
    return f"{text} {point.units}" if point.units else text
