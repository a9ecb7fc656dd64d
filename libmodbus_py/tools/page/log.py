"""The log of a page: transactions as rows of text, and which client wrote which addresses last."""

from __future__ import annotations

import reprlib
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any, NamedTuple

from ...device.access import ACCESSES, touched
from ...files.csv_text import csv_rows
from ...ports.schemes import framing_of
from ...ports.trace import TracedFrame
from ...protocol import pdu
from ...protocol.pdu import Request
from ...protocol.pdu.request import arguments
from ...protocol.plain import time_text
from ..listener.pairing import Exchange, TracePairing
from .streams import Tables
from .text import cell_text, in_words
from .units import ShownServer, ShownUnit

# The most ADUs that wait to be shown, and the most rows that are remembered.
MOST_ADUS = 2000
MOST_ROWS = 300

# The most ranges of addresses whose last write is remembered.
MOST_RANGES = 1000

# Values and points of a request that the log shows.
MOST_VALUES = 10
MOST_POINTS = 6

_short = reprlib.Repr()
_short.maxlist = _short.maxtuple = _short.maxdict = 8
_short.maxstring = _short.maxother = 80

WRITES = frozenset(request.function for request, kind in ACCESSES.items() if kind.writes)

# Kinds of good transactions, and of those after which the device has the written values.
GOOD = ("answered", "broadcast")
DONE = (*GOOD, "late", "invalid")

HEAD = ("time", "client", "unit", "function", "request", "points", "response", "kind", "seconds")

# Characters with which formulas of spreadsheets begin.
FORMULAS = ("=", "+", "-", "@", "\t", "\r")


class LogRow(NamedTuple):
    """A transaction; `number` is counted since the page was opened, `named` are its points."""

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


class Log:
    """Collects the trace of a server, in the server's loop, and returns rows, in any thread."""

    def __init__(self, server_of: Callable[[], ShownServer]) -> None:
        self._server_of = server_of
        self._adus: deque[TracedFrame] = deque(maxlen=MOST_ADUS)
        self._pairing = TracePairing()
        self._rows: deque[LogRow] = deque(maxlen=MOST_ROWS)
        self._row_numbers = count(1)
        self._lock = threading.Lock()  # of the rows and what they are made from
        # Writes are paired at once, because pages that are opened later show them, too.
        self._writes = TracePairing()
        # Unit, table, first address and end -> the row of the last write.
        self._write_rows: dict[tuple[int | None, str, int, int], dict[str, Any]] = {}
        self._write_numbers = count(1)

    def note(self, frame: TracedFrame) -> None:
        """Take an ADU of the trace; returns quickly, because the server waits."""
        self._adus.append(frame)
        if frame.function is None or frame.function & 0x7F not in WRITES:
            return
        self._writes.take(frame)
        exchanges, self._writes.done = self._writes.done, []
        is_line = framing_of(frame.endpoint) in ("rtu", "ascii")
        for peer, exchange in exchanges:
            if exchange.kind in DONE and exchange.request is not None and exchange.unit is not None:
                server = self._server_of()
                for number in server.units_of(exchange.unit, is_line=is_line):
                    mapping = server.units[number].device.mapping
                    for access in touched(exchange.request, mapping=mapping).writes:
                        stop = access.address + access.count
                        self.note_write(
                            number, access.table, range(access.address, stop), peer or ""
                        )

    def note_write(self, unit: int | None, table: str, cells: range, who: str) -> None:
        """Remember that a client, or the page itself, wrote these addresses."""
        key = unit, table, cells.start, cells.stop
        names = ("number", "unit", "table", "start", "stop", "time", "who")
        self._write_rows.pop(key, None)  # the latest is the last
        while len(self._write_rows) >= MOST_RANGES:
            self._write_rows.pop(next(iter(self._write_rows)), None)
        row = (next(self._write_numbers), *key, time.time(), who)
        self._write_rows[key] = dict(zip(names, row, strict=True))

    def tables(self) -> Tables:
        """Return the remembered rows and writes for a page, by their numbers."""
        return {
            "log": {row.number: row._asdict() for row in self.rows()},
            "written": {row["number"]: row for row in self._write_rows.copy().values()},
        }

    def rows(self) -> list[LogRow]:
        """Return the remembered rows, the oldest first."""
        with self._lock:
            # ADUs that arrive meanwhile wait: otherwise this might never return under load.
            for _ in range(len(self._adus)):
                self._pairing.take(self._adus.popleft())
            self._pairing.tick(time.time())
            exchanges, self._pairing.done = self._pairing.done, []
            self._rows += [self._row(exchange) for exchange in exchanges[-MOST_ROWS:]]
            return list(self._rows)

    def download(self, query: Mapping[str, str]) -> str:
        """Return rows as CSV, of a "unit", or only "writes" or "errors", as the query says."""
        unit = query.get("unit", "")
        choice = query.get("writes") == "1", query.get("errors") == "1"
        rows = [
            [time_text(row.time), *row[2:6], row.named, row.outcome, row.kind, row.seconds]
            for row in self.rows()
            if unit in ("", str(row.unit)) and _is_wanted(row, *choice)
        ]
        return csv_rows([HEAD, *(map(_cell, row) for row in rows)])

    def _row(self, exchange: Exchange) -> LogRow:
        (peer, transaction), names = exchange, ""
        request, unit = transaction.request, transaction.unit
        if request is not None and unit is not None and transaction.kind in DONE:
            server = self._server_of()
            for number in server.units_of(unit, is_line=False)[:1]:
                names = named_cells(server.units[number], request, transaction.response)
        number, function = next(self._row_numbers), transaction.function
        words = "" if request is None else request_words(request)
        whose = number, transaction.time, peer or "", unit, function, words
        end = cell_text(transaction.outcome(_listed)), transaction.kind, transaction.duration
        return LogRow(*whose, *end, names, function in WRITES)


