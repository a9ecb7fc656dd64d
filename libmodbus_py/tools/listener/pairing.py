"""
Which frames are requests, and whose answers the others are.

Most frames tell by their length, and the rest by a trial: an answer decodes as one to the
question that is open. What repeats the question byte for byte (5, 6, 8, 21, 22) fits both ways;
there the time tells, for nobody asks again before an answer can have come.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import sqrt
from typing import Any

from ...protocol.errors import ExceptionResponse
from ...protocol.framing import Frame
from ...protocol.pdu import RawRequest, Request
from .hearing import Candidate, Damage
from .outcome import Outcome, answered, damaged, decoded
from .transaction import Heard, Kind, OnHeard, Transaction

__all__ = ["Pairing", "Times"]

# After so many seconds a question counts as unanswered, though no other has been asked.
PATIENCE = 5.0

# An answer that comes more seconds behind its question is nobody's.
LATEST = 60.0

# What comes so soon behind bytes that are no frame was sent together with them; in seconds.
GLUED = 0.001


class Times:
    """
    What is learnt of the times on a line: how long units take, and how soon clients ask again.

    The last few of each; until there are some, what is usual: clients wait for half a second
    (libmodbus) and longer, and adapters keep answers back for up to 20 ms.
    """

    USUAL_PATIENCE = 0.5
    SHORTEST_ANSWER = 0.02

    def __init__(self) -> None:
        self._answers: dict[int, deque[float]] = {}
        self._patience: deque[float] = deque(maxlen=16)

    def note_answer(self, unit: int, seconds: float) -> None:
        self._answers.setdefault(unit, deque(maxlen=32)).append(seconds)

    def note_next_question(self, seconds: float) -> None:
        """A question that had no answer was followed by the next one so much later."""
        self._patience.append(seconds)

    def limit(self, unit: int) -> float:
        """Give the seconds behind a question up to which its like is its answer."""
        slowest = max(self._answers.get(unit, ()), default=0.0)
        # One of the shortest: clients think before the next question. Not the very shortest,
        # for a frame of others that is merged into a damaged one looks like a question.
        known = sorted(self._patience)
        patience = known[len(known) // 4] if len(known) >= 4 else self.USUAL_PATIENCE
        return sqrt(max(slowest, min(self.SHORTEST_ANSWER, patience / 4)) * patience)


@dataclass
class _Asked:
    """A question that may still be answered."""

    began: float
    ended: float
    frame: Frame
    request: Request[Any]
    repeats: int
    is_certain: bool  # whether it can be nothing else
    damage: Damage | None = None


class Pairing:
    """
    Args:
        on_heard: called with each frame as soon as it is named, and with damaged bytes.
        is_line: whether a silence may tell a question from its answer, and unit 0 is everybody.

    Attributes:
        done: transactions that have ended; whoever takes them empties it.
    """

    def __init__(self, on_heard: OnHeard = lambda heard: None) -> None:
        self.done: list[Transaction] = []
        self._on_heard = on_heard
        self._times = Times()
        self._current: _Asked | None = None
        self._unanswered: dict[int, _Asked] = {}  # by unit; their answers may come late
        self._held: Heard | None = None  # a question that may turn out to be an answer

    def is_awaited(self, unit: int, function: int) -> bool:
        """Whether an answer of this unit to this function is likely now."""
        asked = self._current
        return asked is not None and asked.frame.unit == unit and asked.frame.pdu[0] == function

    def take(self, found: Candidate | Damage) -> None:
        """Take what was heard next."""
        self.tick(found.began)
        if isinstance(found, Candidate) and not _has_function(found):
            found = Damage(found.began, found.ended, bytes([found.frame.unit]) + found.frame.pdu)
        if isinstance(found, Damage):
            self._note(Heard(found.began, found.ended, "damage", None, found.data))
            self._take_damage(found)
        elif self._is_question(found):
            self._take_question(found)
        else:
            self._note(Heard(found.began, found.ended, "response", found.frame))
            self._take_answer(found)

    def _note(self, heard: Heard | None) -> None:
        """Tell what was held, too; in the order of the line."""
        held, self._held = self._held, None
        for each in (held, heard):
            if each is not None:
                self._on_heard(each)

    def tick(self, at: float) -> None:
        """Let time pass."""
        if self._current is not None and at - self._current.ended > PATIENCE:
            self._give_up()

    def end(self) -> None:
        """Nothing more will come."""
        if self._current is not None:
            self._give_up()

    # --- question or answer ---------------------------------------------------------------

    def _is_question(self, found: Candidate) -> bool:
        if found.may_ask != found.may_answer:
            return found.may_ask
        asks = found.may_ask and decoded(found.frame.pdu) is not None
        answers = found.may_answer and self._fits(self._current, found)
        if asks and answers:
            return self._is_repeated(found)
        if asks:
            return not self._is_late_echo(found)
        return not answers and not self.is_awaited(found.frame.unit, found.frame.pdu[0] & 0x7F)

    def _fits(self, asked: _Asked | None, found: Candidate) -> bool:
        if asked is None or asked.frame.unit != found.frame.unit:
            return False
        return answered(asked.request, found.frame.pdu).kind != "invalid"

    def _is_repeated(self, found: Candidate) -> bool:
        """What fits both ways is a question if it comes too late for an answer."""
        asked = self._current
        assert asked is not None
        damage = asked.damage
        if damage is not None and found.began - damage.ended > GLUED:
            return True  # the damaged bytes were the answer
        return found.began - asked.ended > self._times.limit(asked.frame.unit)

    def _is_late_echo(self, found: Candidate) -> bool:
        """Whether it answers an earlier question, while the client waits for another answer."""
        asked, late = self._current, self._unanswered.get(found.frame.unit)
        if asked is None or asked.damage is not None or not self._fits(late, found):
            return False
        return found.began - asked.ended <= self._times.limit(asked.frame.unit)

    def _was_an_answer(self, asked: _Asked, at: float) -> bool:
        """
        Whether a question was none, now that the next one comes at this time.

        It may be an answer, and nobody answered it: it came for the second time, or its question
        was damaged. For clients wait for their answers.
        """
        is_open = asked.damage is None and not asked.is_certain
        return is_open and at - asked.ended <= self._times.limit(asked.frame.unit)

    # --- transactions ---------------------------------------------------------------------

    def _take_question(self, found: Candidate) -> None:
        before = self._current
        if before is not None and self._was_an_answer(before, found.began):
            self._held = self._held and self._held._replace(part="response")
            self._end_unasked(before.began, before.frame)
            before = self._current = None
        if before is not None:
            # A guess must not teach what the next one is judged by.
            if before.damage is None and before.is_certain and not found.may_answer:
                self._times.note_next_question(found.began - before.ended)
            self._give_up()
        heard = Heard(found.began, found.ended, "request", found.frame)
        self._note(None if found.may_answer else heard)
        self._held = heard if found.may_answer else None
        request = decoded(found.frame.pdu) or RawRequest.decode(found.frame.pdu)
        is_again = before is not None and before.frame == found.frame
        repeats = before.repeats + 1 if before is not None and is_again else 0
        asked = _Asked(
            found.began, found.ended, found.frame, request, repeats, not found.may_answer
        )
        if found.frame.unit == 0 or not request.expects_response:
            self._note(None)
            self._end(asked, "broadcast")
        else:
            self._current = asked

    def _take_answer(self, found: Candidate) -> None:
        asked = self._current
        if asked is not None and not self._fits(asked, found):
            asked = None
        late = self._unanswered.get(found.frame.unit)
        if asked is not None:
            self._answer(asked, found)
        elif late is not None and found.began - late.ended < LATEST and self._fits(late, found):
            del self._unanswered[found.frame.unit]
            outcome = answered(late.request, found.frame.pdu)
            self._end(late, "late", outcome, found.ended)
        elif self.is_awaited(found.frame.unit, found.frame.pdu[0] & 0x7F):
            assert self._current is not None
            self._answer(self._current, found)
        else:
            self._end_unasked(found.began, found.frame)

    def _answer(self, asked: _Asked, found: Candidate) -> None:
        damage, asked.damage = asked.damage, None
        if damage is not None:
            self._end_damage(damage)
        outcome = answered(asked.request, found.frame.pdu)
        if outcome.kind != "invalid":
            self._times.note_answer(found.frame.unit, max(found.began - asked.ended, 0.0))
            self._unanswered.pop(found.frame.unit, None)
        self._current = None
        self._end(asked, outcome.kind, outcome, found.ended)

    def _take_damage(self, damage: Damage) -> None:
        asked = self._current
        if asked is None:
            self._end_damage(damage)
            return
        if asked.damage is not None:
            self._end_damage(asked.damage)
        asked.damage = damage

    def _give_up(self) -> None:
        asked, self._current = self._current, None
        assert asked is not None
        self._note(None)
        self._unanswered[asked.frame.unit] = asked
        if asked.damage is None:
            self._end(asked, "unanswered")
        else:
            damage, asked.damage = asked.damage, None
            self._end(asked, "damaged", damaged(damage.data), damage.ended)

    # --- what is given --------------------------------------------------------------------

    def _end(
        self, asked: _Asked, kind: Kind, outcome: Outcome | None = None, ended: float | None = None
    ) -> None:
        self.done.append(
            Transaction(
                asked.began,
                kind,
                asked.frame.unit,
                asked.frame.pdu[0],
                asked.request,
                outcome and outcome.response,
                outcome and outcome.error,
                None if ended is None else max(ended - asked.ended, 0.0),
                asked.repeats,
            )
        )

    def _end_unasked(self, began: float, frame: Frame) -> None:
        unit, pdu, _ = frame
        function, response, error = pdu[0] & 0x7F, None, None
        if pdu[0] & 0x80 and len(pdu) == 2:
            error = ExceptionResponse.of(pdu[1], unit=unit, function=function)
        else:
            response = pdu[1:]
        self.done.append(
            Transaction(began, "unasked", unit, function, response=response, error=error)
        )

    def _end_damage(self, damage: Damage) -> None:
        self.done.append(Transaction(damage.began, "damaged", error=damaged(damage.data).error))


def _has_function(found: Candidate) -> bool:
    """0 is none, and from 128 on only answers have one (application protocol, 4.1)."""
    code = found.frame.pdu[0]
    return 0 < code < 0x80 or (code > 0x80 and found.may_answer)
