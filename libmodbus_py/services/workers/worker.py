"""
What a worker does: its lease, its slots, and whom it may ask. No socket, no clock: told what
it sees and what time it is, it says what to write.

Why no connection is asked by two
---------------------------------
All that workers know comes from the bucket, whose changes all see in one order. Writes go out
on condition that their key has not changed.

* A worker has its slots as long as it has its lease. It counts that from before it sent the
  value that it sees, or that was confirmed, and uses `OWN_PART` of it, less the time that an
  answer may take. Others count it from when they saw the value, and wait for `OTHERS_PART`:
  each by its own clock, which may go wrong by 7 %. Only then they write that it has ended, on
  condition that its value is still the one they saw. That worker sees this, and begins anew
  under another id.
* A slot passes to another worker when its holder writes that, having closed it before; or
  when its holder has ended, by its own word or that of the others. What nobody is known to
  hold was perhaps held by somebody who was deleted: it is taken after the longest lease.
* A connection that appears in a slot may have been in another one: it is asked when all
  workers have heeded the revision that brought it. So is a slot that changed hands in no such
  way: because somebody else wrote in the bucket, or it lost what it had confirmed.
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

# Of a lease: who was silent for longer is given nothing.
FRESH = 0.5

# Of a lease: who does not see its own values sees nothing.
BLIND = 0.3

# Of a lease: keys that somebody purges are gone without a word.
READ_AGAIN = 60

# What was written so often for nothing rests on something that is not so.
MOST_TRIES = 3

# Seconds; for people who ask what became of a worker.
REMEMBERED = 60.0


class Put(NamedTuple):
    """
    Something to write.

    Attributes:
        value: None to delete the key.
        last: the revision that the key must still have; 0 if it never was.
        beat: of this worker's own value; else 0.
    """

    key: str
    value: bytes | None
    last: int
    beat: int = 0


class Worker:
    """
    One of those who share the connections.

    Args:
        new_id: gives an id that nobody has or had: ``NAME.NONCE``.
        zones: whose connections it takes; "" is that of devices without a zone.

    Attributes:
        view: the bucket, as far as it is known.
        lease: its own.
        active: the connections that it asks, by their keys, as of the last step.
        waiting: those that wait until all others have heeded that they are here.
        left: whether it has ended after `leave`.
        due: when the next `step` may decide something, unless the worker is told of something
            before: that may make it due at once.
    """

    def __init__(self, new_id: Callable[[], str], zones: Collection[str]) -> None:
        self.view: BucketView = BucketView()
        self.left: bool = False
        self.due: float = -math.inf
        self._new_id = new_id
        self._zones = tuple(sorted(zones))
        self._snapshot: BucketView | None = None
        # When it began to see the bucket without a break that matters.
        self._since = math.inf
        # When it heard itself, and since when without a break: others are silent only then.
        self._heard_at = self._hears_since = -math.inf
        self._longest_lease = 0.0
        self._leaving = False
        self._goes_on = False
        # Who should have each slot whose holder is another one, and what that rests on.
        self._shared_before: tuple[tuple[Any, ...], dict[Slot, str]] | None = None
        self._silent: set[str] = set()
        self.active: dict[str, Connection] = {}
        self.waiting: set[str] = set()
        self._join()

    # What it is told

    def begins(self) -> None:
        """All of the bucket comes now, from its beginning."""
        self._snapshot = BucketView()

    def saw(self, entry: Entry, now: float) -> None:
        """A key has this value now."""
        if self._snapshot is not None:
            self._snapshot.add(entry, now)
            return
        changes = self.view.changes
        if self.view.add(entry, now):
            self._is_old |= not entry.key.startswith("worker.")
            self._heed()
            if entry.key == self.lease.key:
                self._hear(now)
                self._was_heard()
            if self.view.changes != changes or self._awaits(entry.key):
                self._due_at(-math.inf)

    def is_synced(self, now: float) -> None:
        """That was all; changes come from now on."""
        if self._snapshot is None:
            return
        view, before, self._snapshot = self._snapshot, self.view, None
        self.view = view
        if view.revision < before.revision:
            # It is another bucket, or has forgotten what it had confirmed.
            self._join()
        else:
            view.keep_times(before, now)
        self._is_old = True
        self._since = now
        self._tries = 0
        self._asked.clear()
        self._heed()
        self._due_at(-math.inf)

    def was_written(self, put: Put, revision: int) -> None:
        """
        The bucket confirmed a write. Of its own value this worker hears so although it may see
        nothing else: nobody had said that it has ended. It heeds no more than it has seen.
        """
        if put.beat and put.key == self.lease.key and not self._leaving:
            self.lease.is_confirmed(put.beat, revision)
            self._was_heard()

    def leave(self) -> None:
        """Ask nobody any more, and say that it has ended: others take its slots at once."""
        self._leaving = True
        self.active = {}
        self._due_at(-math.inf)

    # What it says

    @property
    def heard_at(self) -> float:
        """When it saw its own value in the bucket the last time."""
        return self.view.seen_at(self.lease.key).at

    @property
    def is_reading(self) -> bool:
        """Whether all of the bucket comes, and has not come yet."""
        return self._snapshot is not None

    def is_heard(self, member: Member, now: float) -> bool:
        """Whether a worker, perhaps this one, told of itself a short while ago."""
        return member.state != "ended" and now < self._heard_until(member)

    def is_blind(self, now: float) -> bool:
        """Whether all of the bucket should be read again: it is not what it seems to be."""
        settings = self.view.settings
        if self._snapshot is not None or settings is None:
            return False
        return now >= self._blind_at(settings.lease) or self._tries >= MOST_TRIES

    def may_ask(self, connection: str, now: float) -> bool:
        """Whether bytes may go there right now."""
        known = self.active.get(connection)
        if known is None:
            return False
        return self._goes_on or now + known.timeout < self.lease.until

    def step(self, now: float, report: Callable[[], Mapping[str, Any]] = dict) -> list[Put]:
        """
        Decide what to write. `active` is up to date then; what is not in it any more must not
        be asked before any of this is written.

        Args:
            report: returns what it says of its devices, for people.
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
        # Last: it says up to where everything is heeded.
        puts += self._beats(now, settings.lease, report)
        self._is_before(self._blind_at(settings.lease), now)
        return puts

    # When it decides

    def _due_at(self, at: float) -> None:
        self.due = min(self.due, at)

    def _is_before(self, at: float, now: float) -> bool:
        """Tell whether a time is still to come; if so, a step is due then."""
        if now < at:
            self._due_at(at)
            return True
        return False

    def _was_heard(self) -> None:
        """A value of this worker's own has come back: the next one is due sooner."""
        settings = self.view.settings
        if settings is not None:
            self._due_at(self.lease.next_at(settings.lease, hurry=False))
        if not self._is_valid:
            self._due_at(-math.inf)

    def _awaits(self, key: str) -> bool:
        """Tell whether even a sign of life of a known worker may change what is decided."""
        return bool(self.waiting) or not self._is_valid or key in self._silent

    def _heard_until(self, member: Member) -> float:
        return self.view.seen_at(member.bucket_key).at + member.lease * FRESH

    def _blind_at(self, lease: float) -> float:
        heard = max(self.heard_at, self._since)
        return min(heard + lease * BLIND, self._since + lease * READ_AGAIN)

    # Its lease

    def _join(self) -> None:
        """Nothing is its own."""
        self.lease: Lease = Lease(self._new_id())
        self.active = {}
        self.waiting = set()
        self._closed: dict[Slot, int] = {}
        self._asked: dict[str, tuple[int, float, int]] = {}
        self._tries = 0
        self._is_old = True
        self._is_valid = False
        self._due_at(-math.inf)

    def _heed(self) -> None:
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
        """Those who may have slots."""
        members = self.view.members.values()
        return (each for each in members if each.id != self.lease.id and each.state != "ended")

    def _ends(self, now: float) -> Iterator[Put]:
        """Say of those whose lease is over that they have ended."""
        for member in self._others:
            at = max(self._hears_since, self.view.seen_at(member.bucket_key).at)
            if not self._is_before(at + member.lease * OTHERS_PART, now):
                yield from self._put(
                    member.bucket_key, replace(member, state="ended").encode(), now
                )

    def _forgotten(self, now: float) -> Iterator[Put]:
        """Delete what tells of those who ended long ago; the first worker does it for all."""
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
        Give who should have each slot that this worker has and should not have, or should have
        and has not; and each that it has closed. Those of workers who fell silent wait for
        their end.
        """
        view, me = self.view, self.lease.id
        eligible = {
            each.id: each.zones
            for each in self._others
            if self._is_before(self._heard_until(each), now)
        }
        silent = {each.id for each in self._others} - set(eligible)
        eligible[me] = self._zones
        # It is asked for several times a second, and hardly ever changes.
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
        """Take what is free, and hand over what others should have."""
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
        """What was promised to another worker stays so until the bucket tells."""
        if self._closed.get(slot) != revision:
            self._closed[slot] = revision
            self._is_old = True

    def _is_free(self, slot: Slot, now: float) -> bool:
        view = self.view
        holder = view.holder(slot)
        if holder is not None:
            return holder.state == "ended"
        key = f"worker.{view.holders.get(slot)}"
        nobody_since = max(self._since, view.seen_at(slot.key).at, view.seen_at(key).at)
        return not self._is_before(nobody_since + self._longest_lease * OTHERS_PART, now)

    def _put(self, key: str, value: bytes | None, now: float) -> Iterator[Put]:
        """Write it; again only after a while, or when the key has changed."""
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
        """Find the connections of its slots, and those that may be asked."""
        if self._leaving or not (self._is_old or self.waiting):
            return
        self._is_old = False
        mine = {
            connection.key: connection
            for connection in self.view.connections
            if self._is_mine(connection.slot)
        }
        heeded = self._heeded_by_all(now)
        self.waiting = {
            key
            for key, connection in mine.items()
            if key not in self.active and self.view.touched_at(connection) > heeded
        }
        self.active = {key: mine[key] for key in mine if key not in self.waiting}

    def _is_mine(self, slot: Slot) -> bool:
        if self.view.holders.get(slot) != self.lease.id:
            return False
        return self._closed.get(slot) != self.view.seen_at(slot.key).revision

    def _heeded_by_all(self, now: float) -> float:
        """The revision up to which nobody does anything else any more."""
        wait = self._longest_lease * OTHERS_PART
        if any(self._is_before(at + wait, now) for at in self.view.vanished.values()):
            return 0
        return min((each.seen for each in self._others), default=math.inf)
