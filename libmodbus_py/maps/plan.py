"""
A poll plan: many small reads merged into few requests, made once and run often.

It does no I/O. The clients run a plan (``read_many``); a program with its own transport sends
``plan.requests`` and passes the results to ``plan.results``.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from heapq import heapify, heappop, heappush
from itertools import chain
from typing import Any, NamedTuple

from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import ModbusError
from ..protocol.mistakes import WrongType, WrongValue, inside, named_arguments
from ..protocol.tables import TABLE_SIZE, TABLES, checked_ranges, checked_table, joined, touches
from ..protocol.value_types import cells_of
from .items import Borders, Forbidden, Items, NamedValues, PlanOptions, Read, checked_items
from .meaning import no_value
from .refusals import Block, BlockPiece, PartialAnswer, Refusals, Span, UnreadableItem


class _Part(NamedTuple):
    """The location of a piece of an item in the answers: answers[request][start:stop]."""

    request: int
    start: int
    stop: int


class _Rest(NamedTuple):
    """The rest of an item; groups of `step` cells in it must stay together."""

    start: int
    stop: int
    item: int
    step: int


@named_arguments
class Plan:
    """
    Many reads of one unit, merged into few requests.

    Items of a table share a request if they touch or overlap, or if the distance between them
    is not more than `gap`; there are as few requests as that allows. An item that fits into one
    request is never split, so that all its cells are read at the same moment. A longer item is
    split, but not inside a typed value, whose halves would then be read at different moments.

    A device may refuse a request because it covers cells that do not exist or cannot be read. A
    client finds the items that a device refuses once, by halving that request, and then leaves
    them out: see the method `unreadable` of clients. Cells between items that must not be read can
    be named in `forbidden`.

    Args:
        items: a list in which each item is a `Read` or a tuple of its arguments, such as
            ("coils", 10, 3) or ("holding_registers", 100, 2, "float32"), where the count
            may be left out; or a mapping from names to such items.
        gap: the most consecutive cells outside the items that may be read to save a request,
            0..2000.
        forbidden: pairs (table, range of addresses) that must never be read,
            such as ("holding_registers", range(40, 50)).
        max_registers: the most registers that one request may ask for, 1..125.
        max_bits: the most coils or discrete inputs that one request may ask for, 1..2000.
        borders: pairs (table, address) of cells before which a request must end, because the
            device refuses requests for cells on both sides, such as ("holding_registers", 100).

    Attributes:
        requests: request objects of `libmodbus_py.pdu`, table by table, in the order of
            addresses.

    Raises:
        TypeError, ValueError: an argument is of the wrong type or range, an item touches a
            forbidden range, a value is longer than `max_registers`, or crosses a border. The
            message names the item.
    """

    requests: tuple[pdu.Request[list[Any]], ...]

    def __init__(
        self,
        items: Items,
        *,
        gap: int = 0,
        forbidden: Forbidden = (),
        max_registers: int = 125,
        max_bits: int = 2000,
        borders: Borders = (),
    ) -> None:
        self._gap = integer("gap", gap, 0, 2000)
        self._forbidden = _checked_forbidden(forbidden)
        self._borders = _checked_borders(borders)
        registers = integer("max_registers", max_registers, 1, 125)
        bits = integer("max_bits", max_bits, 1, 2000)
        self._reads = checked_items(items)
        self._is_named = isinstance(items, Mapping)
        self._parts: dict[Any, list[_Part]] = {name: [] for name in self._reads}
        self._requests: list[pdu.Request[list[Any]]] = []
        self._check_reads(registers)
        for table, rules in TABLES.items():
            self._merge(table, bits if rules.is_bits else registers)
        self.requests = tuple(self._requests)

    def results(self, answers: Iterable[Sequence[Any] | ModbusError]) -> Any:
        """
        Return the values of the items.

        Args:
            answers: the answer to each of `requests`, in their order: a list
                of cells, or a ModbusError.

        Returns:
            A list with the values of each item, which are always a list, in the order of the items;
            a dict by name if the items have names. An item that was part of a failed
            request has the ModbusError instead. None stands for data that is no value, such as
            a bcd16 with the digit F; an item without any value has a `NoValue` instead.

        Raises:
            ValueError: the answers do not fit the requests.
        """
        answers = self._checked_answers(list(answers))
        values = NamedValues({name: self._values(name, answers) for name in self._reads})
        return values if self._is_named else list(values.values())

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The pieces of each request, in the order of their addresses."""
        blocks: list[dict[Span, list[Any]]] = [{} for _ in self.requests]
        for name, parts in self._parts.items():
            for at, start, stop in parts:
                first: int = self.requests[at].address  # type: ignore[attr-defined]
                span = Span(self._reads[name].table, first + start, first + stop)
                blocks[at].setdefault(span, []).append(name)
        return tuple(
            [BlockPiece(span, tuple(pieces[span])) for span in sorted(pieces)] for pieces in blocks
        )

    def _cells(self, name: Any, answers: list[Any]) -> Any:
        """Return the cells of an item, or the error of a request."""
        cells: list[Any] = []
        for request, start, stop in self._parts[name]:
            answer = answers[request]
            if isinstance(answer, ModbusError):
                return answer
            if isinstance(answer, PartialAnswer) and (error := answer.errors.get((start, stop))):
                return error
            cells += answer[start:stop]
        return cells

    def _values(self, name: Any, answers: list[Any]) -> Any:
        kind, cells = self._reads[name].kind, self._cells(name, answers)
        if kind is None or isinstance(cells, ModbusError):
            return cells
        values = kind.values_in(cells_of(cells))
        errors = [value for value in values if isinstance(value, ValueError)]
        if len(errors) == len(values):
            return no_value(f"items[{name!r}]", kind, errors[0])
        return [None if isinstance(value, ValueError) else value for value in values]

    def _checked_answers(self, answers: list[Any]) -> list[Any]:
        if len(answers) != len(self.requests):
            form = f"one for each of {len(self.requests)} requests"
            raise WrongValue("answers", f"must hold {form}, not {len(answers)}")
        for at, (answer, request) in enumerate(zip(answers, self.requests, strict=True)):
            count: int = request.count  # type: ignore[attr-defined]
            if not isinstance(answer, ModbusError) and len(answer) != count:
                raise ValueError(f"answers[{at}] must hold {count} values, not {len(answer)}")
        return answers

    def _check_reads(self, max_registers: int) -> None:
        for name, read in self._reads.items():
            if read.kind is not None and read.size > max_registers:
                reason = f"{read.type} takes {read.size} registers"
                limit = f"which is more than max_registers, {max_registers}"
                raise ValueError(f"items[{name!r}]: {reason}, {limit}")
            for run in self._forbidden[read.table]:
                if touches([run], read.address, len(read.cells)):
                    raise ValueError(f"items[{name!r}]: {read} touches the forbidden {run}")
            for border in self._borders[read.table]:
                if border in read.cells and (border - read.address) % read.size:
                    raise ValueError(f"items[{name!r}]: {read} has a value across {border}")

    def _merge(self, table: str, limit: int) -> None:
        """Cover a table with the fewest requests, each from the lowest cell that is in none yet."""
        items = [(name, read) for name, read in self._reads.items() if read.table == table]
        pieces = [
            _Rest(read.address, read.cells.stop, at, self._size_together(read, limit))
            for at, (_, read) in enumerate(items)
        ]
        windows: list[range] = []  # the cells that each request reads
        heapify(pieces)
        while pieces:
            start, stop, at, step = heappop(pieces)
            if not windows or not self._fits(table, windows[-1], start, start + step, limit):
                windows.append(range(start, start))
            first = windows[-1].start
            end = min(first + limit, self._next_border(table, start))
            edge = min(stop, start + (end - start) // step * step)
            windows[-1] = range(first, max(windows[-1].stop, edge))
            number = len(self._requests) + len(windows) - 1
            self._parts[items[at][0]].append(_Part(number, start - first, edge - first))
            if edge < stop:
                heappush(pieces, _Rest(edge, stop, at, step))
        make = TABLES[table].read
        self._requests += [make(window.start, len(window)) for window in windows]

    def _fits(self, table: str, window: range, start: int, stop: int, limit: int) -> bool:
        between = start - window.stop
        return (
            stop <= min(window.start + limit, self._next_border(table, window.start))
            and between <= self._gap
            and not (between > 0 and touches(self._forbidden[table], window.stop, between))
        )

    def _next_border(self, table: str, start: int) -> int:
        """Return the first address behind `start` before which a request must end."""
        borders = self._borders[table]
        at = bisect_right(borders, start)
        return borders[at] if at < len(borders) else TABLE_SIZE

    def _size_together(self, read: Read, limit: int) -> int:
        """Return how many cells must be in one request: all of them, or those of one value."""
        count, stop = len(read.cells), read.cells.stop
        is_whole = count <= limit and stop <= self._next_border(read.table, read.address)
        return count if is_whole else read.size


def planned(items: Plan | Items, options: PlanOptions) -> Plan:
    """Return the plan itself, or a new plan made of the items."""
    if not isinstance(items, Plan):
        return Plan(items, **options)
    if options:
        raise ValueError(f"{', '.join(options)} must be given to the plan, not beside it")
    return items


def unreadable_of(plan: Plan, refusals: Refusals, device: str) -> list[UnreadableItem]:
    """Return the items of a plan that a device is known to refuse."""
    errors: dict[Any, ModbusError] = {}
    for span, names in chain.from_iterable(plan.blocks):
        if (past := refusals.pieces.get(span)) is not None:
            errors |= dict.fromkeys(names, past.error)
    return [
        UnreadableItem(device, name, read.table, read.cells, errors[name])
        for name, read in plan._reads.items()
        if name in errors
    ]


def _checked_forbidden(forbidden: object) -> dict[str, tuple[range, ...]]:
    ranges_of: dict[str, list[range]] = {table: [] for table in TABLES}
    pairs = list(forbidden) if isinstance(forbidden, Iterable) else [forbidden]
    for at, pair in enumerate(pairs):
        if not isinstance(pair, tuple) or len(pair) != 2 or not isinstance(pair[1], range):
            raise WrongType(("forbidden", at), f"must be a pair (table, range), not {pair!r}")
        with inside("forbidden", at):
            ranges_of[checked_table(pair[0])] += checked_ranges("the range", pair[1])
    return {table: joined(ranges) for table, ranges in ranges_of.items()}


def _checked_borders(borders: Borders) -> dict[str, list[int]]:
    begins: dict[str, set[int]] = {table: set() for table in TABLES}
    for at, pair in enumerate(borders):
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise WrongType(("borders", at), f"must be a pair (table, address), not {pair!r}")
        with inside("borders", at):
            begins[checked_table(pair[0])].add(integer("address", pair[1], 0, TABLE_SIZE - 1))
    return {table: sorted(addresses) for table, addresses in begins.items()}
