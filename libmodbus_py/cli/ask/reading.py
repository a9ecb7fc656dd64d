"""
The command read: the requests, and the results of all items.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, Protocol

from ...client.blocking import Context
from ...maps.holes import Holes
from ...maps.plan_run import PlanRun
from ...protocol.errors import (
    ExceptionResponse,
    IllegalDataAddress,
    ModbusError,
)
from ..connecting import connected, endpoint_of
from ..failing import CommandError, advice
from ..output import complain, print_json
from ..status import Status
from .formatters import Formatter, ReadResult, aligned, formatter_of
from .item_plan import Cells, ItemPlan
from .items import ALL, Item, Words
from .units import ask_units, client_of, fail, units_of

__all__ = ["Printer", "Reader", "object_of", "read", "readers_of"]

STATUS_AFTER = 1.0
"""Seconds until a status line is shown."""


class Reader:
    """
    Reads the items that were typed.

    Attributes:
        formatters: one for each item.
        unit: the unit that is asked.

    Args:
        unit: the unit that is asked.

    Raises:
        ValueError: an argument is wrong.
    """

    def __init__(self, options: argparse.Namespace, unit: int) -> None:
        words = Words(options, options.what)
        items = _items(words)
        # The points that scale others are read, too, if they are not among the items.
        sources = words.sources_of(items)
        self.formatters: list[Formatter] = [
            formatter_of(item, as_all=options.type == ALL, in_hex=options.hex) for item in items
        ]
        self._sources = [formatter_of(item, as_all=False, in_hex=False) for item in sources]
        self._plan = ItemPlan([*items, *sources])
        self._holes = Holes()
        client = endpoint_of(options).client_options
        self.unit = unit
        # Few devices take several requests at the same time.
        self._limit: int = client.get("max_in_flight") or 1

    def ask(self, context: Context) -> list[ReadResult]:
        """
        Ask for all items; if the device refuses one, the others are still read.

        What is refused is found by halving, and left out until it is tried again.

        Raises:
            ModbusError: there is no answer, or one that makes no sense.
            CommandError: the device refused the only item.
        """
        context.connect()
        context = client_of(context, self.unit)
        self._status = Status(after=STATUS_AFTER)
        try:
            run = PlanRun(self._plan.plan, self._holes, context.now(), *context.connection)
            while run.requests:
                run.take(self._answers(context, run.requests))
            found = self._plan.cells(run.answers, self._answers(context, self._plan.requests))
        finally:
            self._status.clear()
        count = len(self.formatters)
        self._scale(found[count:])
        results = [_result(*pair) for pair in zip(self.formatters, found[:count], strict=True)]
        if len(results) == 1 and results[0].failure:
            raise CommandError(results[0].failure)
        return results

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
                raise CommandError(_reason(answer, self.formatters[0].item))


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
    printer = _printer(options, [*readers.values()])
    with closing(connected(options)) as context:

        def ask(unit: int) -> int:
            results = readers[unit].ask(context)
            printer.print(unit, results)
            return _say_failures(results)

        return ask_units([*readers], ask, printer.fail)


def _printer(options: argparse.Namespace, readers: Sequence[Reader]) -> Printer:
    several = len(readers) > 1
    if options.csv:
        from .lines import CsvPolls

        return CsvPolls(readers[0].formatters, has_unit=several)
    return _JsonOnce() if options.json else _TextOnce(has_unit=several)


class Printer(Protocol):
    """Prints the results of a unit, or why there are none."""

    def print(self, unit: int, results: Sequence[ReadResult]) -> None: ...

    def fail(self, unit: int, reason: str) -> None: ...


class _JsonOnce:
    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        print_json(object_of(unit, results))

    def fail(self, unit: int, reason: str) -> None:
        fail(unit, reason, as_json=True, lacks="values")


class _TextOnce:
    def __init__(self, *, has_unit: bool) -> None:
        self._has_unit = has_unit

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        lines = aligned([(each.formatter, each.rows) for each in results])
        if self._has_unit:
            print(f"unit {unit}:")
            lines = [f"  {line}" for line in lines]
        if lines:
            print("\n".join(lines))

    def fail(self, unit: int, reason: str) -> None:
        fail(unit, reason, as_json=False, lacks="values")


def _say_failures(results: Sequence[ReadResult]) -> int:
    failed = dict.fromkeys(each.failure for each in results if each.failure)
    sys.stdout.flush()
    for text in failed:
        complain(text)
    return 1 if failed else 0


def _items(words: Words) -> list[Item]:
    if not words and words.map is not None:
        return words.whole_map()
    if not words:
        raise ValueError("WHAT is missing: name a table and an address, or --map FILE")
    items = []
    while words:
        item = words.take_item()
        items.append(item if item.point else replace(item, count=words.take_count(item)))
    return items


def _result(formatter: Formatter, cells: Cells) -> ReadResult:
    if isinstance(cells, ModbusError):
        return ReadResult(
            formatter, [], {**formatter.whence, "error": str(cells)}, _reason(cells, formatter.item)
        )
    try:
        rows, fields = formatter.rows(cells), formatter.fields(cells)
        return ReadResult(formatter, rows, fields, remark=formatter.remark(cells))
    except CommandError as error:
        return ReadResult(formatter, [], {**formatter.whence, "error": str(error)}, str(error))


def _reason(error: ModbusError, item: Item) -> str:
    hint = item.hint if isinstance(error, IllegalDataAddress) else advice(error)
    return f"{error}{hint}"


def object_of(unit: int, results: Sequence[ReadResult]) -> dict[str, Any]:
    """Return the object of JSON: values by name, one item, or a list of items."""
    told = [each.fields for each in results]
    if all(each.formatter.item.point for each in results):
        values = {each["name"]: each["value"] for each in told if "value" in each}
        errors = {each["name"]: each["error"] for each in told if "error" in each}
        none = {each["name"]: each["no_value"] for each in told if "no_value" in each}
        others = {"no_value": none, "errors": errors}
        return {
            "unit": unit,
            "values": values,
            **{key: found for key, found in others.items() if found},
        }
    return {"unit": unit, **(told[0] if len(told) == 1 else {"items": told})}
