"""
The command read: all items of a unit are asked for, once. With --watch `watching` does it again and
again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from ...client.blocking import Client
from ...protocol.checks import integer
from ...protocol.errors import ExceptionResponse, ModbusError
from ..main import CommandError
from ..output import Status, complain
from .formatters import ReadResult, printer_of, result_of
from .items import Item, Words, cells_of, reason_of, requests_of
from .units import ask_units, client_of, units_of

if TYPE_CHECKING:
    from .item_plan import ItemPlan

STATUS_AFTER_S = 1.0
"""Until a status line is shown: most reads are over by then."""


class Reader:
    """Reads the items that were typed from one unit; a single one needs no plan."""

    def __init__(self, options: argparse.Namespace, unit: int) -> None:
        words = Words(options, options.what)
        self.items: list[Item] = words.all_items(options.group or ())
        self.unit = unit
        self._sources = words.sources_of(self.items)
        max_registers = integer("max_registers", options.max_registers, 1, 125)
        self._requests: list[Any] = []
        self._plan: ItemPlan | None = None
        if len(self.items) == 1 and self.items[0].point is None:
            self._requests = requests_of(self.items[0], max_registers)
        else:
            from .item_plan import ItemPlan

            items = [*self._sources, *self.items]
            self._plan = ItemPlan(items, words.borders(), max_registers)

    def ask(self, client: Client, due: Sequence[int] | None = None) -> dict[int, ReadResult]:
        """
        Ask for the items with some indexes, None for all, and for the points that scale them; if
        the device refuses one, the others are still read.

        Raises ModbusError for no answer, or one that makes no sense, CommandError if the device
        refused the only item.
        """
        client.connect()
        client = client_of(client, self.unit)
        indexes = range(len(self.items)) if due is None else due
        items = [*self._sources, *(self.items[at] for at in indexes)]
        status = Status(after=STATUS_AFTER_S)
        ask = partial(self._answers, client, status)
        try:
            if self._plan is None:
                cells = {0: cells_of(items[0], ask(self._requests))}
            else:
                plan = self._plan if due is None else self._plan.of(items)
                cells = plan.cells(ask, client.statistics.connects)
        finally:
            status.clear()
        results: list[ReadResult] = []
        values: dict[str, Any] = {}
        for at, item in enumerate(items):
            source = None if item.point is None else values.get(item.point.scale_from or "")
            results.append(result_of(item, cells[at], source))
            if item.point is not None:
                values[item.point.name] = results[at].fields.get("value")
        if len(self.items) == 1 and results[-1].failure:
            raise CommandError(results[-1].failure)
        return dict(zip(indexes, results[len(self._sources) :], strict=True))

    def _answers(self, client: Client, status: Status, requests: Sequence[Any]) -> list[Any]:
        """Send requests up to the first failure that ends the read, which is raised."""
        answers: list[Any] = []
        while len(answers) < len(requests):
            status.show(f"{len(answers)} of {len(requests)} requests")
            some = requests[len(answers) : len(answers) + client.max_in_flight]
            answers += client.execute_many(some, return_exceptions=True)
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
        results = [*readers[client.unit].ask(client).values()]
        printer(client.unit, results, "")
        sys.stdout.flush()
        failures = dict.fromkeys(result.failure for result in results if result.failure)
        for text in failures:
            complain(text)
        return 1 if failures else 0

    return ask_units(options, ask, lambda unit, reason: printer(unit, [], reason))