def _is_wanted(row: LogRow, writes: bool, errors: bool) -> bool:
    return not (writes or errors) or (writes and row.writes) or (errors and row.kind not in GOOD)


def _cell(value: Any) -> Any:
    """Return a cell of CSV that spreadsheets do not take for a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULAS) else value


def request_name(kind: type[Request[Any]]) -> str:
    """Return the name of a kind of requests in words, such as "read holding registers"."""
    return in_words(kind.__name__)


def request_words(request: Request[Any]) -> str:
    """Return a text such as ``read holding registers 100..102``."""
    values = arguments(request)
    match request:
        case pdu.WriteCoil() | pdu.WriteRegister():
            return f"write {_table(request)} {request.address}: {int(request.value)}"
        case pdu.WriteCoils() | pdu.WriteRegisters():
            span = _span(request.address, len(request.values))
            return f"write {_table(request)} {span}: {_listed(request.values)}"
        case _ if list(values) == ["address", "count"] and type(request) in ACCESSES:
            return f"read {_table(request)} {_span(**values)}"
    words = [f"{name.replace('_', ' ')} {_short.repr(value)}" for name, value in values.items()]
    return ": ".join(filter(None, [request_name(type(request)), ", ".join(words)]))


def _table(request: Request[Any]) -> str:
    kind = ACCESSES[type(request)]
    return (kind.reads or kind.writes).replace("_", " ")


def _span(address: int, count: int) -> str:
    return str(address) if count == 1 else f"{address}..{address + count - 1}"


def _listed(values: Any) -> str:
    """Return the first few bits or registers as numbers; other values in the form of Python."""
    if not isinstance(values, list | tuple) or not all(isinstance(value, int) for value in values):
        return _short.repr(values)
    more = "" if len(values) <= MOST_VALUES else f", ... ({len(values)})"
    return ", ".join(str(int(value)) for value in values[:MOST_VALUES]) + more


def named_cells(unit: ShownUnit, request: Request[Any], response: Any) -> str:
    """Return the points that a request reads or writes as a whole, with their values."""
    accesses = touched(request, mapping=unit.device.mapping)
    ranges = [(write, write.values) for write in accesses.writes]
    if isinstance(response, list | tuple):
        ranges += [(read, tuple(response[: read.count])) for read in accesses.reads]
    texts: list[str] = []
    for access, cells in ranges:
        for point in unit.index.touched(access)[: MOST_POINTS + 2]:
            start, stop = (at - access.address for at in (point.cells.start, point.cells.stop))
            if start >= 0 and stop <= len(cells):
                _, text = unit.value_and_text(point, list(cells[start:stop]))
                texts.append(f"{point.name} {text} {point.units}".rstrip())
    more = ", ..." if len(texts) > MOST_POINTS else ""
    return cell_text(", ".join(texts[:MOST_POINTS]) + more)
