"""
The decisions of a worker: its lease, its slots, and the connections that it may poll. It uses
neither sockets nor clocks: the caller passes the changes that were seen, and the time, and gets
the values to write.

Why no two workers poll one connection
--------------------------------------
Workers know about each other only from the bucket, whose changes all of them see in the same
order. A write succeeds only if its key has not changed.

* A worker holds its slots while its lease is valid. It counts the lease from just before it sent
  the value that it then saw, or that was confirmed, and uses `OWN_PART` of it, less the timeout of
  the device. Other workers count the lease from when they saw the value, and wait for `OTHERS_PART`
  of it before they write that the worker has ended. Each uses its own clock, which may be wrong by
  7 %. This write succeeds only if the value is still the one that they saw. The worker itself, if
  it still runs, sees the write, and begins anew with another id.
* A slot passes to another worker when its holder writes so, after closing its connections, or when
  it is recorded, by the holder or by another worker, that the holder has ended. A slot without a
  known holder may be held by a worker whose key was deleted: it is taken after the longest lease.
* A connection that appears in a slot may have been in another slot before. It is polled when all
  workers have acknowledged the revision with which it appeared. The same holds for a slot whose
  holder changed in any other way: because another program wrote to the bucket, or because the
  bucket lost confirmed writes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from .lease import AGAIN, OTHERS_PART, Lease
from .records import Connection, Member, Slot, State, encode_holder
from .sharing import share
from .view import BucketView, Entry

__all__ = ["Put", "Worker"]

# The fraction of a lease after which a worker that has not renewed it gets no slots.
FRESH = 0.5

# The fraction of a lease after which a worker that does not see its own values reads the bucket
# again.
BLIND = 0.3

# The time after which the bucket is read again, in leases: no change reports that a key was purged.
READ_AGAIN = 60

# Failed attempts to write a key after which the bucket is read again.
MOST_TRIES = 3

# Seconds for which ended workers stay in the bucket, for `fleet status`.
REMEMBERED = 60.0


class Put(NamedTuple):
    """
    A write to the bucket.

    Attributes:
        key: the key to write or delete.
        value: the new value; None to delete the key.
        last: the revision that the key must still have; 0 if it must not exist.
        beat: the number of a value of this worker itself; 0 for other keys.
    """

    key: str
    value: bytes | None
    last: int
    beat: int = 0


class Worker:
    """
    One of the workers that share the connections of a fleet.

    Args:
        new_id: returns a new id: ``NAME.NONCE``.
        zones: the zones whose connections it polls; "" is the zone of devices without a zone.

    Attributes:
        view: the known contents of the bucket.
        lease: the lease of this worker.
        active: the connections that it polls since the last step, by their keys.
        waiting: keys of connections that other workers have not acknowledged yet.
        left: True once it has ended after `leave`.
        due: the time at which the next `step` may decide something. Changes of the bucket and
            confirmed writes may lower it.
    """

    def __init__(self, new_id: Callable[[], str], zones: Collection[str]) -> None:
        self.view: BucketView = BucketView()
        self.left: bool = False
        self.due: float = -math.inf
        self._new_id = new_id
        self._zones = tuple(sorted(zones))
        self._snapshot: BucketView | None = None
        # When the last snapshot of the bucket was complete.
        self._since = math.inf
        # When it last saw its own value, and since when it has seen its values without a gap: the
        # silence of other workers counts only from then.
        self._heard_at = self._hears_since = -math.inf
        self._longest_lease = 0.0
        self._leaving = False
        self._goes_on = False
        # The last result of `_shared`, after all that it depends on.
        self._shared_before: tuple[tuple[Any, ...], dict[Slot, str]] | None = None
        self._silent: set[str] = set()
        self.active: dict[str, Connection] = {}
        self.waiting: set[str] = set()
        self._join()

    # Input

    def begins(self) -> None:
        """Begin a snapshot; the changes that follow are the whole contents of the bucket."""
        self._snapshot = BucketView()

    def saw(self, entry: Entry, now: float) -> None:
        """Apply a change of the bucket."""
        if self._snapshot is not None:
            self._snapshot.add(entry, now)
            return
        changes = self.view.changes
        if self.view.add(entry, now):
            self._is_old |= not entry.key.startswith("worker.")
            self._follow_own_record()
            if entry.key == self.lease.key:
                self._hear(now)
                self._was_heard()
            if self.view.changes != changes or self._awaits(entry.key):
                self._due_at(-math.inf)

    def is_synced(self, now: float) -> None:
        """End the snapshot; later changes are new ones."""
        if self._snapshot is None:
            return
        view, before, self._snapshot = self._snapshot, self.view, None
        self.view = view
        if view.revision < before.revision:
            # This is another bucket, or it has lost confirmed writes.
            self._join()
        else:
            view.keep_times(before, now)
        self._is_old = True
        self._since = now
        self._tries = 0
        self._asked.clear()
        self._follow_own_record()
        self._due_at(-math.inf)

    def was_written(self, put: Put, revision: int) -> None:
        """
        Apply the confirmation of a write. It extends the lease even if this worker sees no changes,
        because it proves that no other worker had recorded the end of this one.
        """
        if put.beat and put.key == self.lease.key and not self._leaving:
            self.lease.is_confirmed(put.beat, revision)
            self._was_heard()

    def leave(self) -> None:
        """Stop polling. The next step records the end of this worker; others take its slots."""
        self._leaving = True
        self.active = {}
        self._due_at(-math.inf)

    # State

    @property
    def heard_at(self) -> float:
        """The time at which it last saw its own value in the bucket."""
        return self.view.seen_at(self.lease.key).at

    @property
    def is_reading(self) -> bool:
        """True while a snapshot is incomplete."""
        return self._snapshot is not None

    def is_heard(self, member: Member, now: float) -> bool:
        """Return True if a worker, perhaps this one, has renewed its lease recently."""
        return member.state != "ended" and now < self._heard_until(member)

    def is_blind(self, now: float) -> bool:
        """Return True if the bucket should be read again, because changes may be missing."""
        settings = self.view.settings
        if self._snapshot is not None or settings is None:
            return False
        return now >= self._blind_at(settings.lease) or self._tries >= MOST_TRIES

    def may_ask(self, connection: str, now: float) -> bool:
        """Return True if a request may be sent over a connection now."""
        known = self.active.get(connection)
        if known is None:
            return False
        return self._goes_on or now + known.timeout < self.lease.until

    def step(self, now: float, report: Callable[[], Mapping[str, Any]] = dict) -> list[Put]:
        """
        Return what to write, and update `active`. The caller must stop polling connections that are
        no longer in `active` before it writes.

        Args:
            report: returns numbers about the devices, for `fleet status`.
        """
        self.due = math.inf
        settings = self.view.settings
        if settings is None or self._snapshot is not None or self.left:
            return []
        self._longest_lease = max(
            self._longest_lease,
            settings.lease,
            *(member.lease for member in self.view.members.values()),
        )
        puts: list[Put] = []
        self._is_valid = self._is_before(self.lease.until, now)
        if self._is_valid and not self._leaving:
            puts += self._ends(now)
            puts += self._slots(self._shared(now), now)
            puts += self._forgotten(now)
        self._choose(now)
        # Last, because it acknowledges all changes up to the revision of the view.
        puts += self._beats(now, settings.lease, report)
        self._is_before(self._blind_at(settings.lease), now)
        return puts

    # When a step is due

    def _due_at(self, at: float) -> None:
        self.due = min(self.due, at)

    def _is_before(self, at: float, now: float) -> bool:
        """Return True if a time is in the future, and make a step due at that time."""
        if now < at:
            self._due_at(at)
            return True
        return False

    def _was_heard(self) -> None:
        """Update `due` after a value of this worker was seen or confirmed."""
        settings = self.view.settings
        if settings is not None:
            self._due_at(self.lease.next_at(settings.lease, hurry=False))
        if not self._is_valid:
            self._due_at(-math.inf)

    def _awaits(self, key: str) -> bool:
        """Return True if a change of this key may matter even if it only renews a lease."""
        return bool(self.waiting) or not self._is_valid or key in self._silent

    def _heard_until(self, member: Member) -> float:
        return self.view.seen_at(member.bucket_key).at + member.lease * FRESH

    def _blind_at(self, lease: float) -> float:
        heard = max(self.heard_at, self._since)
        return min(heard + lease * BLIND, self._since + lease * READ_AGAIN)

    # Its lease

    def _join(self) -> None:
        """Begin anew with another id, without slots."""
        self.lease: Lease = Lease(self._new_id())
        self.active = {}
        self.waiting = set()
        self._closed: dict[Slot, int] = {}
        self._asked: dict[str, tuple[int, float, int]] = {}
        self._tries = 0
        self._is_old = True
        self._is_valid = False
        self._due_at(-math.inf)

    def _follow_own_record(self) -> None:
        settings = self.view.settings
        self._goes_on = settings is not None and settings.on_engine_loss == "continue"
        me = self.view.members.get(self.lease.id)
        if me is not None and me.state != "ended":
            self.lease.came_back(me)
        elif me is not None or self.lease.joined:
            self.left = self._leaving
            self._join()

    def _hear(self, now: float) -> None:
        if now > self._heard_at + self._longest_lease * FRESH:
            self._hears_since = now
        self._heard_at = now

    def _beats(
        self, now: float, lease: float, report: Callable[[], Mapping[str, Any]]
    ) -> Iterator[Put]:
        me = self.view.members.get(self.lease.id)
        news = me is not None and me.seen < self.view.last_touched
        hurry = news or self._leaving
        beat = self.lease.next_beat(now, lease, hurry)
        self._is_before(self.lease.next_at(lease, hurry), now)
        if beat is not None:
            state: State = "ended" if self._leaving else "here"
            told = Member(
                self.lease.id, state, self._zones, lease, beat, self.view.revision, report()
            )
            last = max(self.lease.revision, self.view.seen_at(told.bucket_key).revision)
            yield Put(told.bucket_key, told.encode(), last, beat)

    # Others

    @property
    def _others(self) -> Iterator[Member]:
        """Yield the other workers that may hold slots."""
        members = self.view.members.values()
        return (each for each in members if each.id != self.lease.id and each.state != "ended")

    def _ends(self, now: float) -> Iterator[Put]:
        """Yield writes that record the end of workers whose leases have expired."""
        for member in self._others:
            at = max(self._hears_since, self.view.seen_at(member.bucket_key).at)
            if not self._is_before(at + member.lease * OTHERS_PART, now):
                yield from self._put(
                    member.bucket_key, replace(member, state="ended").encode(), now
                )

    def _forgotten(self, now: float) -> Iterator[Put]:
        """Yield deletions of workers that ended long ago, if no other worker has a lower id."""
        ended = [each for each in self.view.members.values() if self._is_forgotten(each, now)]
        if not ended or any(each.id < self.lease.id for each in self._others):
            return
        used = set(self.view.used_slots)
        for member in ended:
            slots = [slot for slot, id in self.view.holders.items() if id == member.id]
            if not slots:
                yield from self._put(member.bucket_key, None, now)
            for slot in slots:
                if slot not in used:
                    yield from self._put(slot.key, None, now)

    def _is_forgotten(self, member: Member, now: float) -> bool:
        at = self.view.seen_at(member.bucket_key).at
        return member.state == "ended" and not self._is_before(at + REMEMBERED, now)

    # Slots

    def _shared(self, now: float) -> dict[Slot, str]:
        """
        Return the new holders of slots that this worker must hand over or take, and of those that
        it has closed. Slots of silent workers are left out until their leases end.
        """
        view, me = self.view, self.lease.id
        eligible = {
            each.id: each.zones
            for each in self._others
            if self._is_before(self._heard_until(each), now)
        }
        silent = {each.id for each in self._others} - set(eligible)
        eligible[me] = self._zones
        # Computed only after a change: steps are frequent, changes are rare.
        rests_on = (view, view.changes, eligible, silent, len(self._closed))
        if self._shared_before is None or self._shared_before[0] != rests_on:
            holders = view.holders
            slots = [slot for slot in view.used_slots if holders.get(slot) not in silent]
            shared = {
                slot: heir
                for slot, heir in share(slots, holders, eligible).items()
                if slot in self._closed or (heir == me) != (holders.get(slot) == me)
            }
            self._shared_before = rests_on, shared
            self._silent = {f"worker.{each}" for each in silent}
        return self._shared_before[1]

    def _slots(self, shared: Mapping[Slot, str], now: float) -> Iterator[Put]:
        """Yield writes that take free slots, and hand over slots that other workers should hold."""
        me = self.lease.id
        for slot, heir in shared.items():
            revision = self.view.seen_at(slot.key).revision
            if self.view.holders.get(slot) == me:
                if heir == me and self._closed.get(slot) != revision:
                    continue
                self._close(slot, revision)
            elif heir != me or not self._is_free(slot, now):
                continue
            yield from self._put(slot.key, encode_holder(heir, me), now)

    def _close(self, slot: Slot, revision: int) -> None:
        """Stop polling a slot that is handed over, until its key changes."""
        if self._closed.get(slot) != revision:
            self._closed[slot] = revision
            self._is_old = True

    def _is_free(self, slot: Slot, now: float) -> bool:
        view = self.view
        holder = view.holder(slot)
        if holder is not None:
            return holder.state == "ended"
        key = f"worker.{view.holders.get(slot)}"
        free_since = max(self._since, view.seen_at(slot.key).at, view.seen_at(key).at)
        return not self._is_before(free_since + self._longest_lease * OTHERS_PART, now)

    def _put(self, key: str, value: bytes | None, now: float) -> Iterator[Put]:
        """Yield a write, unless the same one was yielded recently and the key has not changed."""
        settings = self.view.settings
        revision = self.view.seen_at(key).revision
        last, at, tries = self._asked.get(key, (-1, 0.0, 0))
        if last != revision:
            tries = 0
        elif settings is None or self._is_before(at + settings.lease * AGAIN, now):
            return
        self._asked[key] = (revision, now, tries + 1)
        self._tries = max(self._tries, tries + 1)
        self._is_before(now + (settings.lease * AGAIN if settings else 0.0), now)
        yield Put(key, value, revision)

    # Connections

    def _choose(self, now: float) -> None:
        """Update `active` and `waiting`: the connections in the slots of this worker."""
        if self._leaving or not (self._is_old or self.waiting):
            return
        self._is_old = False
        mine = {
            connection.key: connection
            for connection in self.view.connections
            if self._is_mine(connection.slot)
        }
        acknowledged = self._acknowledged_by_all(now)
        self.waiting = {
            key
            for key, connection in mine.items()
            if key not in self.active and self.view.touched_at(connection) > acknowledged
        }
        self.active = {key: mine[key] for key in mine if key not in self.waiting}

    def _is_mine(self, slot: Slot) -> bool:
        if self.view.holders.get(slot) != self.lease.id:
            return False
        return self._closed.get(slot) != self.view.seen_at(slot.key).revision

    def _acknowledged_by_all(self, now: float) -> float:
        """Return the highest revision that all live workers have acknowledged."""
        wait = self._longest_lease * OTHERS_PART
        if any(self._is_before(at + wait, now) for at in self.view.vanished.values()):
            return 0
        return min((each.seen for each in self._others), default=math.inf)
