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

# Answers that may come again: this many of the last ones at least, and those of this many seconds,
# which are more from a unit that answers fast.
RECENT, LONGEST_COPY = 16, 0.05

# The most requests that are remembered with their answers, and the most answers that different
# requests have in common.
REMEMBERED, MOST_COMMON = 1024, 64

# Answers are too fast below this share of the shortest time, and, on average, of the usual time.
EARLY, FASTER = 0.5, 0.75

# The weight of one answer in the average of the last ones, and in that of all; an answer that took
# longer than this multiple of the usual time counts as that multiple.
OF_LAST, OF_USUAL, OUTLIER = 1 / 8, 1 / 64, 3.0

# Multiples of the average deviation by which times differ from the usual one by chance, and never.
BY_CHANCE, NEVER = 1.25, 4.0

# The true answer is awaited for at least this share of the usual time longer, and so many seconds.
SHARE_LATER, LEAST_LATER = 0.25, 0.001

# Unit, function and length of an answer; unit and request.
Kind = tuple[int, int, int]
Asked = tuple[int, bytes]


class Times:
    """
    The times that answers of one kind took: the shortest, the usual, and that of the last.

    Attributes:
        earliest: an answer that took less came too early.
        are_shorter: True if the last answers were faster than chance can explain.
    """

    __slots__ = ("are_shorter", "deviation", "earliest", "last", "usual")

    def __init__(self, took: float) -> None:
        self.earliest = EARLY * took
        self.usual = self.last = took
        self.deviation = took / 2
        self.are_shorter = False

    def note(self, took: float) -> None:
        """Note an answer."""
        if EARLY * took < self.earliest:
            self.earliest = EARLY * took
        usual = self.usual
        most = OUTLIER * usual + LEAST_LATER
        more = (took if took < most else most) - usual
        self.last = last = self.last + OF_LAST * (usual + more - self.last)
        self.deviation += OF_USUAL * (abs(more) - self.deviation)
        self.usual = usual = usual + OF_USUAL * more
        self.are_shorter = last < FASTER * usual and last < usual - BY_CHANCE * self.deviation

    def believe(self, took: float) -> None:
        """Let an answer that takes this time cause no doubt from now on."""
        self.earliest = min(self.earliest, EARLY * took)
        self.are_shorter = False

    def start_anew(self, took: float) -> None:
        """Assume that answers take this time from now on."""
        self.usual = self.last = took
        self.are_shorter = False

    @property
    def longest(self) -> float:
        """The time that an answer may take."""
        return self.usual + max(NEVER * self.deviation, SHARE_LATER * self.usual, LEAST_LATER)


class Suspicion:
    """Learns how the units of a connection answer."""

    def __init__(self) -> None:
        self._times: dict[Kind, Times] = {}
        # Unit and request -> its last answer.
        self._answers: dict[Asked, bytes] = {}
        # The last answers: what each of them answered, and how long it took; and that together.
        self._recent: deque[tuple[bytes, Asked, float]] = deque(maxlen=REMEMBERED)
        self._covered = 0.0
        # How often each of them is there.
        self._counts: dict[bytes, int] = {}
        # Answers that different requests of a unit have in common, such as all zeros.
        self._common: set[tuple[int, bytes]] = set()

    def accepts(self, unit: int, request: bytes, pdu: bytes, took: float) -> bool:
        """Return True, and learn from an answer, unless it may be that to an earlier request."""
        asked, kind = (unit, request), (unit, pdu[0], len(pdu))
        times = self._times.get(kind)
        if times is not None and (took < times.earliest or times.are_shorter):
            return False
        if self._answers.get(asked) != pdu:
            if pdu in self._counts and self.repeats(unit, request, pdu):
                return False
            if len(self._answers) >= REMEMBERED:
                self._answers.clear()
            self._answers[asked] = pdu
        self._note_recent(pdu, asked, took)
        if times is not None:
            times.note(took)
        else:
            if len(self._times) >= REMEMBERED:
                self._times.clear()
            self._times[kind] = Times(took)
        return True

    def _note_recent(self, pdu: bytes, asked: Asked, took: float) -> None:
        recent, counts = self._recent, self._counts
        if len(recent) == REMEMBERED:
            self._forget_oldest()
        recent.append((pdu, asked, took))
        counts[pdu] = counts.get(pdu, 0) + 1
        self._covered += took
        while len(recent) > RECENT and self._covered - recent[0][2] >= LONGEST_COPY:
            self._forget_oldest()

    def _forget_oldest(self) -> None:
        pdu, _, took = self._recent.popleft()
        self._covered -= took
        if self._counts[pdu] > 1:
            self._counts[pdu] -= 1
        else:
            del self._counts[pdu]

    def repeats(self, unit: int, request: bytes, pdu: bytes) -> bool:
        """Return True for the answer to another request of late, unless it was the last to this."""
        if self._answers.get((unit, request)) == pdu or (unit, pdu) in self._common:
            return False
        requests = [asked[1] for each, asked, _ in self._recent if each == pdu and asked[0] == unit]
        return bool(requests) and requests[-1] != request

    def patience(self, unit: int, request: bytes, pdu: bytes) -> float:
        """Return how long after its request the true answer is awaited, in place of this one."""
        last = self._answers.get((unit, request))
        if last is None:
            kinds = [kind for kind in self._times if kind[0] == unit]
        else:
            kinds = [(unit, each[0], len(each)) for each in (last, pdu)]
        longest = [self._times[kind].longest for kind in kinds if kind in self._times]
        return max(longest, default=LEAST_LATER)

    def clear(self, unit: int, request: bytes, pdu: bytes, took: float) -> None:
        """Learn from a doubtful answer after which no other one came: it was the true one."""
        if self.repeats(unit, request, pdu):
            if len(self._common) >= MOST_COMMON:
                self._common.clear()
            self._common.add((unit, pdu))
        times = self._times.get((unit, pdu[0], len(pdu)))
        if times is not None:
            times.believe(took)
        self.accepts(unit, request, pdu, took)
        if times is not None and times.are_shorter:
            times.start_anew(took)
