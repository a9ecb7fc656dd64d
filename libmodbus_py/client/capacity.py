"""
Finds out, from the answers of a device, how many requests it takes at once.

Many devices silently lose all but one of the requests that arrive together. So a connection begins
with one request in flight, and the number doubles as long as answers arrive. A request that was
lost while others were in flight is sent again alone. If it is answered then, the device takes fewer
requests at once, and the number is reduced. This module uses neither sockets nor clocks.
"""

from __future__ import annotations

from ..protocol.errors import ModbusError, ModbusTimeoutError, ServerDeviceBusy
from .batch import Batch, Pending, Reply
from .matching import Matching
from .statistics import Statistics

__all__ = ["Capacity"]


# A request that is sent alone may take this many times as long as the slowest answer, but at least
# this share of its timeout; other requests wait meanwhile.
PATIENCE, LEAST_SHARE = 4.0, 0.25

# Networks lose a request now and then, too: one loss among this many answers proves nothing.
ANSWERS_BETWEEN_LOSSES = 1000

# After n trials in a row without an answer, the next 2**n - 1 lost requests are not tried alone.
MOST_DOUBLINGS = 10

# Functions that change nothing; all others count as writes.
READS = frozenset((1, 2, 3, 4, 7, 11, 12, 17, 20, 24, 43))

Lost = tuple[Pending, ModbusError]


