"""
One run of a plan at one device: its requests, and the search for what the device refuses.

Neither sockets nor clocks: the caller sends `PlanRun.requests`, passes the outcomes to
`PlanRun.take`, and goes on until there are no more requests.
"""

from __future__ import annotations

from collections.abc import Generator, Hashable, Iterable
from typing import Any, NamedTuple

from ..protocol import pdu
from ..protocol.errors import ModbusError
from .block_answers import BlockAnswer, Portion
from .holes import DAMAGE, RETRY_SOONER, Hole, Holes, is_refusal, reason_of
from .pieces import Block
from .plan import Plan

__all__ = ["Enough", "PlanRun", "Steps", "says_something"]

MOST_MORE = 32
"""Requests of one run, at most, besides those that read what is not known to be refused."""

WITHOUT_ANSWER = 12
"""Refusals in a row, from the first one on, after which single pieces far apart are tried."""

TURN = 0.618
"""The part of the distance between them by which they are others at the next trial."""

SAMPLES = 8
"""Pieces far apart that are tried, before all others count as refused, too."""

MOST_RETRIED = 8
"""Holes that are tried again in one run, at most."""

Requests = list[pdu.Request[list[Any]]]
Steps = Generator[Requests, list[Any], None]


def says_something(outcome: object) -> bool:
    """True if an outcome says something about what can be read, besides that it can."""
    is_error = isinstance(outcome, ModbusError)
    return is_error and (is_refusal(outcome) or isinstance(outcome, DAMAGE))


class Enough(Exception):
    """The search goes on with the next run."""


class _NothingIsRead(Exception):
    """No read of a block is answered."""


class Narrowed(NamedTuple):
    """
    One piece because of which a request may have been refused.

    Attributes:
        asked: that request.
        at: the piece.
        refused: the shortest request that was refused and contains the piece.
        refusals: how many were refused that contain it.
        starts: the pieces with which further requests began, because those before were answered.
    """

    asked: Portion
    at: int
    refused: Portion
    refusals: int
    starts: list[int]

    @property
    def is_direct(self) -> bool:
        """True if the piece was refused alone."""
        return self.refused.last - self.refused.first == 1


