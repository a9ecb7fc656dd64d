"""
The knowledge of a worker: the bucket as it sees it, its lease, and its own writes. It uses neither
sockets nor clocks: the caller passes what was seen, and the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

from ..engine.buckets import Change
from .records import HEARD_PART, BucketView, Connection, Slot

OWN_PART = 0.9
"""The fraction of a lease that its holder uses, counted from just before it sent the renewal."""


class Put(NamedTuple):
    """A write of a key that still has the revision `last`, or 0; without a value, a deletion."""

    key: str
    value: bytes | None
    last: int


class Decision(NamedTuple):
    """
    The connections that a worker polls now, by their keys, and its writes.

    Attributes:
        active: polling of others must have stopped before anything is written.
        due: the time of the next decision, unless something changes.
        must_read_again: True if changes of the bucket may be missing.
        unserved: connections that no worker has polled for long. Only one worker finds any.
    """

    active: Mapping[str, Connection]
    puts: Sequence[Put] = ()
    due: float = math.inf
    must_read_again: bool = False
    unserved: Sequence[Connection] = ()


class Worker:
    """
    One of the workers that share the connections of a fleet.

    Args:
        new_id: returns an id that no worker has used before: ``NAME.NONCE``.
        zones: the zones whose connections it polls; "" is the zone of devices without a zone.

    Attributes:
        active: the connections that it polls since the last decision, by their keys.
        attempts: its writes to other keys than its own: the revision before, and the time.
        has_joined: True once a value of this worker was seen in the bucket.
        beat, sent_at: the number and the time of its last value.
        hears_since: since when it has seen its own values without a gap: the silence of other
            workers counts only from then.
        has_left: True once it has ended after `leave`.
        due: the time of the next decision; minus infinity after something changed.
    """

    def __init__(self, new_id: Callable[[], str], zones: Collection[str]) -> None:
        self.view: BucketView = BucketView()
        self.zones: tuple[str, ...] = tuple(sorted(zones))
        self.hears_since: float = -math.inf
        self.is_leaving: bool = False
        self.has_left: bool = False
        self._new_id = new_id
        self._snapshot: BucketView | None = None
        self._heard_at = -math.inf
        self._join()

    def _join(self) -> None:
        """Begin anew with another id, without slots."""
        self.id: str = self._new_id()
        self.key: str = f"worker.{self.id}"
        self.lease_until: float = -math.inf
        self.has_joined: bool = False
        self.beat: int = 0
        self.sent_at: float = -math.inf
        # By number of each value that was not seen yet: until when it extends the lease.
        self._leases: dict[int, float] = {}
        self.active: Mapping[str, Connection] = {}
        self.attempts: dict[str, tuple[int, float]] = {}
        self.due: float = -math.inf

    # Input

    def begin_snapshot(self) -> None:
        """Begin a snapshot; the changes that follow are the whole contents of the bucket."""
        self._snapshot = BucketView()

    def add_change(self, change: Change, now: float) -> None:
        if self._snapshot is not None:
            self._snapshot.add(change, now)
        elif self.view.add(change, now):
            self._follow_own_record()
            if change.key == self.key:
                if now > self._heard_at + self.view.longest_lease * HEARD_PART:
                    self.hears_since = now
                self._heard_at = now
            self.due = -math.inf

    def end_snapshot(self, now: float) -> None:
        """End the snapshot; later changes are new ones."""
        if self._snapshot is None:
            return
        before, self.view, self._snapshot = self.view, self._snapshot, None
        if self.view.revision < before.revision:
            # This is another bucket, or it has lost confirmed writes.
            self._join()
        self.view.follow(before, now)
        # Slots that were handed over in vain stay closed.
        self.attempts = {
            key: attempt for key, attempt in self.attempts.items() if self.has_written(key)
        }
        self._follow_own_record()
        self.due = -math.inf

    def note_decision(self, decision: Decision, now: float) -> None:
        """Remember a decision that is carried out now."""
        self.active, self.due = decision.active, decision.due
        for put in decision.puts:
            if put.key == self.key:
                assert self.view.settings is not None
                self.beat, self.sent_at = self.beat + 1, now
                # Older values cannot extend the lease any more.
                self._leases = {beat: until for beat, until in self._leases.items() if now < until}
                self._leases[self.beat] = now + self.view.settings.lease * OWN_PART
            else:
                self.attempts[put.key] = put.last, now

    def leave(self) -> None:
        """Stop polling. The next decision records the end of this worker."""
        self.is_leaving = True
        self.active = {}
        self.due = -math.inf

    def _follow_own_record(self) -> None:
        me = self.view.members.get(self.id)
        if me is not None and me.state != "ended":
            self.has_joined = True
            self.lease_until = max(self.lease_until, self._leases.get(me.beat, -math.inf))
        elif me is not None or self.has_joined:
            self.has_left = self.is_leaving
            self._join()

    # State

    @property
    def is_reading(self) -> bool:
        """True while a snapshot is incomplete."""
        return self._snapshot is not None

    def may_poll(self, now: float) -> bool:
        """Return True if the lease is valid, or not needed because NATS cannot be reached."""
        settings = self.view.settings
        may_continue = settings is not None and settings.on_engine_loss == "continue"
        return now < self.lease_until or may_continue

    def may_ask(self, connection: str, now: float) -> bool:
        """Return True if a request may be sent over a connection now."""
        entry = self.active.get(connection)
        # The answer must come within the lease.
        return entry is not None and self.may_poll(now + entry.timeout)

    def is_first(self, now: float) -> bool:
        """Return True if this worker has the lowest id of those that have renewed their leases."""
        candidates = (
            member.id for member in self.view.members.values() if self.view.is_heard(member, now)
        )
        return min(candidates, default="") == self.id

    def has_written(self, key: str) -> bool:
        """Return True if this worker has written a key that has not changed since."""
        return key in self.attempts and self.attempts[key][0] == self.view.last_change(key).revision

    def is_mine(self, slot: Slot) -> bool:
        """Return True if this worker holds a slot, and has not begun to hand it over."""
        return self.view.holders.get(slot) == self.id and not self.has_written(slot.key)
