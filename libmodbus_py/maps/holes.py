"""
The items of a plan that a device refuses, found by halving. No I/O, no clock.

A request of a plan reads pieces: cells that are read together, because a value is never cut. A
device that cannot read one piece refuses the whole request, with exception 2, 3 or 4.

1. A request that is refused is halved, and both halves are asked for, until single pieces are
   known. A piece that is refused alone is a hole. One hole among 20 pieces costs up to 10 requests.
2. Later runs leave holes out, and read what lies between two holes with one request.
3. If both halves of a refused request are answered, the device takes no request that long, or
   cannot read cells between the halves: later requests begin at the second half. This is a cut.
4. A run asks for one hole again, the one that was asked for longest ago, if that was ten minutes
   ago or on an earlier connection, or if all pieces are holes. If it is answered, the device has
   changed: all holes are forgotten, and asked for at once. Cuts are forgotten when they are as old.
5. While a run has no answer at all, it sends few halves, because each may take the time that a
   gateway waits for a silent device; all pieces that were refused are holes then.
6. Another failure, such as silence or a busy device, says nothing about pieces. It ends the
   search of that run.

Holes are known by their cells, so that all plans of a unit share them.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
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

__all__ = [
    "Block",
    "Holes",
    "PartialAnswer",
    "Span",
    "Steps",
    "Unreadable",
    "carried_out",
    "is_refusal",
    "reading",
]

RETRY_S = 600.0
"""Seconds after which what a device refused is tried again."""

REFUSED_HALVES = 16
"""Refused halves that end a search without an answer: 14 lead to one of 125 registers."""

Result = TypeVar("Result")
Steps = Generator[list[pdu.Request[Any]], list[Any], Result]

_TABLE_OF: dict[Any, str] = {rules.read: table for table, rules in TABLES.items()}


def is_refusal(outcome: object) -> bool:
    """True if an outcome is exception 2, 3 or 4, which can depend on the cells that are read."""
    # The others do not depend on them: the function, a busy device, a gateway.
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


@dataclass(frozen=True, slots=True)
class Unreadable:
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


class Holes:
    """
    The refusals of one unit, as one client knows them.

    Attributes:
        refused: the pieces that were refused alone.
        cuts: the table and address at which a request must begin.
    """

    __slots__ = ("cuts", "refused")

    def __init__(self) -> None:
        self.refused: dict[Span, PastRefusal] = {}
        self.cuts: dict[tuple[Any, ...], PastRefusal] = {}

    def __bool__(self) -> bool:
        return bool(self.refused or self.cuts)

    def forget(self) -> None:
        self.refused.clear()
        self.cuts.clear()


class BlockPiece(NamedTuple):
    """Cells that are read together or not at all, and the names of the items in them."""

    span: Span
    names: tuple[Any, ...]

    @property
    def cut(self) -> tuple[Any, ...]:
        return self.span[:2]


class Block:
    """
    One request of a plan, and the pieces that it reads, in the order of their addresses.

    Args:
        request: the request.
        parts: the places of the pieces in its answer, and their names.
    """

    def __init__(self, request: Any, parts: list[tuple[int, int, tuple[Any, ...]]]) -> None:
        table, start = _TABLE_OF[type(request)], request.address
        self.request: pdu.Request[list[Any]] = request
        self.pieces: tuple[BlockPiece, ...] = tuple(
            BlockPiece(Span(table, start + first, start + last), names)
            for first, last, names in parts
        )


class PartialAnswer(list[Any]):
    """
    The cells of an answer, with None for those that could not be read.

    Attributes:
        lost: the names of the items that could not be read.
        errors: why the cells from one index to another could not be read.
    """

    def __init__(self, size: int) -> None:
        super().__init__([None] * size)
        self.lost: list[Any] = []
        self.errors: dict[tuple[int, int], ModbusError] = {}


class _BlockRun:
    """
    The cells that one run has read of a block.

    Attributes:
        states: of each piece: None before it is asked for, what was refused if it is left out,
            then its cells or its error.
    """

    def __init__(self, block: Block) -> None:
        self.pieces = block.pieces
        self.request: Any = block.request
        self.states: list[Any] = [None] * len(block.pieces)
        self._whole: Any = None

    def take(self, first: int, last: int, outcome: Any) -> None:
        if isinstance(outcome, ModbusError):
            self.states[first:last] = [outcome] * (last - first)
            return
        if last - first == len(self.pieces):
            self._whole = outcome
        start = self.pieces[first].span.start
        for at in range(first, last):
            span = self.pieces[at].span
            self.states[at] = outcome[span.start - start : span.stop - start]

    @property
    def answer(self) -> Any:
        """The answer to the request of the block, as `Plan.results` takes it."""
        if self._whole is not None:
            return self._whole
        states = [
            alike(each.error) if isinstance(each, PastRefusal) else each for each in self.states
        ]
        if all(isinstance(each, ModbusError) for each in states):
            return states[0]
        answer = PartialAnswer(self.request.count)
        for piece, state in zip(self.pieces, states, strict=True):
            start, stop = (each - self.request.address for each in piece.span[1:])
            if isinstance(state, ModbusError):
                answer.errors[start, stop] = state
                answer.lost += piece.names
            else:
                answer[start:stop] = state
        return answer


class _Portion(NamedTuple):
    """The pieces first..last-1 of a block, in one request."""

    part: _BlockRun
    first: int
    last: int

    @property
    def span(self) -> Span:
        pieces = self.part.pieces[self.first : self.last]
        return pieces[0].span._replace(stop=max(each.span.stop for each in pieces))

    @property
    def request(self) -> pdu.Request[list[Any]]:
        if self.last - self.first == len(self.part.pieces):
            return self.part.request  # type: ignore[no-any-return]
        table, start, stop = self.span
        return TABLES[table].read(start, stop - start)


class _SearchEnds(Exception):
    """A run cannot find out more."""


class _PlanRun:
    """One run of a plan at one unit."""

    def __init__(self, blocks: Sequence[Block], holes: Holes, now: float, connects: int) -> None:
        self.parts = [_BlockRun(each) for each in blocks]
        self._holes = holes
        # The first connection is made by the first request.
        self._time = now, max(connects, 1)
        self._found: set[Span] = set()
        self._is_answered = False
        self._refused_halves = 0

    def tolerant(self) -> Steps[list[Any]]:
        """Read all pieces but the holes, and search for others."""
        left_out = list(self._left_out())
        asked = self._portions()
        trial, hole = min(left_out, key=lambda each: each[1].at, default=(None, None))
        if trial and hole and (not asked or hole.is_due(*self._time)):
            *outcomes, tried = yield from self._send([*asked, trial])
            if isinstance(tried, ModbusError):
                error = tried if is_refusal(tried) else hole.error
                self._holes.refused[trial.span] = PastRefusal(error, *self._time)
            else:
                self._holes.forget()
                for each, _ in left_out:
                    if each != trial:
                        each.part.states[each.first] = None
                again = self._portions()
                outcomes += yield from self._send(again)
                asked += again
        else:
            outcomes = yield from self._send(asked)
        try:
            for portion, outcome in zip(asked, outcomes, strict=True):
                if is_refusal(outcome):
                    yield from self._search(portion)
        except _SearchEnds:
            pass
        return [each.answer for each in self.parts]

    def strict(self) -> Steps[list[Any]]:
        """Read everything; the last answer is the first error, with the names of its piece."""
        outcomes = yield [each.request for each in self.parts]
        answers = []
        for part, outcome in zip(self.parts, outcomes, strict=True):
            answers.append(outcome)
            if is_refusal(outcome):
                answers[-1] = yield from self._first_refused(part, outcome)
            elif not isinstance(outcome, ModbusError):
                if any(each.span in self._holes.refused for each in part.pieces):
                    self._holes.forget()
                continue
            break
        return answers

    def news(self) -> Iterator[str]:
        """Yield a sentence about all holes that were found side by side."""
        for part in self.parts:
            found = [at for at, each in enumerate(part.pieces) if each.span in self._found]
            for _, group in groupby(enumerate(found), lambda each: each[1] - each[0]):
                indexes = [at for _, at in group]
                portion = _Portion(part, indexes[0], indexes[-1] + 1)
                names = [str(name) for at in indexes for name in part.pieces[at].names]
                told = ", ".join(names[:3]) + ", ..." * (len(names) > 3)
                yield f"{told}, {portion.span}: {_reason_of(part.states[indexes[0]])}"

    def _left_out(self) -> Iterator[tuple[_Portion, PastRefusal]]:
        """Leave known holes out, and forget old cuts."""
        refused, cuts = self._holes.refused, self._holes.cuts
        for part in self.parts:
            for at, piece in enumerate(part.pieces):
                if (cut := cuts.get(piece.cut)) and cut.is_due(*self._time):
                    cuts.pop(piece.cut, None)
                if hole := refused.get(piece.span):
                    part.states[at] = hole
                    yield _Portion(part, at, at + 1), hole

    def _portions(self) -> list[_Portion]:
        """Return what is to be asked for, in as few requests as holes and cuts allow."""
        found: list[_Portion] = []
        for part in self.parts:
            first = None
            for at, (piece, state) in enumerate(zip(part.pieces, part.states, strict=True)):
                if state is not None:
                    first = None
                elif first is None or piece.cut in self._holes.cuts:
                    first = at
                    found.append(_Portion(part, at, at + 1))
                else:
                    found[-1] = _Portion(part, first, at + 1)
        return found

    def _send(self, asked: Sequence[_Portion]) -> Steps[list[Any]]:
        outcomes = (yield [each.request for each in asked]) if asked else []
        for each, outcome in zip(asked, outcomes, strict=True):
            each.part.take(each.first, each.last, outcome)
            self._is_answered |= not isinstance(outcome, ModbusError)
        return outcomes

    def _ask(self, asked: Sequence[_Portion]) -> Steps[list[Any]]:
        """Send requests of a search; raise `_SearchEnds` after a failure that is no refusal."""
        outcomes = yield from self._send(asked)
        if any(isinstance(each, ModbusError) and not is_refusal(each) for each in outcomes):
            raise _SearchEnds
        return outcomes

    def _search(self, portion: _Portion) -> Steps[None]:
        """Find the holes in a portion that was refused."""
        part, first, last = portion
        if last - first == 1:
            self._add(part, first)
            return
        if self._refused_halves >= REFUSED_HALVES and not self._is_answered:
            for each in self.parts:
                for at, state in enumerate(each.states):
                    if is_refusal(state):
                        self._add(each, at)
            raise _SearchEnds
        error, middle = part.states[first], (first + last) // 2
        halves = _Portion(part, first, middle), _Portion(part, middle, last)
        outcomes = yield from self._ask(halves)
        refused = [half for half, each in zip(halves, outcomes, strict=True) if is_refusal(each)]
        if not refused:
            self._holes.cuts[part.pieces[middle].cut] = PastRefusal(error, *self._time)
        self._refused_halves += len(refused)
        for half in refused:
            yield from self._search(half)

    def _first_refused(self, part: _BlockRun, error: ModbusError) -> Steps[ModbusError]:
        """Return the refusal of the first piece that is refused alone; `error` if there is none."""
        part.take(0, len(part.pieces), error)
        known = (at for at, each in enumerate(part.pieces) if each.span in self._holes.refused)
        at = next(known, None)
        try:
            if at is not None and not (yield from self._is_refused(part, at, at + 1)):
                self._holes.forget()
                at = None
            if at is None:
                at = yield from self._halved(part)
        except _SearchEnds:
            return error
        if at is None:
            return error
        self._add(part, at)
        found: ModbusError = part.states[at]
        found.names = part.pieces[at].names
        return found

    def _halved(self, part: _BlockRun) -> Steps[int | None]:
        """Return the first piece that is refused alone, if the device lacks one."""
        first, last, is_refused = 0, len(part.pieces), True
        while last - first > 1:
            middle = (first + last) // 2
            is_refused = yield from self._is_refused(part, first, middle)
            first, last = (first, middle) if is_refused else (middle, last)
        if is_refused or (yield from self._is_refused(part, first, last)):
            return first
        return None

    def _is_refused(self, part: _BlockRun, first: int, last: int) -> Steps[bool]:
        (outcome,) = yield from self._ask([_Portion(part, first, last)])
        return is_refusal(outcome)

    def _add(self, part: _BlockRun, at: int) -> None:
        span = part.pieces[at].span
        if span not in self._holes.refused:
            self._found.add(span)
        self._holes.refused[span] = PastRefusal(part.states[at], *self._time)


def reading(
    blocks: Sequence[Block],
    holes: Holes,
    now: float,
    connects: int,
    *,
    is_strict: bool = False,
    tell: Callable[[str], object] | None = None,
) -> Steps[list[Any]]:
    """
    Read the blocks of a plan: yield requests, take their outcomes, and return the answers.

    Args:
        blocks: the blocks of the plan.
        holes: what is known of the unit, to which is added what is found.
        now: the time in seconds, of any steady clock.
        connects: how many connections the client has made.
        is_strict: True to ask for everything until one request fails: the last answer is its error
            then, with the names of the first piece that is refused alone.
        tell: is called with a sentence about each hole that was found, or holes side by side.

    Returns:
        The answers to the requests of the plan, as `Plan.results` takes them.
    """
    run = _PlanRun(blocks, holes, now, connects)
    try:
        return (yield from (run.strict() if is_strict else run.tolerant()))
    finally:
        if tell is not None:
            for each in run.news():
                tell(each)


def carried_out(
    steps: Steps[Result], ask: Callable[[list[pdu.Request[Any]]], Iterable[Any]]
) -> Result:
    """Return the result of steps whose outcomes another function gets."""
    try:
        requests = next(steps)
        while True:
            requests = steps.send(list(ask(requests)))
    except StopIteration as done:
        result: Result = done.value
        return result
