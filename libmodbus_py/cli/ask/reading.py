"""
The command read: all items of a unit are asked for, once or again and again.

--watch polls at a steady pace, whatever fails, until Ctrl-C or the end that was asked for. On a
terminal the values are a table that is drawn again in place; so they are while --csv or --json
write to a file. With --page a page shows them, too.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from functools import partial
from typing import Any, TextIO

from ...client.blocking import Client
from ...maps.holes import Holes, carried_out, reading
from ...maps.items import Borders
from ...maps.plan import Plan
from ...maps.watched import PointIntervals, Totals
from ...protocol import pdu
from ...protocol.errors import ExceptionResponse, ModbusError
from ..arguments import connected
from ..main import CommandError, advice
from ..output import Status, complain, counted
from ..serve import over_http
from .formatters import Printer, ReadResult, TerminalTable, printer_of, result_of
from .items import Item, Words, reason_of
from .units import ask_units, client_of, units_of

__all__ = ["read", "watch"]

ONCE_S = 1.0
"""The interval of a read without --watch, where it has no effect."""

STATUS_AFTER_S = 1.0
"""Until a status line is shown: most reads are over by then."""


RECORDS = 121
"""Records of a file that one request reads: the byte count of the answer goes to 245."""


class _ItemPlan(Plan):
    """A plan of items whose results are cells; `others` are the requests for files and queues."""

    def __init__(self, items: Sequence[Item], borders: Borders, max_registers: int) -> None:
        self._others = {
            at: _requests(item)
            for at, item in enumerate(items)
            if item.table in ("file", "fifo_queue")
        }
        self.others = [each for requests in self._others.values() for each in requests]
        reads = {at: item.read for at, item in enumerate(items) if at not in self._others}
        super().__init__(reads, borders=borders, max_registers=max_registers)

    def cells(self, answers: Sequence[Any], others: Sequence[Any]) -> dict[int, Any]:
        """Return the cells of each item by its index, or the error in place of them."""
        found: dict[int, Any] = self.results(answers)
        left = iter(others)
        for at, requests in self._others.items():
            parts = [next(left) for _ in requests]
            failed = next((each for each in parts if isinstance(each, ModbusError)), None)
            if isinstance(requests[0], pdu.ReadFileRecords) and failed is None:
                parts = [record for (record,) in parts]
            found[at] = failed or [cell for part in parts for cell in part]
        return found

    def _decoded(self, name: Any, cells: list[Any]) -> Any:
        return [int(cell) for cell in cells]


def _requests(item: Item) -> list[pdu.Request[Any]]:
    """Return the requests for a file, none of which divides a value, or for a queue."""
    if item.table == "file":
        step = max(RECORDS // item.size, 1) * item.size
        end = item.address + item.count * item.size
        firsts = range(item.address, max(end, item.address + 1), step)
        return [pdu.ReadFileRecords(((item.file, at, min(step, end - at)),)) for at in firsts]
    if item.count != 1:
        raise ValueError("fifo takes no count: a queue is always read as a whole")
    return [pdu.ReadFifoQueue(item.address)]


class Reader:
    """
    Reads the items that were typed from one unit.

    Attributes:
        interval: seconds from one poll to the next: that of --watch, or the shortest of a point.
    """

    def __init__(self, options: argparse.Namespace, unit: int) -> None:
        words = Words(options, options.what)
        self.items: list[Item] = words.all_items(options.group or ())
        self.unit = unit
        self._sources = words.sources_of(self.items)
        self._limits: tuple[Borders, int] = words.borders(), options.max_registers
        self._plan = _ItemPlan([*self._sources, *self.items], *self._limits)
        points = [item.point for item in self.items]
        own = [None if point is None else point.interval for point in points]
        self._pace = PointIntervals(own, options.watch or ONCE_S)
        self.interval: float = self._pace.interval
        self._totals = Totals(at for at, point in enumerate(points) if point and point.never_falls)
        self._results: dict[int, ReadResult] = {}
        self._holes = Holes()

    def ask(self, context: Client, at: float = 0.0) -> list[ReadResult]:
        """
        Ask for all items that are due; if the device refuses one, the others are still read.

        A total that is smaller than before is read again. Items that are not due have their last
        results. `at` is when this poll is due, in seconds of any steady clock. Raises ModbusError
        for no answer, or one that makes no sense, CommandError if the device refused the only item.
        """
        context.connect()
        context = client_of(context, self.unit)
        found = self._read(context, self._pace.due(at))
        doubtful, _ = self._totals.take(self._values(found))
        if doubtful:
            again = self._read(context, tuple(sorted(doubtful)))
            _, fell = self._totals.take(self._values(again))
            for index in fell:
                remark = f"{again[index].fields['name']} is smaller than before"
                again[index] = again[index]._replace(remark=remark, has_fallen=True)
            found |= again
        self._pace.done()
        self._results |= found
        results = [self._results[index] for index in range(len(self.items))]
        if len(results) == 1 and results[0].failure:
            raise CommandError(results[0].failure)
        return results

    def _read(self, context: Client, due: tuple[int, ...] | None) -> dict[int, ReadResult]:
        """Read the items with some indexes, None for all, and the points that scale them."""
        indexes = tuple(range(len(self.items))) if due is None else due
        items = [*self._sources, *(self.items[at] for at in indexes)]
        plan = self._plan if due is None else _ItemPlan(items, *self._limits)
        status = Status(after=STATUS_AFTER_S)
        ask = partial(self._answers, context, status)
        try:
            facts = self._holes, time.monotonic(), context.statistics.connects
            cells = plan.cells(carried_out(reading(plan.blocks, *facts), ask), ask(plan.others))
        finally:
            status.clear()
        results: list[ReadResult] = []
        values: dict[str, Any] = {}
        for at, item in enumerate(items):
            source = None if item.point is None else values.get(item.point.scale_from or "")
            results.append(result_of(item, cells[at], source))
            if item.point is not None:
                values[item.point.name] = results[at].fields.get("value")
        return dict(zip(indexes, results[len(self._sources) :], strict=True))

    def _values(self, found: dict[int, ReadResult]) -> list[Any]:
        indexes = range(len(self.items))
        return [found[at].fields.get("value") if at in found else None for at in indexes]

    def _answers(self, context: Client, status: Status, requests: Sequence[Any]) -> list[Any]:
        """Send requests up to the first failure that ends the read, which is raised."""
        answers: list[Any] = []
        while len(answers) < len(requests):
            status.show(f"{len(answers)} of {len(requests)} requests")
            some = requests[len(answers) : len(answers) + context.max_in_flight]
            answers += context.execute_many(some, return_exceptions=True)
            for answer in answers[-len(some) :]:
                if isinstance(answer, ModbusError) and not isinstance(answer, ExceptionResponse):
                    raise answer
                if isinstance(answer, ModbusError) and len(self.items) == 1:
                    raise CommandError(reason_of(answer, self.items[0]))
        return answers


def read(options: argparse.Namespace) -> int:
    """Read each unit once, and print."""
    readers = {unit: Reader(options, unit) for unit in units_of(options)}
    items = next(iter(readers.values())).items
    printer = printer_of(options, items, several=len(readers) > 1, are_polls=False)

    def ask(client: Client) -> int:
        results = readers[client.unit].ask(client)
        printer(client.unit, results, "")
        sys.stdout.flush()
        failures = dict.fromkeys(each.failure for each in results if each.failure)
        for text in failures:
            complain(text)
        return 1 if failures else 0

    return ask_units(options, ask, lambda unit, reason: printer(unit, [], reason))


# --- read --watch --------------------------------------------------------------------


def watch(options: argparse.Namespace) -> int:
    """Poll each unit; a lost connection is established again."""
    readers = [Reader(options, unit) for unit in units_of(options)]
    interval = min(reader.interval for reader in readers)
    is_answered, polls = False, 0
    with closing(connected(options)) as context, ExitStack() as stack:
        units = ",".join(str(reader.unit) for reader in readers)
        title = f"{context.url}, unit {units}, every {interval:g} s"
        printers = _printers(options, readers, title)

        def make() -> Any:
            from .shown_watch import ShownWatch

            shown = ShownWatch(title, interval)
            printers.append(shown.print)
            return shown

        stack.enter_context(over_http.tables_shown(make, options))
        try:
            for due in _times(interval, options.count, options.lasts or float("inf")):
                for reader in readers:
                    is_answered |= _poll(reader, context, due, printers)
                    polls += 1
        finally:
            if options.written_to and sys.stderr.isatty():
                print(f"{counted(polls, 'poll')} in {options.written_to}", file=sys.stderr)
    if not is_answered:
        raise CommandError("no poll was answered")
    return 0


def _times(interval: float, count: int | None, lasts: float) -> Iterator[float]:
    """Yield when each poll is due, and wait in between; polls that would be late are left out."""
    due = begun = time.monotonic()
    polls = 0
    while polls != count and due < begun + lasts:
        time.sleep(max(0.0, due - time.monotonic()))
        yield due
        polls += 1
        due = begun + ((time.monotonic() - begun) // interval + 1) * interval


def _poll(reader: Reader, context: Client, due: float, printers: Sequence[Printer]) -> bool:
    """Print the results of a unit, or why there are none; return True if there are results."""
    results, reason = list[ReadResult](), ""
    try:
        results = reader.ask(context, due)
    except (ModbusError, CommandError) as error:
        reason = f"{error}{advice(error)}"
    for each in printers:
        each(reader.unit, results, reason)
    return not reason


def _printers(options: argparse.Namespace, readers: Sequence[Reader], title: str) -> list[Printer]:
    """Return what prints the values to the output that was typed, and to a terminal."""
    is_file = options.written_to is not None
    screen: TextIO = options.screen
    has_cursor = screen.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    # Frames of --verbose would be printed into the table.
    is_table = has_cursor and not options.verbose and (is_file or not (options.csv or options.json))
    printers: list[Printer] = []
    if is_file or not is_table:
        several = len(readers) > 1
        printers.append(printer_of(options, readers[0].items, several=several, are_polls=True))
    if is_table:
        printers.append(TerminalTable(title, [each.unit for each in readers], screen).print)
    elif is_file:
        printers.append(partial(_complain, dict[int, str]()))
    return printers


def _complain(said: dict[int, str], unit: int, results: Sequence[ReadResult], reason: str) -> None:
    """Print why values of a unit are missing, when this is not what was `said` of it before."""
    text = reason or "; ".join(each.failure for each in results if each.failure)
    if text and text != said.get(unit):
        complain(text)
    said[unit] = text
