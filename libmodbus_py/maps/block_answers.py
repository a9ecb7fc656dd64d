"""
The results of one block in a run of a plan, in one request or in several.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..protocol import pdu
from ..protocol.errors import ModbusError
from ..protocol.tables import TABLES
from .holes import Span
from .pieces import Block, PartialAnswer

__all__ = ["BlockAnswer", "Portion"]


class BlockAnswer:
    """The results of one block in a run."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self.whole: Any = None
        self.cells: PartialAnswer | None = None
        self.errors: dict[int, ModbusError] = {}
        self._done: set[int] = set()
        self.is_answered = False
        self.found: dict[int, ModbusError] = {}

    def answered(self, span: Span, cells: Sequence[Any], first: int, last: int) -> None:
        self.is_answered = True
        if span == self.block.span:
            self.whole = cells
            return
        if self.cells is None:
            self.cells = PartialAnswer(self.block.span.start, len(range(*self.block.span[1:])))
        self.cells.put(span.start, cells)
        self._done.update(range(first, last))
        for at in [at for at in self.errors if first <= at < last]:
            del self.errors[at]

    def failed(self, error: ModbusError, first: int, last: int) -> None:
        for at in range(first, last):
            if at not in self._done:
                self.errors[at] = error

    @property
    def answer(self) -> Any:
        """The answer to the request of the block, as `Plan.results` takes it."""
        if self.whole is not None:
            return self.whole
        if self.cells is None:
            return self.errors[0]
        for at, error in self.errors.items():
            self.cells.fail(self.block.pieces[at], error)
        return self.cells


class Portion(NamedTuple):
    """The pieces first..last-1 of a block, in one request."""

    reading: BlockAnswer
    first: int
    last: int

    @property
    def span(self) -> Span:
        block = self.reading.block
        is_all = self.first == 0 and self.last == len(block.pieces)
        return block.span if is_all else block.span_between(self.first, self.last)

    @property
    def request(self) -> pdu.Request[list[Any]]:
        table, start, stop = self.span
        return TABLES[table].read(start, stop - start)
