"""
Decides which frames on a line are requests and which are responses, if only the bytes are known.

The length of most frames shows what they are. Others are decoded on trial as the response to the
open request. A response that repeats its request byte for byte (functions 5, 6, 8, 21, 22) could be
both; then its time decides, because no client sends the next request before a response could have
arrived.
"""

from __future__ import annotations

from collections import deque
from math import sqrt

from .hearing import Candidate, Damage
from .pairing import OpenRequest, Pairing
from .transaction import Heard, OnHeard, Part, answered, decoded

__all__ = ["Naming"]

# A frame that follows damaged bytes within this time was sent together with them; in seconds.
GLUED = 0.001


class LearntTimes:
    """
    Recent response times of the units of a line, and times until its clients send the next request.

    Only the last few of each are kept. Until some are known, typical times are assumed: clients
    wait for half a second (libmodbus) or longer, and adapters delay responses by up to 20 ms.
    """

    USUAL_TIMEOUT = 0.5
    SHORTEST_ANSWER = 0.02

    def __init__(self) -> None:
        self._answers: dict[int, deque[float]] = {}
        self._timeout: deque[float] = deque(maxlen=16)

    def note_answer(self, unit: int, seconds: float) -> None:
        self._answers.setdefault(unit, deque(maxlen=32)).append(seconds)

    def note_next_request(self, seconds: float) -> None:
        """Take the seconds between a request without a response and the next request."""
        self._timeout.append(seconds)

    def limit(self, unit: int) -> float:
        """Return the seconds after a request up to which equal bytes are its response."""
        slowest = max(self._answers.get(unit, ()), default=0.0)
        # One of the shortest times, because clients may pause before the next request; but not the
        # shortest, because a frame that is merged into a damaged one looks like a request.
        known = sorted(self._timeout)
        timeout = known[len(known) // 4] if len(known) >= 4 else self.USUAL_TIMEOUT
        return sqrt(max(slowest, min(self.SHORTEST_ANSWER, timeout / 4)) * timeout)


class Naming:
    """
    Decides which frames are requests and which are responses, and pairs them.

    Args:
        on_heard: called with each frame as soon as this is decided, and with damaged bytes.

    Attributes:
        pairing: the transactions.
    """

    def __init__(self, on_heard: OnHeard = lambda heard: None) -> None:
        self.pairing: Pairing = Pairing()
        self._on_heard = on_heard
        self._times = LearntTimes()
        self._is_certain = True  # the open request cannot be a response
        self._held: Heard | None = None  # a request that may turn out to be a response

    def is_awaited(self, unit: int, function: int) -> bool:
        """Return True if a response of this unit to this function is likely now."""
        asked = self.pairing.due
        return asked is not None and asked.frame.unit == unit and asked.frame.pdu[0] == function

    def take(self, found: Candidate | Damage) -> None:
        """Take the next frame or damage."""
        self.pairing.tick(found.began)
        if isinstance(found, Candidate) and not _has_function(found):
            part: Part = "response" if found.may_answer else "request"
            self._note(Heard(found.began, found.ended, part, found.frame))
            self.pairing.misuse(found.began, found.ended, found.frame)
        elif isinstance(found, Damage):
            self._note(Heard(found.began, found.ended, "damage", None, found.data))
            self.pairing.damage(*found)
        elif self._is_request(found):
            self._take_request(found)
        else:
            self._note(Heard(found.began, found.ended, "response", found.frame))
            self._take_response(found)

    def tick(self, at: float) -> None:
        """Note that nothing more was received until this time."""
        self.pairing.tick(at)
        self._release()

    def end(self) -> None:
        """Note that nothing more will be received."""
        self.pairing.end()
        self._release()

    def _release(self) -> None:
        """Release the held request: after it is given up, it cannot turn out to be a response."""
        if self.pairing.due is None:
            self._note(None)

    def _note(self, heard: Heard | None) -> None:
        """Call `on_heard` in the order of the line: first with the request that was held."""
        held, self._held = self._held, None
        for each in (held, heard):
            if each is not None:
                self._on_heard(each)

    # --- request or response --------------------------------------------------------------

    def _is_request(self, found: Candidate) -> bool:
        if found.may_ask != found.may_answer:
            return found.may_ask
        asked = self.pairing.due
        asks = found.may_ask and decoded(found.frame.pdu) is not None
        answers = found.may_answer and _fits(asked, found)
        if asks and answers and asked is not None:
            return self._is_repeated(asked, found)
        if asks:
            return not self._is_late_echo(found)
        return not answers and not self.is_awaited(found.frame.unit, found.frame.pdu[0] & 0x7F)

    def _is_repeated(self, asked: OpenRequest, found: Candidate) -> bool:
        """Return True if a frame that could be both arrived too late for a response."""
        spoiled = asked.spoiled
        if spoiled is not None and found.began - spoiled.ended > GLUED:
            return True  # the damaged bytes were the response
        return found.began - asked.ended > self._times.limit(asked.frame.unit)

    def _is_late_echo(self, found: Candidate) -> bool:
        """Return True for the response to an earlier request while another one is awaited."""
        asked, late = self.pairing.due, self.pairing.given_up(found.frame.unit)
        if asked is None or asked.spoiled is not None or not _fits(late, found):
            return False
        return found.began - asked.ended <= self._times.limit(asked.frame.unit)

    def _was_a_response(self, asked: OpenRequest, at: float) -> bool:
        """
        Return True if the open request was in fact a response, judged by the time of the next
        request.

        That is likely if it could be a response, and nothing answered it: it arrived twice, or its
        request was damaged, because clients wait for their responses.
        """
        is_open = asked.spoiled is None and not self._is_certain
        return is_open and at - asked.ended <= self._times.limit(asked.frame.unit)

    # --- both -----------------------------------------------------------------------------

    def _take_request(self, found: Candidate) -> None:
        before = self.pairing.due
        if before is not None and self._was_a_response(before, found.began):
            self._held = self._held and self._held._replace(part="response")
            self.pairing.withdraw(before)
        elif before is not None:
            # Times are not learned from guesses, because they decide the next guess.
            if before.spoiled is None and self._is_certain and not found.may_answer:
                self._times.note_next_request(found.began - before.ended)
            self._note(None)
        heard = Heard(found.began, found.ended, "request", found.frame)
        self._note(None if found.may_answer else heard)
        self._held = heard if found.may_answer else None
        self._is_certain = not found.may_answer
        self.pairing.ask(found.began, found.ended, found.frame)
        self._release()

    def _take_response(self, found: Candidate) -> None:
        asked = self.pairing.due
        outcome = self.pairing.answer(found.began, found.ended, found.frame)
        if asked is not None and outcome is not None and outcome.kind != "invalid":
            self._times.note_answer(found.frame.unit, max(found.began - asked.ended, 0.0))


def _fits(asked: OpenRequest | None, found: Candidate) -> bool:
    if asked is None or asked.frame.unit != found.frame.unit:
        return False
    return answered(asked.request, found.frame.pdu).kind != "invalid"


def _has_function(found: Candidate) -> bool:
    """Return True if the function code is valid (application protocol, 4.1)."""
    code = found.frame.pdu[0]
    return 0 < code < 0x80 or (code > 0x80 and found.may_answer)
