"""
Decides which answers on a line may be those to earlier requests.

No frame of RTU or ASCII says which request it answers, so an answer that comes twice could be
taken for the next one, and every later value would be the one before. Three things tell: an
answer comes sooner than the unit can answer, it repeats the answer to another request, or
answers have become faster than they were. No socket, no clock.
"""

from __future__ import annotations

from collections import deque

__all__ = ["Suspicion"]

# So many of the last answers may come again, and so many requests are remembered with theirs.
RECENT, REMEMBERED = 16, 1024

# Answers that took less than this share of the shortest time, or on average of the usual time.
EARLY, FASTER = 0.5, 0.75

# How much one answer counts in the average of the last ones, and in that of all.
LAST, USUAL = 1 / 8, 1 / 256

# How long the true answer may be awaited: so many times as long as the slowest one took.
PATIENCE, SHORTEST, FADING = 2.0, 0.001, 0.98


class Times:
    """The times that answers of one kind took: the shortest, the usual, and that of the last."""

    __slots__ = ("last", "shortest", "usual")

    def __init__(self, took: float) -> None:
        self.shortest = self.usual = self.last = took


class Suspicion:
    """
    Learns how the units of a connection answer.

    Attributes:
        longest_wait: seconds after its request until which the true answer is awaited.
    """

    def __init__(self) -> None:
        self.longest_wait: float = SHORTEST
        # By unit, function and length.
        self._times: dict[tuple[int, int, int], Times] = {}
        # Unit and request -> its last answer.
        self._answers: dict[tuple[int, bytes], bytes] = {}
        self._recent: deque[tuple[int, bytes, bytes]] = deque(maxlen=RECENT)
        # Answers that different requests of a unit have in common, such as all zeros.
        self._common: set[tuple[int, bytes]] = set()

    def accepts(self, unit: int, request: bytes, pdu: bytes, took: float) -> bool:
        """Return True, and learn from an answer, unless it may be that to an earlier request."""
        times = self._times.get((unit, pdu[0], len(pdu)))
        if times is not None and (
            took < EARLY * times.shortest or times.last < FASTER * times.usual
        ):
            return False
        if self.repeats(unit, request, pdu):
            return False
        self.learn(unit, request, pdu, took)
        return True

    def repeats(self, unit: int, request: bytes, pdu: bytes) -> bool:
        """Return True for the answer to another request of late, unless it was the last to this."""
        return (
            any(each[1] == pdu and each[0] == unit and each[2] != request for each in self._recent)
            and self._answers.get((unit, request)) != pdu
            and (unit, pdu) not in self._common
        )

    def learn(self, unit: int, request: bytes, pdu: bytes, took: float) -> None:
        """Learn from an answer that is taken for that to its request."""
        key = (unit, pdu[0], len(pdu))
        times = self._times.get(key)
        if times is None:
            self._times[key] = Times(took)
        else:
            times.shortest = min(times.shortest, took)
            times.usual += USUAL * (took - times.usual)
            times.last += LAST * (took - times.last)
        self.longest_wait = max(FADING * self.longest_wait, PATIENCE * took, SHORTEST)
        self._recent.append((unit, pdu, request))
        if len(self._answers) >= REMEMBERED:
            self._answers.clear()
        self._answers[unit, request] = pdu

    def clear(self, unit: int, request: bytes, pdu: bytes, took: float) -> None:
        """Learn from a doubtful answer after which no other one came: it was the true one."""
        if self.repeats(unit, request, pdu):
            if len(self._common) >= RECENT:
                self._common.clear()
            self._common.add((unit, pdu))
        self.learn(unit, request, pdu, took)
        times = self._times[unit, pdu[0], len(pdu)]
        times.usual = times.last  # answers are that fast now
