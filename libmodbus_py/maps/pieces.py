"""
The parts of a request that a device may refuse one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..protocol.errors import ModbusError
from ..protocol.tables import TABLES
from .holes import Span

__all__ = ["Block", "BlockPiece", "PartialAnswer"]

_TABLE_OF: dict[Any, str] = {rules.read: table for table, rules in TABLES.items()}


class BlockPiece(NamedTuple):
    """
    Cells that a request of a plan reads together or not at all.

    Attributes:
        start, stop: their addresses; `stop` is the one behind the last.
        names: of the items of which they are a part, or the whole.
    """

    start: int
    stop: int
    names: tuple[Any, ...]


class PartialAnswer(list[Any]):
    """
    The cells of an answer, with None for those that could not be read.

    Args:
        start: the address of the first cell.
        size: the number of cells.

    Attributes:
        lost: the names of the items that could not be read.
    """

    def __init__(self, start: int, size: int) -> None:
        super().__init__([None] * size)
        self._start = start
        self._errors: dict[tuple[int, int], ModbusError] = {}
        self.lost: list[Any] = []

    def put(self, start: int, cells: Sequence[Any]) -> None:
        """Set the cells that begin at an address."""
        at = start - self._start
        self[at : at + len(cells)] = cells

    def fail(self, piece: BlockPiece, error: ModbusError) -> None:
        """Note why a piece could not be read."""
        self._errors[piece.start - self._start, piece.stop - self._start] = error
        self.lost += piece.names

    @property
    def error(self) -> ModbusError | None:
        """The first error of cells that could not be read."""
        return next(iter(self._errors.values()), None)

    def error_of(self, start: int, stop: int) -> ModbusError | None:
        """Return why answer[start:stop] could not be read; None if it was."""
        return self._errors.get((start, stop))


class Block:
    """
    One request of a plan, and the pieces that it reads, in the order of their addresses.

    Args:
        request: the request.
        parts: the places of the pieces in its answer, and their names.

    Attributes:
        span: all cells of the request.
        pieces: those of which each is read as a whole, or not at all.
    """

    def __init__(self, request: Any, parts: list[tuple[int, int, tuple[Any, ...]]]) -> None:
        start: int = request.address
        self.span: Span = Span(_TABLE_OF[type(request)], start, start + request.count)
        self.pieces: tuple[BlockPiece, ...] = tuple(
            BlockPiece(start + first, start + last, names) for first, last, names in parts
        )

    def span_of(self, piece: BlockPiece) -> Span:
        """Return the cells of a piece."""
        return Span(self.span.table, piece.start, piece.stop)

    def span_between(self, first: int, last: int) -> Span:
        """Return the cells of the pieces first..last-1."""
        pieces = self.pieces[first:last]
        return Span(self.span.table, pieces[0].start, max(piece.stop for piece in pieces))
