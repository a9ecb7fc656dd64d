"""
The lease of a worker, as the worker itself counts it, without sockets or clocks.
"""

from __future__ import annotations

import math

from .records import Member

__all__ = ["OTHERS_PART", "OWN_PART", "Lease"]

OWN_PART = 0.9
"""The fraction of a lease that its holder uses, counted from just before it sent the renewal."""

OTHERS_PART = 1.05
"""The fraction of a lease that other workers wait, counted from when they saw the renewal."""

# Fractions of a lease after which it is renewed: usually (BEAT), while the last renewal is not
# confirmed (AGAIN), and while other workers wait for an acknowledgement (SOON).
BEAT, AGAIN, SOON = 0.1, 0.2, 0.01


class Lease:
    """
    A lease, which is extended by each confirmed value of its worker.

    Args:
        id: the id of the worker, which no worker must have used before.

    Attributes:
        until: the time at which the lease expires.
        joined: True once a value of this worker was seen in the bucket.
        revision: the revision of the last confirmed value.
    """

    def __init__(self, id: str) -> None:
        self.id = id
        self.key: str = f"worker.{id}"
        self.until: float = -math.inf
        self.joined: bool = False
        self.revision: int = 0
        self._beat = 0
        # Unconfirmed values by number: when each was sent, and the length of the lease.
        self._sent: dict[int, tuple[float, float]] = {}
        self._last = -math.inf

    def next_beat(self, now: float, lease: float, hurry: bool) -> int | None:
        """
        Return the number of the value to send now; None if no value is due yet.

        Args:
            lease: the length of a lease in seconds.
            hurry: True if other workers wait for an acknowledgement.
        """
        if now < self.next_at(lease, hurry):
            return None
        self._last = now
        self._beat += 1
        self._sent[self._beat] = now, lease
        return self._beat

    def next_at(self, lease: float, hurry: bool) -> float:
        """Return the time from which `next_beat` returns a number, unless something changes."""
        return self._last + lease * self._part(hurry)

    def _part(self, hurry: bool) -> float:
        return SOON if hurry else AGAIN if self._sent else BEAT

    def came_back(self, member: Member) -> None:
        """Extend the lease, because this value was seen in the bucket."""
        self.joined = True
        self._extend(member.beat)

    def is_confirmed(self, beat: int, revision: int) -> None:
        """Note the revision of a written value, and extend the lease if this worker has joined."""
        self.revision = max(self.revision, revision)
        if self.joined:
            self._extend(beat)

    def _extend(self, beat: int) -> None:
        if beat in self._sent:
            sent, lease = self._sent[beat]
            self.until = max(self.until, sent + lease * OWN_PART)
            self._sent = {other: at for other, at in self._sent.items() if other > beat}
