"""
The lease of a worker, as it counts it itself. No socket, no clock.
"""

from __future__ import annotations

import math

from .records import Member

__all__ = ["OTHERS_PART", "OWN_PART", "Lease"]

OWN_PART = 0.9
"""Of a lease: how long its holder uses it, from before it sent for it."""

OTHERS_PART = 1.05
"""Of a lease: how long others wait, from when they saw it."""

# Of a lease: when to ask for it again; when it was not granted yet; and when there are news.
BEAT, AGAIN, SOON = 0.1, 0.2, 0.01


class Lease:
    """
    Begins anew with each value of this worker that comes back.

    Args:
        id: of the worker; never used before.

    Attributes:
        until: when it ends.
        joined: whether the others know of this worker.
        revision: of its last value that was confirmed.
    """

    def __init__(self, id: str) -> None:
        self.id = id
        self.key: str = f"worker.{id}"
        self.until: float = -math.inf
        self.joined: bool = False
        self.revision: int = 0
        self._beat = 0
        # By number: when it was sent, and for how long.
        self._sent: dict[int, tuple[float, float]] = {}
        self._last = -math.inf

    def next_beat(self, now: float, lease: float, hurry: bool) -> int | None:
        """
        Give the number of the value to send now, if it is time.

        Args:
            lease: seconds.
            hurry: whether others wait for what it says.
        """
        if now < self.next_at(lease, hurry):
            return None
        self._last = now
        self._beat += 1
        self._sent[self._beat] = now, lease
        return self._beat

    def next_at(self, lease: float, hurry: bool) -> float:
        """Return the time from which `next_beat` returns a number, as things are now."""
        return self._last + lease * self._part(hurry)

    def _part(self, hurry: bool) -> float:
        return SOON if hurry else AGAIN if self._sent else BEAT

    def came_back(self, member: Member) -> None:
        """This value stands in the bucket."""
        self.joined = True
        self._extend(member.beat)

    def is_confirmed(self, beat: int, revision: int) -> None:
        """A value was written, at that revision; who has not joined waits until it sees it."""
        self.revision = max(self.revision, revision)
        if self.joined:
            self._extend(beat)

    def _extend(self, beat: int) -> None:
        if beat in self._sent:
            sent, lease = self._sent[beat]
            self.until = max(self.until, sent + lease * OWN_PART)
            self._sent = {other: at for other, at in self._sent.items() if other > beat}
