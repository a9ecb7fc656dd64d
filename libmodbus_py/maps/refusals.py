"""
The items of a plan that a device refuses, found by halving. No I/O, no clock.

A block is what one request of a plan reads: pieces, which are cells that are read together, because
a value is never cut. A device that cannot read one piece refuses the whole request, with exception
2, 3 or 4.

1. A request that is refused is halved, and both halves are asked for, until single pieces are
   known. A piece that is refused alone is left out. One among 20 pieces costs up to 10 requests.
2. Later runs leave such pieces out, and read what lies between two with one request.
3. If both halves of a refused request are answered, the device takes no request that long, or
   cannot read cells between the halves: later requests begin at the second half. This is a cut.
4. A run asks for one of them again, the one that was asked for longest ago, if that was ten minutes
   ago or on an earlier connection, or if all pieces are left out. If it is answered, the device has
   changed: all are forgotten, and asked for at once. Cuts are forgotten when they are as old.
5. While a run has no answer at all, it halves down to two pieces only, because each request may
   take the time that a gateway waits for a silent device; all that was refused is left out then.
6. Another failure, such as silence or a busy device, says nothing about pieces. It ends the
   search of that run.
7. Requests of which nothing is answered end with the first that is not, because each of the others
   would take as long. The next ones begin with another request: the device may be silent about some
   of them only.

Refusals are known by their cells, so that all plans of a unit share them.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NamedTuple, TypeVar

from ..protocol import pdu
from ..protocol.errors import (
    IllegalDataAddress,
    IllegalDataValue,
    ModbusError,
    ServerDeviceFailure,
    alike,
)
from ..protocol.tables import TABLES

RETRY_S = 600.0
"""Seconds after which what a device refused is tried again."""

Result = TypeVar("Result")
_PlanSteps = Generator[list[pdu.Request[Any]], list[Any], Result]


def is_refusal(outcome: object) -> bool:
    """True if an outcome is exception 2, 3 or 4, which can depend on the cells that are read."""
    # Other failures do not depend on cells: the function, a busy device, a gateway.
    return isinstance(outcome, IllegalDataAddress | IllegalDataValue | ServerDeviceFailure)


class Span(NamedTuple):
    """Cells of a table."""

    table: str
    start: int
    stop: int

    def __str__(self) -> str:
        count = self.stop - self.start
        cell = "coil or input" if TABLES[self.table].is_bits else "register"
        what = f"{self.start}" if count == 1 else f"{self.start}..{self.stop - 1}"
        return f"{self.table} {what} ({count} {cell}{'s' * (count > 1)})"


class BlockPiece(NamedTuple):
    """Cells that are read together or not at all, and the names of the items in them."""

    span: Span
    names: tuple[Any, ...]


Block = Sequence[BlockPiece]
"""The pieces of one request, or of a part of it, in the order of their addresses."""


def _span(block: Block) -> Span:
    return block[0].span._replace(stop=max(piece.span.stop for piece in block))


def _halves(block: Block) -> tuple[Block, Block]:
    middle = len(block) // 2
    return block[:middle], block[middle:]


def _request(block: Block) -> pdu.Request[list[Any]]:
    table, start, stop = _span(block)
    return TABLES[table].read(start, stop - start)


@dataclass(frozen=True, slots=True)
class UnreadableItem:
    """
    An item of a plan that a device refuses, and that is left out for a time.

    Attributes:
        device: the device, such as "tcp://192.0.2.10:502, unit 17".
        name: the item: the name of a point, the key of a mapping, or the index in a list.
        table: the table of its cells.
        cells: the addresses of its cells.
        error: the error with which the device refused it last.
    """

    device: str
    name: Any
    table: str
    cells: range
    error: ModbusError

    def __str__(self) -> str:
        cells = Span(self.table, self.cells.start, self.cells.stop)
        return f"{self.name}, {cells}: {_reason_of(self.error)}"


def _reason_of(error: ModbusError) -> str:
    """Return the reason of an error without the request that it is about."""
    return str(error.args[0]) if error.args else str(error)


class PastRefusal(NamedTuple):
    """When, and on which connection of its client, a device refused something last."""

    error: ModbusError
    at: float
    connects: int

    def is_due(self, now: float, connects: int) -> bool:
        return connects != self.connects or now - self.at >= RETRY_S


@dataclass(slots=True)
class Refusals:
    """The refusals of one unit, as one client knows them: pieces, cuts, and the first request."""

    pieces: dict[Span, PastRefusal] = field(default_factory=dict)
    cuts: dict[tuple[Any, ...], PastRefusal] = field(default_factory=dict)
    first: int = 0

    def __bool__(self) -> bool:
        return bool(self.pieces or self.cuts)

    def forget(self) -> None:
        self.pieces.clear()
        self.cuts.clear()


class PartialAnswer(list[Any]):
    """The cells of an answer, None where not read; the names that are lost, and errors of parts."""

    def __init__(self, size: int) -> None:
        super().__init__([None] * size)
        self.lost: list[Any] = []
        self.errors: dict[tuple[int, int], ModbusError] = {}


class _PlanRun:
    """One run of a plan at one unit: its outcomes, and the search for refused pieces."""

    def __init__(
        self, blocks: Sequence[Block], refusals: Refusals, now: float, connects: int
    ) -> None:
        self._blocks = blocks
        self._refusals = refusals
        # The first connection is made by the first request.
        self._time = now, max(connects, 1)
        self._read: dict[Span, Any] = {}  # piece -> its cells, or the error
        self._found: set[Span] = set()
        self._is_answered = False

    @property
    def _pieces(self) -> Iterator[BlockPiece]:
        return (piece for block in self._blocks for piece in block)

    def tolerant(self) -> _PlanSteps[list[Any]]:
        """Read all pieces except those refused before, and search for refused ones."""
        self._forget_old_cuts()
        reasons = self._refusals.pieces.copy()
        left_out = {piece: reasons[piece.span] for piece in self._pieces if piece.span in reasons}
        self._read = {piece.span: alike(past.error) for piece, past in left_out.items()}
        portions = self._portions()
        trials = sorted(left_out, key=lambda piece: left_out[piece].at)[:1]
        if portions and trials and not left_out[trials[0]].is_due(*self._time):
            trials = []
        refusals = yield from self._send([*portions, *([piece] for piece in trials)])
        for piece in trials:
            outcome = self._read[piece.span]
            if not isinstance(outcome, ModbusError):
                self._refusals.forget()
                for other in left_out.keys() - trials:
                    self._read.pop(other.span, None)
                refusals += yield from self._send(self._portions())
            else:
                error = outcome if is_refusal(outcome) else left_out[piece].error
                self._refusals.pieces[piece.span] = PastRefusal(error, *self._time)
        yield from self._search(refusals)
        return [self._answer(block) for block in self._blocks]

    def strict(self) -> _PlanSteps[list[Any]]:
        """Read everything; or return the first error, with the names of a piece refused alone."""
        self._forget_old_cuts()
        # Each with the refusal of the longer block that it is a part of.
        blocks: list[tuple[Block, ModbusError | None]]
        blocks = [(block, None) for block in self._portions()]
        halves: list[tuple[Block, Block, ModbusError]] = []
        spans: set[Span] = set()
        while blocks:
            outcomes = yield [_request(block) for block, _ in blocks]
            count = self._keep_answers(blocks, outcomes)
            if count == len(blocks):
                break
            (block, reason), outcome, rest = blocks[count], outcomes[count], blocks[count + 1 :]
            if not is_refusal(outcome):
                return [reason or outcome]
            if len(block) == 1:
                return [self._named(block[0])]
            if pieces := [piece for piece in block if piece.span in self._refusals.pieces][:1]:
                blocks = [(pieces, outcome), (block, reason), *rest]
                continue
            first, second = _halves(block)
            halves.append((first, second, outcome))
            spans.add(_span(block))
            blocks = [(first, outcome), (second, outcome), *rest]
        for first, second, error in halves:
            if spans.isdisjoint((_span(first), _span(second))):
                self._add_cut(second, error)
        return [self._answer(block) for block in self._blocks]

    def news(self) -> Iterator[str]:
        """Yield a sentence about all pieces that were refused side by side."""
        for block in self._blocks:
            for is_new, group in groupby(block, lambda piece: piece.span in self._found):
                if is_new:
                    pieces = list(group)
                    names = [str(name) for piece in pieces for name in piece.names]
                    text = ", ".join(names[:3]) + ", ..." * (len(names) > 3)
                    yield f"{text}, {_span(pieces)}: {_reason_of(self._read[pieces[0].span])}"

    def _forget_old_cuts(self) -> None:
        cuts = self._refusals.cuts
        for at in [at for at, refusal in cuts.copy().items() if refusal.is_due(*self._time)]:
            cuts.pop(at, None)

    def _portions(self) -> list[list[BlockPiece]]:
        """Return what is to be asked for, in as few requests as refusals and cuts allow."""
        portions: list[list[BlockPiece]] = []
        for block in self._blocks:
            is_open = False
            for piece in block:
                if piece.span in self._read:
                    is_open = False
                elif is_open and piece.span[:2] not in self._refusals.cuts:
                    portions[-1].append(piece)
                else:
                    portions.append([piece])
                    is_open = True
        return portions

    def _send(self, portions: Sequence[Block]) -> _PlanSteps[list[Block]]:
        """Read some pieces; return those blocks that are refused."""
        outcomes = (yield [_request(block) for block in portions]) if portions else []
        for block, outcome in zip(portions, outcomes, strict=True):
            self._keep(block, outcome)
        return [
            block for block, result in zip(portions, outcomes, strict=True) if is_refusal(result)
        ]

    def _keep(self, block: Block, outcome: Any) -> None:
        """Keep the cells of each piece of a block, or why they were not read."""
        is_error, first = isinstance(outcome, ModbusError), block[0].span.start
        self._is_answered |= not is_error
        for span, _ in block:
            cells = slice(span.start - first, span.stop - first)
            self._read[span] = outcome if is_error else outcome[cells]

    def _keep_answers(
        self, requests: Sequence[tuple[Block, object]], outcomes: Sequence[Any]
    ) -> int:
        """Keep outcomes up to the first failure; return the number before the failure."""
        for at, ((block, _), outcome) in enumerate(zip(requests, outcomes, strict=False)):
            self._keep(block, outcome)
            if isinstance(outcome, ModbusError):
                return at
            if any(piece.span in self._refusals.pieces for piece in block):
                self._refusals.forget()
        return len(requests)

    def _has_failed(self, block: Block) -> bool:
        """Return True if what was sent for a block failed, but was not refused."""
        outcome = self._read[block[0].span]
        return isinstance(outcome, ModbusError) and not is_refusal(outcome)

    def _search(self, blocks: list[Block]) -> _PlanSteps[None]:
        """Find the pieces to leave out in what was refused."""
        blocks.sort(key=len, reverse=True)
        is_second = False  # True once a piece was refused alone
        while blocks:
            block = blocks.pop(0)
            if len(block) == 1:
                self._add(block[0])
                if is_second and not self._is_answered:
                    for piece in self._pieces:
                        if is_refusal(self._read[piece.span]):
                            self._add(piece)
                    return
                is_second = True
                continue
            error, halves = self._read[block[0].span], _halves(block)
            again = yield from self._send(halves)
            if any(map(self._has_failed, halves)):
                return
            if not again:
                self._add_cut(halves[1], error)
            blocks = [*again, *blocks]

    def _named(self, piece: BlockPiece) -> ModbusError:
        """Return the refusal of a piece that was refused alone, with the names of its items."""
        self._add(piece)
        error: ModbusError = self._read[piece.span]
        error.names = piece.names
        return error

    def _add(self, piece: BlockPiece) -> None:
        if piece.span not in self._refusals.pieces:
            self._found.add(piece.span)
        self._refusals.pieces[piece.span] = PastRefusal(self._read[piece.span], *self._time)

    def _add_cut(self, block: Block, error: ModbusError) -> None:
        """Note that requests begin with a block."""
        self._refusals.cuts[block[0].span[:2]] = PastRefusal(error, *self._time)

    def _answer(self, block: Block) -> Any:
        """Return the answer to the request of a block, as `Plan.results` takes it."""
        answers = [self._read[span] for span, _ in block]
        if all(isinstance(result, ModbusError) for result in answers):
            return answers[0]
        _, first, end = _span(block)
        answer = PartialAnswer(end - first)
        for (span, names), cells in zip(block, answers, strict=True):
            start, stop = span.start - first, span.stop - first
            if isinstance(cells, ModbusError):
                answer.errors[start, stop] = cells
                answer.lost += names
            else:
                answer[start:stop] = cells
        return answer


def reading(
    blocks: Sequence[Block],
    refusals: Refusals,
    now: float,
    connects: int,
    *,
    is_strict: bool = False,
    tell: Callable[[str], object] | None = None,
) -> _PlanSteps[list[Any]]:
    """
    Read the blocks of a plan: yield requests, take their outcomes, and return the answers.

    `now` is in seconds of any steady clock. A strict reading asks for everything, and halves what
    is refused, until a piece is refused alone or a request fails in another way: its only answer is
    that error, with the names of the piece.
    `tell` is called with a sentence about each piece that is left out from now on, or pieces side
    by side.
    """
    run = _PlanRun(blocks, refusals, now, connects)
    try:
        return (yield from (run.strict() if is_strict else run.tolerant()))
    finally:
        if tell is not None:
            for line in run.news():
                tell(line)


def carried_out(
    steps: _PlanSteps[Result], ask: Callable[[list[pdu.Request[Any]]], Iterable[Any]]
) -> Result:
    """Return the result of steps; another function gets the outcomes of their requests."""
    try:
        requests = next(steps)
        while True:
            requests = steps.send(list(ask(requests)))
    except StopIteration as done:
        result: Result = done.value
        return result
