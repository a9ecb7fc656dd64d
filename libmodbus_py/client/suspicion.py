"""
Decides which answers on a line may be those to earlier requests.

No frame of RTU or ASCII says which request it answers, so an answer that comes twice could be
taken for the next one, and every later value would be the one before. Three things tell: an
answer comes sooner than the unit can answer, it repeats the answer to another request, or
answers have become faster than they were. No socket, no clock.
"""

from __future__ import annotations

__all__ = ["Suspicion"]

# So many of the last answers may come again; so many requests are remembered with their answers,
# and so many answers that different requests have in common.
RECENT, REMEMBERED, MOST_COMMON = 16, 1024, 64

# Answers that took less than this share of the shortest time, or on average of the usual time.
EARLY, FASTER = 0.5, 0.75

# How much one answer counts in the average of the last ones, and in that of all; one that took
# very long counts as so many times the usual.
LAST, USUAL, LONGEST = 1 / 8, 1 / 64, 3.0

# How far times deviate from the usual one: these are multiples of the average deviation.
BY_CHANCE, NEVER = 1.25, 4.0

# The true answer is awaited for so much longer than usual, at least: a share of that, and seconds.
SHARE, SHORTEST = 0.25, 0.001

# Unit, function and length.
Kind = tuple[int, int, int]


class Times:
    """The times that answers of one kind took: the shortest, the usual, and that of the last."""

    __slots__ = ("deviation", "last", "shortest", "usual")

    def __init__(self, took: float) -> None:
        self.shortest = self.usual = self.last = took
        self.deviation = took / 2

    def note(self, took: float) -> None:
        """Note an answer."""
        if took < self.shortest:
            self.shortest = took
        more = min(took, LONGEST * self.usual + SHORTEST) - self.usual
        self.last += LAST * (self.usual + more - self.last)
        self.deviation += USUAL * (abs(more) - self.deviation)
        self.usual += USUAL * more

    @property
    def are_shorter(self) -> bool:
        """True if the last answers were faster than chance can explain."""
        return (
            self.last < FASTER * self.usual and self.last < self.usual - BY_CHANCE * self.deviation
        )

    @property
    def longest(self) -> float:
        """The time that an answer may take."""
        return self.usual + max(NEVER * self.deviation, SHARE * self.usual, SHORTEST)


class Suspicion:
    """Learns how the units of a connection answer."""

    def __init__(self) -> None:
        self._count = 0
        self._times: dict[Kind, Times] = {}
        # Unit and request -> its last answer.
        self._answers: dict[tuple[int, bytes], bytes] = {}
        # Unit and answer -> the request that it answered last, and its number.
        self._recent: dict[tuple[int, bytes], tuple[bytes, int]] = {}
        # Answers that different requests of a unit have in common, such as all zeros.
        self._common: set[tuple[int, bytes]] = set()

    def accepts(self, unit: int, request: bytes, pdu: bytes, took: float) -> bool:
        """Return True, and learn from an answer, unless it may be that to an earlier request."""
        times = self._times.get((unit, pdu[0], len(pdu)))
        if times is not None and (took < EARLY * times.shortest or times.are_shorter):
            return False
        if self.repeats(unit, request, pdu):
            return False
        self.learn(unit, request, pdu, took)
        return True

    def repeats(self, unit: int, request: bytes, pdu: bytes) -> bool:
        """Return True for the answer to another request of late, unless it was the last to this."""
        asked, number = self._recent.get((unit, pdu), (request, 0))
        return (
            asked != request
            and self._count - number < RECENT
            and self._answers.get((unit, request)) != pdu
            and (unit, pdu) not in self._common
        )

    def patience(self, unit: int, request: bytes, pdu: bytes) -> float:
        """Return how long after its request the true answer is awaited, in place of this one."""
        last = self._answers.get((unit, request))
        if last is None:
            kinds = [kind for kind in self._times if kind[0] == unit]
        else:
            kinds = [(unit, each[0], len(each)) for each in (last, pdu)]
        longest = [self._times[kind].longest for kind in kinds if kind in self._times]
        return max(longest, default=SHORTEST)

    def learn(self, unit: int, request: bytes, pdu: bytes, took: float) -> None:
        """Learn from an answer that is taken for that to its request."""
        kind = unit, pdu[0], len(pdu)
        times = self._times.get(kind)
        if times is None:
            if len(self._times) >= REMEMBERED:
                self._times.clear()
            self._times[kind] = Times(took)
        else:
            times.note(took)
        if len(self._answers) >= REMEMBERED:
            self._answers.clear()
        if len(self._recent) >= REMEMBERED:
            self._recent.clear()
        self._count += 1
        self._answers[unit, request] = pdu
        self._recent[unit, pdu] = request, self._count

    def clear(self, unit: int, request: bytes, pdu: bytes, took: float) -> None:
        """Learn from a doubtful answer after which no other one came: it was the true one."""
        if self.repeats(unit, request, pdu):
            if len(self._common) >= MOST_COMMON:
                self._common.clear()
            self._common.add((unit, pdu))
        self.learn(unit, request, pdu, took)
        times = self._times[unit, pdu[0], len(pdu)]
        if times.are_shorter:  # answers are that fast now
            times.usual = times.last = took
