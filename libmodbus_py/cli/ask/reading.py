"""
The command read: all items of a unit are asked for, and their results are printed.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, Protocol

from ...client.blocking import Context
from ...maps.holes import Holes, carried_out, reading
from ...maps.watched import PointIntervals, Totals
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.plain import time_text, without_controls
from ..connecting import connected, endpoint_of
from ..failing import CommandError
from ..output import complain, print_json
from ..screen import Status
from .formatters import Formatter, ReadResult, aligned, formatter_of, in_line
from .items import Cells, Item, ItemPlan, Words, reason_of
from .units import ask_units, client_of, fail, units_of

__all__ = ["Printer", "Reader", "printer_of", "read", "readers_of"]

ONCE_S = 1.0
"""The interval of a read without --watch, where it has no effect."""

MAX_PLANS = 64
"""Plans for different sets of items that are kept: intervals of points can combine to many."""

STATUS_AFTER_S = 1.0
"""Until a status line is shown: most reads are over by then."""


class Reader:
    """
    Reads the items that were typed.

    Attributes:
        formatters: one for each item.
        unit: the unit that is asked.
        interval: seconds from one poll to the next: that of --watch, or the shortest of a point.

    Args:
        unit: the unit that is asked.

    Raises:
        ValueError: an argument is wrong.
    """

    def __init__(self, options: argparse.Namespace, unit: int) -> None:
        words = Words(options, options.what)
        items = _items(words, options.group or ())
        # The points that scale others are read, too, if they are not among the items.
        sources = words.sources_of(items)
        self.formatters: list[Formatter] = [
            formatter_of(item, as_all=words.is_all, in_hex=options.hex) for item in items
        ]
        self._sources = [formatter_of(item, as_all=False, in_hex=False) for item in sources]
        self._plans: dict[tuple[int, ...], ItemPlan] = {(): ItemPlan([*items, *sources])}
        own = [None if item.point is None else item.point.interval for item in items]
        self._pace = PointIntervals(own, getattr(options, "watch", None) or ONCE_S)
        self.interval: float = self._pace.interval
        points = [item.point for item in items]
        self._totals = Totals(at for at, point in enumerate(points) if point and point.never_falls)
        self._results: dict[int, ReadResult] = {}
        self._holes = Holes()
        client = endpoint_of(options).client_options
        self.unit = unit
        # Few devices take several requests at the same time.
        self._limit: int = client.get("max_in_flight") or 1

    def ask(self, context: Context, at: float = 0.0) -> list[ReadResult]:
        """
        Ask for all items that are due; if the device refuses one, the others are still read.

        What is refused is found by halving, and left out until it is tried again. A total that is
        smaller than before is read again. Items that are not due have their last results.

        Args:
            at: when this poll is due, in seconds of any steady clock.

        Raises:
            ModbusError: there is no answer, or one that makes no sense.
            CommandError: the device refused the only item.
        """
        context.connect()
        context = client_of(context, self.unit)
        due = self._pace.due(at)
        found = self._read(context, due)
        doubtful = self._totals.take(self._values(found)).doubtful
        if doubtful:
            again = self._read(context, tuple(sorted(doubtful)))
            for at in self._totals.take(self._values(again)).fell:
                remark = f"{again[at].fields['name']} is smaller than before"
                again[at] = again[at]._replace(remark=remark, has_fallen=True)
            found |= again
        self._pace.done()
        self._results |= found
        results = [self._results[at] for at in range(len(self.formatters))]
        if len(results) == 1 and results[0].failure:
            raise CommandError(results[0].failure)
        return results

    def _read(self, context: Context, due: tuple[int, ...] | None) -> dict[int, ReadResult]:
        """Read the items with some indexes; None for all."""
        indexes = tuple(range(len(self.formatters))) if due is None else due
        formatters = [self.formatters[at] for at in indexes]
        plan = self._plan_of(due or (), formatters)
        self._status = Status(after=STATUS_AFTER_S)
        try:
            connects = context.statistics.connects
            steps = reading(plan.plan.blocks, self._holes, context.now(), connects)
            answers = carried_out(steps, lambda requests: self._answers(context, requests))
            found = plan.cells(answers, self._answers(context, plan.requests))
        finally:
            self._status.clear()
        count = len(formatters)
        self._scale(found[count:])
        pairs = zip(formatters, found[:count], strict=True)
        return {at: _result(*pair) for at, pair in zip(indexes, pairs, strict=True)}

    def _plan_of(self, due: tuple[int, ...], formatters: list[Formatter]) -> ItemPlan:
        if due not in self._plans:
            if len(self._plans) == MAX_PLANS:
                self._plans = {(): self._plans[()]}
            items = [each.item for each in (*formatters, *self._sources)]
            self._plans[due] = ItemPlan(items)
        return self._plans[due]

    def _values(self, found: dict[int, ReadResult]) -> list[Any]:
        fields = [found[at].fields if at in found else {} for at in range(len(self.formatters))]
        return [each.get("value") for each in fields]

    def _scale(self, found: Sequence[Cells]) -> None:
        """Pass the values of the points that scale others to these; one comes before those."""
        values: dict[str, Any] = {}
        for formatter, cells in zip(self._sources, found, strict=True):
            point = formatter.item.point
            assert point is not None
            formatter.source = values.get(point.scale_from or "")
            if not isinstance(cells, ModbusError):
                with contextlib.suppress(CommandError):
                    values[point.name] = formatter.fields(cells)["value"]
        for formatter in self.formatters:
            if formatter.item.point is not None:
                formatter.source = values.get(formatter.item.point.scale_from or "")

    def _answers(self, context: Context, requests: Sequence[Any]) -> list[Any]:
        answers: list[Any] = []
        while len(answers) < len(requests):
            self._status.show(f"{len(answers)} of {len(requests)} requests")
            some = requests[len(answers) : len(answers) + self._limit]
            answers.extend(
                context.execute_many(some, max_in_flight=self._limit, return_exceptions=True)
            )
            self._check(answers[-len(some) :])
        return answers

    def _check(self, answers: list[Any]) -> None:
        """Raise the error after which the remaining requests are not sent."""
        for answer in answers:
            if isinstance(answer, ModbusError) and not isinstance(answer, ExceptionResponse):
                raise answer
            if isinstance(answer, ModbusError) and len(self.formatters) == 1:
                raise CommandError(reason_of(answer, self.formatters[0].item))


# --- read once -----------------------------------------------------------------------


def readers_of(options: argparse.Namespace) -> list[Reader]:
    """
    Return a reader for each unit that was typed.

    Raises:
        ValueError: an argument is wrong.
    """
    return [Reader(options, unit) for unit in units_of(options)]


def read(options: argparse.Namespace) -> int:
    """Read each unit once, and print."""
    readers = {reader.unit: reader for reader in readers_of(options)}
    printer = printer_of(options, [*readers.values()], are_polls=False)
    with closing(connected(options)) as context:

        def ask(unit: int) -> int:
            results = readers[unit].ask(context)
            printer.print(unit, results)
            return _say_failures(results)

        return ask_units([*readers], ask, printer.fail)


def _say_failures(results: Sequence[ReadResult]) -> int:
    failed = dict.fromkeys(each.failure for each in results if each.failure)
    sys.stdout.flush()
    for text in failed:
        complain(text)
    return 1 if failed else 0


def _items(words: Words, groups: Sequence[str]) -> list[Item]:
    if groups and words.map is None:
        raise ValueError("--group needs --map FILE, which has the groups")
    if groups:
        return [item for group in groups for item in words.group(group)] + _typed_items(words)
    if not words and words.map is not None:
        return words.whole_map()
    if not words:
        raise ValueError("WHAT is missing: name a table and an address, or --map FILE")
    return _typed_items(words)


def _typed_items(words: Words) -> list[Item]:
    items = []
    while words:
        item = words.take_item()
        items.append(item if item.point else replace(item, count=words.take_count(item)))
    return items


def _result(formatter: Formatter, cells: Cells) -> ReadResult:
    if isinstance(cells, ModbusError):
        fields = {**formatter.whence, "error": str(cells)}
        return ReadResult(formatter, [], fields, reason_of(cells, formatter.item))
    try:
        rows, fields = formatter.rows(cells), formatter.fields(cells)
        return ReadResult(formatter, rows, fields, remark=formatter.remark(cells))
    except CommandError as error:
        return ReadResult(formatter, [], {**formatter.whence, "error": str(error)}, str(error))


# --- printers ------------------------------------------------------------------------


class Printer(Protocol):
    """Prints the results of a unit, or why there are none."""

    def print(self, unit: int, results: Sequence[ReadResult]) -> None: ...

    def fail(self, unit: int, reason: str) -> None: ...


def printer_of(
    options: argparse.Namespace, readers: Sequence[Reader], *, are_polls: bool
) -> Printer:
    """
    Return what prints results in the form that was typed.

    Args:
        are_polls: True for repeated reads, which are printed with the time.

    Raises:
        ValueError: an item cannot be printed in this form.
    """
    several = len(readers) > 1
    if options.csv:
        return CsvRows(readers[0].formatters, has_unit=several)
    if options.json:
        return JsonLines(has_time=are_polls)
    return TextLines(has_unit=several) if are_polls else Blocks(has_unit=several)


class Blocks:
    """Prints a line for each value; of several units, and of one item, a line for each unit."""

    def __init__(self, *, has_unit: bool) -> None:
        self._has_unit = has_unit

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        if self._has_unit and len(results) == 1 and not results[0].formatter.shows_all:
            print(f"unit {unit:<3}  {in_line(results[0], several=False)}", flush=True)
            return
        lines = aligned([(each.formatter, each.rows) for each in results])
        if self._has_unit:
            lines = [f"unit {unit}:", *(f"  {line}" for line in lines)]
        if lines:
            print("\n".join(lines))

    def fail(self, unit: int, reason: str) -> None:
        fail(unit, reason, as_json=False, lacks="values")


class TextLines:
    """Prints the time and the values of each poll; with their addresses if there are several."""

    def __init__(self, *, has_unit: bool = False) -> None:
        self._has_unit = has_unit

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        several = len(results) > 1
        self._print(unit, "  ".join(in_line(each, several=several) for each in results))

    def fail(self, unit: int, reason: str) -> None:
        self._print(unit, reason)

    def _print(self, unit: int, text: str) -> None:
        whence = f"unit {unit}  " if self._has_unit else ""
        print(f"{_now()}  {whence}{text}", flush=True)


class JsonLines:
    """Prints an object for each poll of a unit, which may begin with the time."""

    def __init__(self, *, has_time: bool) -> None:
        self._has_time = has_time

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        self._print(_object(unit, results))

    def fail(self, unit: int, reason: str) -> None:
        self._print({"unit": unit, "error": reason})

    def _print(self, fields: dict[str, Any]) -> None:
        print_json({"time": _now(), **fields} if self._has_time else fields)


class CsvRows:
    """Prints a header, then a row for each poll: the time, the unit, the values and the error."""

    def __init__(self, formatters: Sequence[Formatter], *, has_unit: bool = False) -> None:
        self._titles = [title for formatter in formatters for title in formatter.titles()]
        self._has_unit = has_unit
        self._begun = False

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        cells: list[str] = []
        for each in results:
            cells += [row.plain for row in each.rows] or [""] * len(each.formatter.titles())
        errors = "; ".join(filter(None, (each.failure or each.remark for each in results)))
        self._write(unit, [*cells, errors])

    def fail(self, unit: int, reason: str) -> None:
        self._write(unit, [*[""] * len(self._titles), reason])

    def _write(self, unit: int, cells: list[str]) -> None:
        if not self._begun:
            self._begun = True
            self._print(["time", *["unit"] * self._has_unit, *self._titles, "error"])
        self._print([_now(), *[str(unit)] * self._has_unit, *cells])
        sys.stdout.flush()

    def _print(self, cells: list[str]) -> None:
        from ...tools.files.csv_text import csv_rows

        text = csv_rows([cells])
        print(without_controls(text) if sys.stdout.isatty() else text, end="")


def _now() -> str:
    return time_text(time.time())


def _object(unit: int, results: Sequence[ReadResult]) -> dict[str, Any]:
    """Return the object of JSON: values by name, one item, or a list of items."""
    told = [each.fields for each in results]
    if all(each.formatter.item.point for each in results):
        values = {each["name"]: each["value"] for each in told if "value" in each}
        errors = {each["name"]: each["error"] for each in told if "error" in each}
        none = {each["name"]: each["no_value"] for each in told if "no_value" in each}
        fell = [each.fields["name"] for each in results if each.has_fallen]
        others = {"no_value": none, "errors": errors, "fell": fell}
        return {
            "unit": unit,
            "values": values,
            **{key: found for key, found in others.items() if found},
        }
    return {"unit": unit, **(told[0] if len(told) == 1 else {"items": told})}
