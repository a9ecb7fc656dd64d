"""
The log of a page: transactions as rows of text, and which client wrote which addresses last.
"""

from __future__ import annotations

import re
import reprlib
import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any, NamedTuple

from ...device.access import ACCESSES
from ...ports.schemes import framing_of
from ...ports.trace import Traced
from ...protocol import pdu
from ...protocol.pdu import Request
from ...protocol.pdu.request import arguments
from ...protocol.plain import time_text
from ..files.csv_text import csv_rows
from ..listener.traces import Exchange, TracePairing
from .named import named_cells
from .shown import ShownServer

__all__ = ["Log", "LogRow", "Written", "request_name"]

# The most ADUs that wait to be shown, and the most rows that are remembered.
MOST_ADUS = 2000
MOST_ROWS = 300

# The most ranges of addresses whose last write is remembered.
MOST_RANGES = 1000

MOST_VALUES = 10

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
            for access in kind.find(request, mapping, (0, "", None)).writes if kind else ():
                start = access.address
                self.wrote(number, access.table, start, start + access.count, peer)

    # --- output -------------------------------------------------------------------------------

    def rows(self, after: int = 0) -> list[LogRow]:
        """Return the remembered rows after this number."""
        # ADUs that arrive meanwhile wait: otherwise this might never return under load.
        for _ in range(len(self._adus)):
            self._pairing.take(self._adus.popleft())
        self._pairing.tick(time.time())
        done, self._pairing.done = self._pairing.done, []
        self._rows += [_row(next(self._row_numbers), each, self._named(each)) for each in done]
        return [each for each in self._rows if each.number > after]

    def download(self, query: Mapping[str, str]) -> str:
        """Return the remembered rows that a query selects as CSV; see `as_csv`."""
        writes, errors = ("1" in query.get(name, "") for name in ("writes", "errors"))
        return self.as_csv(query.get("unit", ""), writes=writes, errors=errors)

    def as_csv(self, unit: str = "", *, writes: bool = False, errors: bool = False) -> str:
        """
        Return the remembered rows as CSV.

        Args:
            unit: only rows of this unit; empty for all units.
            writes: True for only writes.
            errors: True for only failed requests; with `writes` both kinds are returned.
        """
        rows = [
            [time_text(each.time), *each[2:6], each.named, each.outcome, each.kind, each.seconds]
            for each in self.rows()
            if unit in ("", str(each.unit)) and _is_wanted(each, writes=writes, errors=errors)
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

    def written(self, after: int = 0) -> list[Written]:
        """Return the writes after this number, the oldest first."""
        newest = []
        for each in reversed(list(self._written.copy().values())):
            if each.number <= after:
                break
            newest.append(each)
        return newest[::-1]


def _is_wanted(row: LogRow, *, writes: bool, errors: bool) -> bool:
    if not (writes or errors):
        return True
    return (writes and row.writes) or (errors and row.kind not in GOOD)


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
        _cut(each.outcome(_listed)),
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


def _cut(text: str) -> str:
    return text if len(text) <= 200 else f"{text[:200]}..."
