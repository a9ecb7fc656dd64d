"""
Connections that no worker polls, such as those of a zone whose last worker died. No socket, no
clock.
"""

from __future__ import annotations

from .records import Connection
from .worker import Worker

__all__ = ["Unserved"]

# Leases for which a connection may be without a worker: after one, others have taken over.
LONGEST = 2.0

# Parts of a lease between two looks.
LOOK = 0.25


class Unserved:
    """
    Finds connections that have had no worker for two leases.

    The worker with the lowest id finds them, so that they are reported once.

    Args:
        worker: its view of the bucket is searched.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._next = 0.0
        # Since when each connection has had no worker; and those that were found.
        self._since: dict[str, float] = {}
        self._found: set[str] = set()

    def found(self, now: float) -> list[Connection]:
        """Return the connections that were not found before, or that had a worker meanwhile."""
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