class Capacity:
    """
    The number of requests that may be in flight on a connection.

    Args:
        place: the endpoint, for the log.
        most: the most requests that may ever be in flight.
        is_fixed: True to allow `most` from the beginning, and find out nothing.
        matching: determines which lost requests were answered late.
        statistics: counts the reductions of the number (`falls`).

    Attributes:
        now: how many requests may be in flight.
        is_open: True while the number may change.
        is_growing: True while answers may increase the number.
        lost: requests that were lost while others were in flight, with their errors; no other
            request is sent until one of them was tried alone.
        is_on_trial: True while one of them is in flight, alone.
        silent: pairs of a unit and a function that was not answered even alone; the function is 0
            for units that have answered nothing since.
    """

    def __init__(
        self, place: str, most: int, is_fixed: bool, matching: Matching, statistics: Statistics
    ) -> None:
        self.is_open: bool = not is_fixed and most > 1
        self.now: int = 1 if self.is_open else most
        self.is_growing: bool = self.is_open
        self.lost: list[Lost] = []
        self.is_on_trial: bool = False
        self.silent: set[tuple[int, int]] = set()
        self._place = place
        self._most_ever = self._most = most
        self._matching = matching
        self._statistics = statistics
        self._asked: Lost | None = None
        self._starts = 0
        self._last_write = 0
        self._count = 0  # answers since the number was changed
        self._peak = 0  # the most requests in flight since then
        self._slowest = 0.0
        self._responses = 0  # the number of responses when the last loss was proven
        self._fruitless = self._unheeded = 0
        self._was_told = False

    @property
    def learns_from_one(self) -> bool:
        """True if the answer to a request that is sent alone changes something here."""
        return (self.is_growing and self.now == 1) or bool(self.silent)

    def reset(self) -> None:
        """Begin again for another connection."""
        self.forget()
        if self.is_open:
            self.now, self._most, self.is_growing = 1, self._most_ever, True
            self._count = self._peak = self._fruitless = self._unheeded = 0
            self._slowest = 0.0

    def forget(self) -> list[Lost]:
        """Forget trials, because the connection is given up; return the requests that were lost."""
        self.silent.clear()
        return self._end_trial()

    def _end_trial(self) -> list[Lost]:
        lost, self.lost = self.lost, []
        self._asked, self.is_on_trial = None, False
        return lost

    def drop(self, batch: Batch) -> None:
        """Forget the requests of a batch whose caller is gone."""
        if self.lost:
            self.lost = [each for each in self.lost if each[0].batch is not batch]
        if self._asked is not None and self._asked[0].batch is batch:
            self._asked, self.is_on_trial = None, False

    # --- requests and answers -----------------------------------------------------------------

    def note_start(self, pending: Pending, in_flight: int) -> None:
        """Note that a request is sent; `in_flight` counts the requests in flight before it."""
        self._starts += 1
        pending.order, pending.has_company = self._starts, in_flight > 0
        if in_flight >= self._peak:
            self._peak = in_flight + 1
        if pending.function not in READS:
            self._last_write = self._starts

    def note_replies(
        self, replies: list[tuple[Pending, Reply]], in_flight: int, now: float
    ) -> None:
        """
        Increase the number if as many requests as allowed were in flight, and all were answered.

        A request that was alone and got no answer is not a reason to hold others back.
        """
        if self._peak < self.now:
            return
        for pending, reply in replies:
            if isinstance(reply, bytes):
                self._slowest = max(self._slowest, now - pending.sent)
            elif in_flight > 1:
                return
        if not (self.lost or self.is_on_trial):
            self._count += len(replies)
            if self._count >= self.now:
                self._grow()

    def note_answers(self, replies: list[tuple[Pending, Reply]]) -> None:
        """Note which of the silent units and functions answer again."""
        for pending, reply in replies:
            if isinstance(reply, bytes):
                self.silent.difference_update(_kinds(pending))

    def _grow(self) -> None:
        self._count = self._peak = 0
        self.now = min(2 * self.now, self._most)
        self.is_growing = self.now < self._most

    # --- losses -------------------------------------------------------------------------------

    def takes(self, error: ModbusError, pending: Pending) -> bool:
        """Return True if a failed request was lost beside others, and must be sent again."""
        had_company = pending.has_company or self._starts > pending.order
        if (
            not had_company
            or not isinstance(error, ModbusTimeoutError | ServerDeviceBusy)
            or not pending.batch.requests[pending.index].repeatable
            # A write is never sent again after a newer write.
            or (pending.function not in READS and self._last_write > pending.order)
            or not self.silent.isdisjoint(_kinds(pending))
        ):
            return False
        if self._unheeded and not self.lost:
            self._unheeded -= 1
            return False
        self.lost.append((pending, error))
        return True

    def next_trial(self) -> Lost | None:
        """Return the request to send alone now; None if no caller waits for any of them."""
        while self.lost:
            lost = self.lost.pop(0)
            batch = lost[0].batch
            if batch.matters(lost[0].index):
                self._asked, self.is_on_trial = lost, True
                return lost
            batch.in_flight -= 1
        return None

    def time_for_trial(self, timeout: float) -> float:
        """Return the seconds that others wait at most for the answer to a request sent alone."""
        return min(timeout, max(LEAST_SHARE * timeout, PATIENCE * self._slowest))

    def conclude(self, reply: Reply) -> tuple[bool, list[Lost]]:
        """
        Judge a trial by its reply. Return True if the device takes requests that are sent alone,
        and the other requests that were lost.
        """
        asked = self._asked
        lost = self._end_trial()
        if asked is None or is_refused(reply):
            if asked is not None and not isinstance(reply, bytes):
                self.silent.update(_kinds(asked[0]))
            self._fruitless = min(self._fruitless + 1, MOST_DOUBLINGS)
            self._unheeded = (1 << self._fruitless) - 1
            if self.is_growing:  # the number in flight was not the reason
                self._grow()
            return False, lost
        self._fruitless = self._unheeded = 0
        since, self._responses = self._responses, self._statistics.responses
        if self._responses - since <= ANSWERS_BETWEEN_LOSSES or self.is_growing:
            self._fall([asked, *lost])
        return True, lost

    def _fall(self, lost: list[Lost]) -> None:
        """Reduce the number to at most half, and to as many as were answered, perhaps late."""
        gone = sum(self._matching.owes(pending) for pending, _ in lost)
        tried = min(self.now, self._peak)
        self.now = self._most = max(1, min(tried // 2, tried - gone))
        self._peak = 0
        self.is_growing = False
        self._statistics.falls += 1

    def tell(self) -> None:
        """Log once that the number was reduced."""
        if self._most < self._most_ever and not self._was_told:
            self._was_told = True
            from ..protocol.logs import HarmlessLogger

            HarmlessLogger(__name__).warning(
                "%s: requests that are sent together are lost, but answered when sent alone; "
                "at most %d in flight from now on (max_in_flight sets the number)",
                self._place,
                self.now,
            )


def _kinds(pending: Pending) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the keys in `silent` that a request concerns: its unit, and the unit's function."""
    return (pending.batch.unit, 0), (pending.batch.unit, pending.function)


def is_refused(reply: Reply) -> bool:
    """Return True if no answer was received, or the device answered that it is busy."""
    if not isinstance(reply, bytes):
        return isinstance(reply, ModbusTimeoutError)
    return reply[0] >= 0x80 and reply[1:2] == bytes([ServerDeviceBusy.code])
