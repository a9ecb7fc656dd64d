"""
Finds connections that no worker polls, such as those of a zone whose last worker died. Works
without sockets or clocks.
"""

from __future__ import annotations

from .records import Connection
from .worker import Worker

__all__ = ["Unserved"]

# The time for which a connection may be without a worker, in leases: after one lease, another
# worker should have taken over.
LONGEST = 2.0

# The time between two searches, as a fraction of a lease.
LOOK = 0.25


class Unserved:
    """
    Finds connections that have had no worker for two leases.

    Only the worker with the lowest id finds any, so that each is reported once.

    Args:
        worker: its view of the bucket is searched.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._next = 0.0
        # Key of a connection without a worker -> the time at which this was first seen.
        self._since: dict[str, float] = {}
        # The keys of connections that were already returned.
        self._found: set[str] = set()

    def found(self, now: float) -> list[Connection]:
        """Return the connections found now that were not found before, or had a worker since."""
        view = self._worker.view
        if view.settings is None or now < self._next:
            return []
        self._next = now + LOOK * view.settings.lease
        living = {each.id for each in view.members.values() if self._worker.is_heard(each, now)}
        if min(living, default="") != self._worker.lease.id:
            self._since.clear()
            self._found.clear()
            return []
        free = {slot for slot in view.used_slots if view.holders.get(slot) not in living}
        lost = {each.key: each for each in view.connections if each.slot in free} if free else {}
        self._since = {key: self._since.get(key, now) for key in lost}
        self._found &= lost.keys()
        wait = LONGEST * view.settings.lease
        late = [key for key, at in self._since.items() if now - at > wait]
        new = [lost[key] for key in late if key not in self._found]
        self._found.update(late)
        return new