class PlanRun:
    """
    One run of a plan.

    A request that is refused (exceptions 2, 3 and 4, or invalid responses three times in a row)
    is halved until the pieces are known that cannot be read. These are left out of later runs,
    and tried again when they are due. A value is never cut. Other failures, such as silence, a
    busy device, or a gateway without a path, say nothing about what can be read.

    The number of requests is bounded: see `MOST_MORE` and `Holes.may_search`. What is not found is
    searched for in later runs. A block in which no read is answered is left out as a whole.

    Args:
        plan: what is read.
        holes: what is known of the device.
        now: the time in seconds, of any steady clock.
        client: anything that tells the clients of the device apart.
        connects: how many connections that client has made.

    Attributes:
        requests: the requests to send next; empty when the run is over.
        first_requests: those that read what is not known to be refused, and what is tried again.
        news: sentences about what was found to be unreadable in this run.
        is_complete: False if there is more to search for in the next run.
    """

    def __init__(
        self, plan: Plan, holes: Holes, now: float, client: Hashable = None, connects: int = 1
    ) -> None:
        holes.note_connection(client, connects, now)
        self.requests: Requests = []
        self.news: list[str] = []
        self.is_complete: bool = True
        self._plan = plan
        self._holes = holes
        self._now = now
        self._readings = [BlockAnswer(block) for block in plan.blocks]
        self._left = min(MOST_MORE, holes.may_search(now))
        self._is_answered = False
        self._is_refused = False
        self._longest: dict[str, int] = {}
        self._has_learnt = False
        self._group: list[Portion] = []
        self._tried = 0
        self._steps = self._run()
        # Another thread, or task, may learn something meanwhile.
        self._known = dict(holes.refused)
        self.requests = next(self._steps, [])
        self.first_requests: Requests = self.requests

    def take(self, outcomes: Iterable[Any]) -> None:
        """Take the outcome of each of `requests`: a list of cells or a ModbusError."""
        try:
            self.requests = self._steps.send(list(outcomes))
        except StopIteration:
            self.requests = []

    @property
    def answers(self) -> list[Any]:
        """The answers to the requests of the plan, as `Plan.results` takes them."""
        return [reading.answer for reading in self._readings]

    # --- the run ----------------------------------------------------------------------------

    def _run(self) -> Steps:
        asked = self._first_asked()
        outcomes = yield [each.request for each in asked]
        refused = [
            each
            for each, outcome in zip(asked, outcomes, strict=True)
            if self._note(each, outcome) and not self._is_known(each, outcome)
        ]
        if not refused or self._now < self._holes.search_after:
            return
        if self._left <= 0:
            self.is_complete = False
            return
        try:
            while refused:
                yield from self._search(refused.pop(0), refused)
        except Enough:
            self.is_complete = False
        if not self._has_learnt:
            self._holes.search_after = self._now + RETRY_SOONER

    def _first_asked(self) -> list[Portion]:
        asked = [each for reading in self._readings for each in self._readable(reading)]
        left_out = sorted(self._left_out(), key=lambda each: self._hole(each).tried_at)
        due = [each for each in left_out if self._hole(each).is_due(self._now)][:MOST_RETRIED]
        self._is_refused = not asked
        # A device that refuses everything is asked at each run whether it still does.
        return asked + (due if asked else due or left_out[:1])

    def _readable(self, reading: BlockAnswer) -> list[Portion]:
        """Return what is asked of a block: all pieces without holes, in few requests."""
        block, last = reading.block, len(reading.block.pieces)
        holes = self._holes_in(block)
        if not (holes or self._holes.cuts or self._holes.most):
            return [Portion(reading, 0, last)]
        if hole := holes.get(block.span[1:]):
            reading.failed(hole.copied_error, 0, last)
            return []
        asked: list[Portion] = []
        first = 0
        for at, (start, stop, _) in enumerate(block.pieces):
            if hole := holes.get((start, stop)):
                reading.failed(hole.copied_error, at, at + 1)
                asked += [Portion(reading, first, at)] * (first < at)
                first = at + 1
            elif first < at and self._is_cut(block, first, at):
                asked.append(Portion(reading, first, at))
                first = at
        return asked + [Portion(reading, first, last)] * (first < last)

    def _holes_in(self, block: Block) -> dict[tuple[int, ...], Hole]:
        """Return the holes within a block, by their first address and the one behind the last."""
        table, start, stop = block.span
        return {
            span[1:]: hole
            for span, hole in self._known.items()
            if span.table == table and span.start >= start and span.stop <= stop
        }

    def _is_cut(self, block: Block, first: int, at: int) -> bool:
        """True if a request for pieces from the first on must end before another piece."""
        if not (self._holes.cuts or self._holes.most):
            return False
        table, start, stop = block.span_between(first, at + 1)
        most = self._holes.most.get(table)
        return (table, block.pieces[at].start) in self._holes.cuts or (
            most is not None and stop - start > most
        )

    def _left_out(self) -> list[Portion]:
        """Return the holes of this plan."""
        found: list[Portion] = []
        for reading in self._readings:
            block, size = reading.block, len(reading.block.pieces)
            holes = self._holes_in(block)
            if block.span[1:] in holes:
                found.append(Portion(reading, 0, size))
            elif holes:
                found += [
                    Portion(reading, at, at + 1)
                    for at, (start, stop, _) in enumerate(block.pieces)
                    if (start, stop) in holes
                ]
        return found

    def _hole(self, asked: Portion) -> Hole:
        return self._known[asked.span]

    def _note(self, asked: Portion, outcome: Any) -> bool:
        """Note an outcome; return True if it is a refusal."""
        reading, span = asked.reading, asked.span
        is_refused = self._holes.is_damaged(span, outcome) or is_refusal(outcome)
        if isinstance(outcome, ModbusError):
            reading.failed(outcome, asked.first, asked.last)
            return is_refused
        if self._holes.fill(span) and self._is_refused:
            self._holes.expire(self._now)
        length = span.stop - span.start
        self._longest[span.table] = max(length, self._longest.get(span.table, 0))
        self._is_answered = True
        reading.answered(span, outcome, asked.first, asked.last)
        found, reading.found = reading.found, {}
        for at, error in found.items():
            self._add(Portion(reading, at, at + 1), error)
        return False

    def _is_known(self, asked: Portion, error: ModbusError) -> bool:
        """True if a refusal tells nothing new: a hole is still there."""
        if asked.span not in self._known:
            return False
        is_due = self._hole(asked).is_due(self._now)
        if is_due and asked.last - asked.first == 1:
            self._holes.add(asked.span, error, self._now)
            return True
        return not is_due

    # --- the search -------------------------------------------------------------------------

    def _search(self, asked: Portion, others: list[Portion]) -> Steps:
        """Find what cannot be read of the pieces whose common request was refused."""
        reading = asked.reading
        if asked.last - asked.first == 1:
            self._found(asked)
            return
        if asked.span in self._known:  # tried again: a few pieces show whether it helps
            group = [asked]
            if not self._is_answered:
                group += [each for each in others if each.span in self._known]
            is_answered = yield from self._sample(group)
            for each in group if not is_answered else []:
                self._add(each, each.reading.errors[each.first])
            others[:] = [each for each in others if each not in group]
            return
        self._group, self._tried = [asked, *others], 0
        try:
            yield from self._find_all(asked)
        except _NothingIsRead:
            return
        if not reading.is_answered and all(each.reading is not reading for each in others):
            self._add_whole(reading)

    def _find_all(self, asked: Portion) -> Steps:
        """Find each piece that cannot be read: a hole, the rest, the next hole in the rest."""
        reading, first, last = asked
        is_refused = True
        while first < last:
            one, all_of_it = Portion(reading, first, first + 1), Portion(reading, first, last)
            if not is_refused and self._is_behind_holes(reading, first):
                is_answered = yield from self._ask(one)
                if not is_answered:
                    self._found(one)
                first += 1
                continue
            if not is_refused and (yield from self._ask(all_of_it)):
                return
            narrow = yield from self._narrowed(all_of_it)
            rest = Portion(reading, narrow.at + 1, last)
            hole = Portion(reading, narrow.at, narrow.at + 1)
            is_refused = False
            if not narrow.is_direct:
                if rest.first < last:
                    is_refused = not (yield from self._ask(rest))
                if not self._is_sure(narrow) and (yield from self._ask(hole)):
                    yield from self._find_other_reason(narrow)
                    return
            self._found(hole)
            if not narrow.is_direct and not is_refused:
                return
            first = rest.first

    def _narrowed(self, asked: Portion) -> Generator[Requests, list[Any], Narrowed]:
        """
        Halve a request that was refused, until one piece is left.

        Only the first half is asked for: if it is answered, the refusal was about the second.
        """
        reading, low, high = asked
        refused, refusals = asked, 1
        starts: list[int] = []
        while high - low > 1:
            # Holes are often neighbours.
            is_beside = low == asked.first and self._is_hole(reading, low - 1)
            middle = low + 1 if is_beside else (low + high) // 2
            half = Portion(reading, low, middle)
            if (yield from self._ask(half)):
                starts.append(middle)
                low = middle
            else:
                refused, high, refusals = half, middle, refusals + 1
        return Narrowed(asked, low, refused, refusals, starts)

    def _is_sure(self, narrow: Narrowed) -> bool:
        """
        True if a piece that was not tried alone must be the reason of the refusal.

        The length is not the reason if another request of this length was answered, and the cells
        between pieces are not if there are none.
        """
        table, start, stop = narrow.refused.span
        is_long_enough = self._longest.get(table, 0) >= stop - start
        return narrow.refusals > 1 and is_long_enough and _is_dense(narrow.asked)

    def _find_other_reason(self, narrow: Narrowed) -> Steps:
        """Note why a request was refused whose pieces can all be read."""
        if (yield from self._ask(narrow.asked)):
            return
        table, start, stop = narrow.refused.span
        longest = self._longest.get(table, 1)
        self._has_learnt = True
        if longest < stop - start:
            self._holes.shorten(table, longest, self._now)
            return
        pieces = narrow.asked.reading.block.pieces
        for at in {*([] if _is_dense(narrow.asked) else narrow.starts), narrow.at}:
            if at > narrow.asked.first:
                self._holes.cut(table, pieces[at].start, self._now)

    def _is_behind_holes(self, reading: BlockAnswer, at: int) -> bool:
        return self._is_hole(reading, at - 1) and self._is_hole(reading, at - 2)

    def _is_hole(self, reading: BlockAnswer, at: int) -> bool:
        if at < 0:
            return False
        span = reading.block.span_of(reading.block.pieces[at])
        return at in reading.found or span in self._holes.refused

    # --- asking ------------------------------------------------------------------------------

    def _ask(self, asked: Portion) -> Generator[Requests, list[Any], bool]:
        """Ask for pieces; return True if this was answered, False if it was refused."""
        if self._tried >= WITHOUT_ANSWER and not asked.reading.is_answered:
            yield from self._find_any(asked.reading)
        self._tried += 1
        is_answered = yield from self._asked_once(asked)
        if is_answered is None:  # a disturbance of the line is not a refusal, unless it comes twice
            is_answered = yield from self._asked_once(asked)
        return bool(is_answered)

    def _asked_once(self, asked: Portion) -> Generator[Requests, list[Any], bool | None]:
        (outcome,) = yield from self._sent([asked])
        if isinstance(outcome, DAMAGE):
            return None
        return not isinstance(outcome, ModbusError)

    def _sent(self, asked: list[Portion]) -> Generator[Requests, list[Any], list[Any]]:
        self._left -= len(asked)
        if self._left < 0:
            raise Enough
        self._holes.note_searched(len(asked))
        outcomes = yield [each.request for each in asked]
        for each, outcome in zip(asked, outcomes, strict=True):
            self._note(each, outcome)
        for outcome in outcomes:
            is_other = isinstance(outcome, ModbusError) and not is_refusal(outcome)
            if is_other and not isinstance(outcome, DAMAGE):
                raise Enough
        return outcomes

    def _find_any(self, reading: BlockAnswer) -> Steps:
        """Try pieces far apart, because nothing was answered so far."""
        if not self._is_answered and not (yield from self._sample(self._group)):
            for each in self._group:
                self._add_whole(each.reading)
            raise Enough
        if not reading.is_answered and not (yield from self._sample(self._group[:1])):
            self._add_whole(reading)
            raise _NothingIsRead
        self._tried = 0

    def _sample(self, group: list[Portion]) -> Generator[Requests, list[Any], bool]:
        """Ask for a few single pieces far apart; return True if one of them was answered."""
        pieces = [
            Portion(each.reading, at, at + 1)
            for each in group
            for at in range(each.first, each.last)
        ]
        hole = self._known.get(group[0].span)
        turn = (hole.refusals if hole else 0) * TURN % 1
        count = min(SAMPLES, len(pieces))
        chosen = [pieces[int((at + turn) * len(pieces) / count)] for at in range(count)]
        seen = [each for each in pieces if each.span in self._holes.seen and each not in chosen]
        chosen += seen[:SAMPLES]
        outcomes = yield from self._sent(chosen)
        answered = [
            each
            for each, outcome in zip(chosen, outcomes, strict=True)
            if not isinstance(outcome, ModbusError)
        ]
        for each in answered:
            self._has_learnt = True
            self._holes.seen.add(each.span)
            self._holes.fill(each.reading.block.span)
        return bool(answered)

    # --- what is found -----------------------------------------------------------------------

    def _found(self, asked: Portion) -> None:
        """Note a piece that was refused; it counts once the device answered something near it."""
        error = asked.reading.errors.get(asked.first)
        if error is None:  # it was answered before, in this run
            return
        if asked.reading.is_answered or asked.span == asked.reading.block.span:
            self._add(asked, error)
        else:
            asked.reading.found[asked.first] = error

    def _add_whole(self, reading: BlockAnswer) -> None:
        reading.found.clear()
        for piece in reading.block.pieces:
            self._holes.fill(reading.block.span_of(piece))
            self._holes.seen.discard(reading.block.span_of(piece))
        self._add(Portion(reading, 0, len(reading.block.pieces)), reading.errors[0])

    def _add(self, asked: Portion, error: ModbusError) -> None:
        self._has_learnt = True
        if self._holes.add(asked.span, error, self._now):
            pieces = asked.reading.block.pieces[asked.first : asked.last]
            names = [str(name) for piece in pieces for name in piece.names]
            told = ", ".join(names[:3]) + ", ..." * (len(names) > 3)
            self.news.append(f"{told}, {asked.span}: {reason_of(error)}")


def _is_dense(asked: Portion) -> bool:
    """True if there are no cells between pieces."""
    pieces = asked.reading.block.pieces[asked.first : asked.last]
    reached = pieces[0].stop
    for piece in pieces:
        if piece.start > reached:
            return False
        reached = max(reached, piece.stop)
    return True
