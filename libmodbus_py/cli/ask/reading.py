"""
Reading: the requests, one after the other, and what they gave of each item.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

from ...client.blocking import Context
from ...protocol.errors import ExceptionResponse, IllegalDataAddress, ModbusError
from ..connecting import connected, endpoint_of
from ..failing import CommandError
from ..output import PROGRAM
from ..status import Status
from .asking import Cells, Question
from .items import ALL, Item, Words
from .views import Outcome, View, aligned, view_of

__all__ = ["Reader", "object_of", "read"]

PATIENCE = 1.0
"""Seconds that need no progress."""


class Reader:
    """
    What was asked for on the command line.

    Attributes:
        views: how each of the items is shown.
        unit: who is asked.

    Raises:
        ValueError: what was typed is wrong.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        items = _items(Words(options, options.what))
        self.views: list[View] = [
            view_of(item, as_all=options.type == ALL, in_hex=options.hex) for item in items
        ]
        self._question = Question(items)
        told = endpoint_of(options).client_options
        self.unit: int = told.get("unit", 1)
        # Devices that take several requests at a time are the exception.
        self._limit: int = told.get("max_in_flight") or 1

    def ask(self, context: Context) -> list[Outcome]:
        """
        Ask for all items; one that the device refuses does not hinder the others.

        Raises:
            ModbusError: it answers nothing at all, or nothing that makes sense.
            CommandError: the only item was refused.
        """
        found = self._question.cells(self._answers(context))
        outcomes = [_outcome(*pair) for pair in zip(self.views, found, strict=True)]
        if len(outcomes) == 1 and outcomes[0].failure:
            raise CommandError(outcomes[0].failure)
        return outcomes

    def _answers(self, context: Context) -> list[Any]:
        context.connect()
        requests = self._question.requests
        answers: list[Any] = []
        status = Status(after=PATIENCE)
        try:
            while len(answers) < len(requests):
                status.show(f"{len(answers)} of {len(requests)} requests")
                some = requests[len(answers) : len(answers) + self._limit]
                answers.extend(
                    context.execute_many(some, max_in_flight=self._limit, return_exceptions=True)
                )
                self._check(answers[-len(some) :])
        finally:
            status.clear()
        return answers

    def _check(self, answers: list[Any]) -> None:
        """Who is asked for a thousand things and answers nothing is not asked for the others."""
        for answer in answers:
            if isinstance(answer, ModbusError) and not isinstance(answer, ExceptionResponse):
                raise answer
            if isinstance(answer, ModbusError) and len(self.views) == 1:
                raise CommandError(_reason(answer, self.views[0].item))


def read(options: argparse.Namespace) -> int:
    """Read once, and print."""
    reader = Reader(options)
    lines = None
    if options.csv:
        from .lines import CsvLines

        lines = CsvLines(reader.views)
    with closing(connected(options)) as context:
        outcomes = reader.ask(context)
    if options.json:
        import json

        print(json.dumps(object_of(reader, outcomes)))
    elif lines is not None:
        lines.print(outcomes)
    else:
        _print_rows(outcomes)
    return _say_failures(outcomes)


def _print_rows(outcomes: Sequence[Outcome]) -> None:
    lines = aligned([(each.view, each.rows) for each in outcomes])
    if lines:
        print("\n".join(lines))


def _say_failures(outcomes: Sequence[Outcome]) -> int:
    failed = dict.fromkeys(each.failure for each in outcomes if each.failure)
    sys.stdout.flush()
    for text in failed:
        print(f"{PROGRAM}: {text}", file=sys.stderr)
    return 1 if failed else 0


def _items(words: Words) -> list[Item]:
    if not words and words.map is not None:
        return words.whole_map()
    if not words:
        raise ValueError("WHAT is missing: there is nothing to read")
    items = []
    while words:
        item = words.take_item()
        items.append(item if item.point else replace(item, count=words.take_count(item)))
    return items


def _outcome(view: View, cells: Cells) -> Outcome:
    if isinstance(cells, ModbusError):
        return Outcome(view, [], {**view.whence, "error": str(cells)}, _reason(cells, view.item))
    try:
        return Outcome(view, view.rows(cells), view.fields(cells))
    except CommandError as error:
        return Outcome(view, [], {**view.whence, "error": str(error)}, str(error))


def _reason(error: ModbusError, item: Item) -> str:
    return f"{error}{item.hint}" if isinstance(error, IllegalDataAddress) else str(error)


def object_of(reader: Reader, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Give the object of JSON: by names, or of one item, or of several."""
    told = [each.fields for each in outcomes]
    if all(view.item.point for view in reader.views):
        values = {each["name"]: each["value"] for each in told if "value" in each}
        errors = {each["name"]: each["error"] for each in told if "error" in each}
        return {"unit": reader.unit, "values": values, **({"errors": errors} if errors else {})}
    return {"unit": reader.unit, **(told[0] if len(told) == 1 else {"items": told})}
