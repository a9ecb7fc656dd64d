"""What happens when, in simulated seconds. One seed decides every choice."""

import heapq
import itertools
import math
import random
from collections.abc import Callable
from typing import Any

START = 1000.0


class Events:
    """A clock, and what is to happen."""

    def __init__(self, seed: int = 0) -> None:
        self.now: float = START
        self.random: random.Random = random.Random(seed)
        self.happened: int = 0
        self.looks: list[Callable[[], object]] = []
        self._heap: list[tuple[float, float, int, Callable[..., object], tuple[Any, ...]]] = []
        self._numbers = itertools.count()

    @property
    def next_at(self) -> float:
        """The time of the next event; infinity if there is none."""
        return self._heap[0][0] if self._heap else math.inf

    def after(self, seconds: float, call: Callable[..., object], *args: Any) -> None:
        """Call a function in so many seconds."""
        self.at(self.now + seconds, call, *args)

    def at(self, when: float, call: Callable[..., object], *args: Any) -> None:
        """Call a function at a time, or now if that is past."""
        entry = (max(when, self.now), self.random.random(), next(self._numbers), call, args)
        heapq.heappush(self._heap, entry)

    def advance(self, until: float) -> None:
        """Move the clock to the next event, but not beyond `until`, and let it happen."""
        self.now = max(self.now, min(self.next_at, until))
        while self._heap and self._heap[0][0] <= self.now:
            *_, call, args = heapq.heappop(self._heap)
            self.happened += 1
            call(*args)
            for look in self.looks:
                look()
