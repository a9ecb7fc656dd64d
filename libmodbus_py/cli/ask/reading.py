"""
The command read: all items of a unit are asked for, and their results are printed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from typing import Any

from ...client.blocking import Context
from ...maps.holes import Holes, carried_out, reading
from ...maps.plan import Plan
from ...maps.watched import PointIntervals, Totals
from ...protocol import pdu
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.plain import time_text, without_controls
from ..connecting import connected, endpoint_of
from ..failing import CommandError
from ..output import complain, print_json
from ..screen import Status
from .formatters import ReadResult, aligned, in_line, result_of, titles
from .items import ALL, REGISTERS, Item, Words, reason_of
from .units import ask_units, client_of, fail, units_of

__all__ = ["Printer", "Reader", "printer_of", "read", "readers_of"]

ONCE_S = 1.0
"""The interval of a read without --watch, where it has no effect."""

STATUS_AFTER_S = 1.0
"""Until a status line is shown: most reads are over by then."""

USUAL_RECORDS = 121
"""Records of a request; the byte count of an answer goes to 245 (section 6.14), although 251 would
fit, so that longer requests are sent only for a count that asks for them."""

Printer = Callable[[int, Sequence[ReadResult], str], None]
"""Prints the results of a unit, or the reason why there are none."""


class _ItemPlan(Plan):
    """A plan of items whose results are cells; `others` are the requests for files and queues."""

    def __init__(self, items: Sequence[Item]) -> None:
        self._others = {
            at: _of_file(item) if item.table == "file" else _of_queue(item)
            for at, item in enumerate(items)
            if item.table in ("file", "fifo_queue")
        }
        self.others = [each for requests in self._others.values() for each in requests]
        super().__init__({at: item.read for at, item in enumerate(items) if at not in self._others})

    def cells(self, answers: Sequence[Any], others: Sequence[Any]) -> dict[int, Any]:
        """Return the cells of each item by its index, or the error in place of them."""
        found: dict[int, Any] = self.results(answers)
        given = iter(others)
        for at, requests in self._others.items():
            found[at] = _joined([next(given) for _ in requests])
        return found

    def _decoded(self, name: Any, cells: list[Any]) -> Any:
        return [int(cell) for cell in cells]


def _joined(answers: list[Any]) -> list[int] | ModbusError:
    cells: list[int] = []
    for answer in answers:
        if isinstance(answer, ModbusError):
            return answer
        cells += answer[0] if answer and isinstance(answer[0], list) else answer
    return cells


def _of_file(item: Item) -> list[pdu.Request[Any]]:
    """Return requests that divide no value, because its halves could be of different age."""
    most, cells = REGISTERS["file"][0], item.count * item.size
    if item.kind is not None and item.size > most:
        raise ValueError(f"{item.kind.name} takes {item.size} registers, and a request {most}")
    if item.count < 1:
        raise ValueError(f"count must be 1 or more, not {item.count}")
    step = max(USUAL_RECORDS // item.size, 1) * item.size if cells > most else cells
    stop = item.address + cells
    return [
        pdu.ReadFileRecords(((item.file, at, min(step, stop - at)),))
        for at in range(item.address, stop, step)
    ]


def _of_queue(item: Item) -> list[pdu.Request[Any]]:
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
        self._plan = _ItemPlan([*self._sources, *self.items])
        points = [item.point for item in self.items]
        own = [None if point is None else point.interval for point in points]
        self._pace = PointIntervals(own, getattr(options, "watch", None) or ONCE_S)
        self.interval: float = self._pace.interval
        self._totals = Totals(at for at, point in enumerate(points) if point and point.never_falls)
        self._results: dict[int, ReadResult] = {}
        self._holes = Holes()
        # Few devices take several requests at the same time.
        self._limit: int = endpoint_of(options).client_options.get("max_in_flight") or 1

    def ask(self, context: Context, at: float = 0.0) -> list[ReadResult]:
        """
        Ask for all items that are due; if the device refuses one, the others are still read.

        A total that is smaller than before is read again. Items that are not due have their last
        results. `at` is when this poll is due, in seconds of any steady clock. Raises ModbusError
        for no answer, or one that makes no sense, CommandError if the device refused the only item.
        """
        context.connect()
        context = client_of(context, self.unit)
        found = self._read(context, self._pace.due(at))
        if doubtful := self._totals.take(self._values(found)).doubtful:
            again = self._read(context, tuple(sorted(doubtful)))
            for index in self._totals.take(self._values(again)).fell:
                remark = f"{again[index].fields['name']} is smaller than before"
                again[index] = again[index]._replace(remark=remark, has_fallen=True)
            found |= again
        self._pace.done()
        self._results |= found
        results = [self._results[index] for index in range(len(self.items))]
        if len(results) == 1 and results[0].failure:
            raise CommandError(results[0].failure)
        return results

    def _read(self, context: Context, due: tuple[int, ...] | None) -> dict[int, ReadResult]:
        """Read the items with some indexes, None for all, and the points that scale them."""
        indexes = tuple(range(len(self.items))) if due is None else due
        items = [*self._sources, *(self.items[at] for at in indexes)]
        plan = self._plan if due is None else _ItemPlan(items)
        status = Status(after=STATUS_AFTER_S)
        ask = partial(self._answers, context, status)
        try:
            facts = self._holes, context.now(), context.statistics.connects
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
        fields = [found[at].fields if at in found else {} for at in range(len(self.items))]
        return [each.get("value") for each in fields]

    def _answers(self, context: Context, status: Status, requests: Sequence[Any]) -> list[Any]:
        """Send requests up to the first failure that ends the read, which is raised."""
        answers: list[Any] = []
        while len(answers) < len(requests):
            status.show(f"{len(answers)} of {len(requests)} requests")
            some = requests[len(answers) : len(answers) + self._limit]
            answers += context.execute_many(some, max_in_flight=self._limit, return_exceptions=True)
            for answer in answers[-len(some) :]:
                if isinstance(answer, ModbusError) and not isinstance(answer, ExceptionResponse):
                    raise answer
                if isinstance(answer, ModbusError) and len(self.items) == 1:
                    raise CommandError(reason_of(answer, self.items[0]))
        return answers


# --- read once -----------------------------------------------------------------------


def readers_of(options: argparse.Namespace) -> list[Reader]:
    """Return a reader for each unit that was typed."""
    return [Reader(options, unit) for unit in units_of(options)]


def read(options: argparse.Namespace) -> int:
    """Read each unit once, and print."""
    readers = {reader.unit: reader for reader in readers_of(options)}
    printer = printer_of(options, [*readers.values()], are_polls=False)
    with closing(connected(options)) as context:

        def ask(unit: int) -> int:
            results = readers[unit].ask(context)
            printer(unit, results, "")
            sys.stdout.flush()
            failures = dict.fromkeys(each.failure for each in results if each.failure)
            for text in failures:
                complain(text)
            return 1 if failures else 0

        return ask_units([*readers], ask, lambda unit, reason: printer(unit, [], reason))


# --- printers ------------------------------------------------------------------------


def printer_of(
    options: argparse.Namespace, readers: Sequence[Reader], *, are_polls: bool
) -> Printer:
    """Return what prints results in the form that was typed; those of polls with the time."""
    several = len(readers) > 1
    if options.csv:
        return _CsvRows(readers[0].items, has_unit=several).print
    if options.json:
        return partial(_print_object, has_time=are_polls)
    return partial(_print_line if are_polls else _print_lines, has_unit=several)


def _print_lines(unit: int, results: Sequence[ReadResult], reason: str, *, has_unit: bool) -> None:
    """Print a line for each value; of several units, and of one item, a line for each unit."""
    if reason:
        fail(unit, reason, as_json=False, lacks="values")
        return
    if has_unit and len(results) == 1 and results[0].item.form != ALL:
        print(f"unit {unit:<3}  {in_line(results[0], several=False)}", flush=True)
        return
    lines = aligned(results)
    if has_unit:
        lines = [f"unit {unit}:", *(f"  {line}" for line in lines)]
    if lines:
        print("\n".join(lines))


def _print_line(unit: int, results: Sequence[ReadResult], reason: str, *, has_unit: bool) -> None:
    """Print the time and the values of a poll; with their addresses if there are several."""
    several = len(results) > 1
    text = reason or "  ".join(in_line(each, several=several) for each in results)
    whence = f"unit {unit}  " if has_unit else ""
    print(f"{time_text(time.time())}  {whence}{text}", flush=True)


def _print_object(unit: int, results: Sequence[ReadResult], reason: str, *, has_time: bool) -> None:
    """Print an object of JSON: values by name, one item, or a list of items."""
    fields = {"error": reason} if reason else _fields(results)
    when = {"time": time_text(time.time())} if has_time else {}
    print_json({**when, "unit": unit, **fields})


def _fields(results: Sequence[ReadResult]) -> dict[str, Any]:
    items = [each.fields for each in results]
    if not all(each.item.point for each in results):
        return items[0] if len(items) == 1 else {"items": items}
    by_name = {
        key: {each["name"]: each[field] for each in items if field in each}
        for key, field in (("values", "value"), ("no_value", "no_value"), ("errors", "error"))
    }
    fell = [each.fields["name"] for each in results if each.has_fallen]
    others = {key: found for key, found in {**by_name, "fell": fell}.items() if found}
    return {"values": {}, **others}


class _CsvRows:
    """Prints a header, then a row for each poll: the time, the unit, the values and the error."""

    def __init__(self, items: Sequence[Item], *, has_unit: bool) -> None:
        self._titles = [title for item in items for title in titles(item)]
        self._has_unit = has_unit
        self._has_begun = False

    def print(self, unit: int, results: Sequence[ReadResult], reason: str) -> None:
        cells: list[str] = [] if results else [""] * len(self._titles)
        for each in results:
            cells += [row.plain for row in each.rows] or [""] * len(titles(each.item))
        remarks = filter(None, (each.failure or each.remark for each in results))
        if not self._has_begun:
            self._has_begun = True
            self._print(["time", *["unit"] * self._has_unit, *self._titles, "error"])
        whence = [time_text(time.time()), *[str(unit)] * self._has_unit]
        self._print([*whence, *cells, reason or "; ".join(remarks)])
        sys.stdout.flush()

    def _print(self, cells: list[str]) -> None:
        from ...tools.files.csv_text import csv_rows

        text = csv_rows([cells])
        print(without_controls(text) if sys.stdout.isatty() else text, end="")
