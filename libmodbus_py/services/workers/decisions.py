"""
The decisions of a worker: the connections that it polls, what it writes into the bucket, and when
it must look again. `decide` is a function of what the worker knows and the time on its own clock;
it has no effects.

Why no two workers poll one connection
--------------------------------------
Workers know about each other only from the bucket, whose changes all of them see in the same
order. A write succeeds only if its key has not changed.

* A worker holds its slots while its lease is valid. It counts the lease from just before it sent
  the value that it then saw in the bucket, and uses `OWN_PART` of it, less the timeout of the
  device; it looks at its clock before each request. Other workers count the lease from when
  they saw the value, and wait for `OTHERS_PART` of it before they write that the worker has ended.
  Each uses its own clock, which may be wrong by 7 %. This write succeeds only if the value is still
  the one that they saw. The worker itself, if it still runs, sees the write, and begins anew with
  another id.
* A slot passes to another worker when its holder writes so, after closing its connections, or when
  it is recorded, by the holder or by another worker, that the holder has ended. A slot without a
  known holder may be held by a worker whose key was deleted: it is taken after the longest lease.
* A connection that appears in a slot may have been in another slot before. It is polled when all
  workers have acknowledged the revision with which it appeared. The same holds for a slot whose
  holder changed in any other way: because another program wrote to the bucket, or because the
  bucket lost confirmed writes.

====================  ===========================================================================
slot                  what a worker with a valid lease does
====================  ===========================================================================
mine, and I am owner  polls its connections that all others have acknowledged
mine, other owner     stops polling, and writes the owner; does not poll before the key changes
of a silent worker    nothing, until it is heard or `OTHERS_PART` of its lease is over: then it
                      writes that the worker has ended
of an ended worker    the owner writes itself
of an unknown worker  the owner writes itself after `OTHERS_PART` of the longest lease
====================  ===========================================================================

The owners are those of `share`, among the workers that were heard within `HEARD_PART` of their
leases. `may_ask` of the worker is the only guard that does not depend on anything being written.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

from .records import Connection, Holding, Member, Slot
from .worker import Decision, Put, Worker

# The fraction of a lease that other workers wait, counted from when they saw the renewal.
OTHERS_PART = 1.05

# The fractions of a lease after which it is renewed: usually, and while other workers wait for an
# acknowledgement.
BEAT, SOON = 0.1, 0.01

# The fraction of a lease after which a write whose success was not seen is repeated.
AGAIN = 0.2

# The fraction of a lease after which a worker that does not see its own values reads the bucket
# again: not yet if NATS takes 0.3 of a lease, and early enough to keep the lease.
UNSEEN = 0.5

# The time after which the bucket is read again, in leases: no change reports that a key was purged.
READ_AGAIN = 60

# The time for which a slot may be without a worker, in leases: after 1.05, another worker has it.
UNSERVED = 1.5

# Seconds for which ended workers stay in the bucket, for `fleet status`.
REMEMBERED_S = 60.0


def step(worker: Worker, now: float, report: Mapping[str, Any] | None = None) -> Decision:
    """Decide, and let the worker remember the decision, which the caller carries out."""
    decision = decide(worker, now, report)
    worker.note_decision(decision, now)
    return decision


def decide(worker: Worker, now: float, report: Mapping[str, Any] | None = None) -> Decision:
    """Return what a worker does now; `report` contains numbers for `fleet status`."""
    settings = worker.view.settings
    if settings is None or worker.is_reading or worker.has_left:
        return Decision(worker.active)
    return _Deciding(worker, now, settings.lease).decision(report or {})


class _Deciding:
    """One decision; `lease` is the length of the lease of this worker."""

    def __init__(self, worker: Worker, now: float, lease: float) -> None:
        self.worker = worker
        self.view = worker.view
        self.me = worker.id
        self.now = now
        self.lease = lease
        self.used_slots = worker.view.used_slots
        self.longest_wait = worker.view.longest_lease * OTHERS_PART
        self.puts: list[Put] = []
        self.due = math.inf
        self.has_repeated = False
        # The other workers that may hold slots; and those whose slots are not shared now.
        self.others = [
            member
            for member in self.view.members.values()
            if member.id != self.me and member.state != "ended"
        ]
        self.silent = {
            member.id for member in self.others if self.has_passed(self.view.heard_until(member))
        }

    def has_passed(self, at: float) -> bool:
        """Return True if a time is not in the future; otherwise a decision is due at that time."""
        if self.now < at:
            self.due = min(self.due, at)
            return False
        return True

    def decision(self, report: Mapping[str, Any]) -> Decision:
        worker = self.worker
        is_valid = not self.has_passed(worker.lease_until)
        if is_valid and not worker.is_leaving:
            self.record_ends()
            self.move_slots()
            self.forget_ended()
        active = {} if worker.is_leaving else self.polled()
        slots = self.unserved() if worker.is_first(self.now) else []
        # Last, because it acknowledges all changes up to the revision of the view.
        self.renew_lease(report)
        return Decision(active, self.puts, self.due, self.must_read_again(), slots)

    def put_key(self, key: str, value: bytes | None) -> None:
        """Write a key, unless the same was written recently and the key has not changed."""
        pause = self.lease * AGAIN
        if self.worker.has_written(key):
            if not self.has_passed(self.worker.attempts[key][1] + pause):
                return
            self.has_repeated = True
        self.puts.append(Put(key, value, self.view.last_change(key).revision))
        self.has_passed(self.now + pause)

    # Workers

    def record_ends(self) -> None:
        for member in self.others:
            at = max(self.worker.hears_since, self.view.last_change(member.bucket_key).at)
            if self.has_passed(at + member.lease * OTHERS_PART):
                self.put_key(member.bucket_key, replace(member, state="ended").encode())

    def forget_ended(self) -> None:
        """Delete workers that ended long ago, and hold no slots with connections."""
        holders = {self.view.holders.get(slot) for slot in self.used_slots}
        for member in self.view.members.values():
            at = self.view.last_change(member.bucket_key).at
            is_gone = member.state == "ended" and member.id not in holders
            if is_gone and self.has_passed(at + REMEMBERED_S):
                self.put_key(member.bucket_key, None)

    def renew_lease(self, report: Mapping[str, Any]) -> None:
        worker, view = self.worker, self.view
        me = view.members.get(self.me)
        hurry = worker.is_leaving or (me is not None and me.seen < view.last_touched)
        pause = self.lease * (SOON if hurry else BEAT)
        if self.has_passed(worker.sent_at + pause):
            state = "ended" if worker.is_leaving else "here"
            beat = worker.beat + 1
            record = Member(self.me, state, worker.zones, self.lease, beat, view.revision, report)
            self.puts.append(
                Put(worker.key, record.encode(), view.last_change(worker.key).revision)
            )
            self.has_passed(self.now + pause)

    def must_read_again(self) -> bool:
        """Return True if changes may be missing: own values unseen, or a repeated write."""
        heard_at = max(self.view.last_change(self.worker.key).at, self.view.since)
        at = min(heard_at + self.lease * UNSEEN, self.view.since + self.lease * READ_AGAIN)
        return self.has_passed(at) or self.has_repeated

    # Slots

    def move_slots(self) -> None:
        """Take free slots, and hand over slots that other workers should hold."""
        holders = self.view.holders
        eligible = {
            member.id: member.zones for member in self.others if member.id not in self.silent
        }
        eligible[self.me] = self.worker.zones
        slots = {slot for slot in self.used_slots if holders.get(slot) not in self.silent}
        for slot, owner in share(slots, holders, eligible).items():
            if holders.get(slot) == self.me:
                # The write of another owner may still succeed: this one does, or that one.
                moves = owner != self.me or not self.worker.is_mine(slot)
            else:
                moves = owner == self.me and self.is_free(slot)
            if moves:
                self.put_key(slot.key, Holding(slot, owner, self.me).encode())

    def is_free(self, slot: Slot) -> bool:
        holder = self.view.holder(slot)
        if holder is not None:
            return holder.state == "ended"
        return self.has_passed(self.free_since(slot) + self.longest_wait)

    def free_since(self, slot: Slot) -> float:
        """Return the time since when a slot has had no worker, unless an unknown one holds it."""
        view = self.view
        holder = f"worker.{view.holders.get(slot)}"
        return max(view.since, view.last_change(slot.key).at, view.last_change(holder).at)

    # Connections

    def polled(self) -> dict[str, Connection]:
        """Return the connections to poll: of own slots, and acknowledged by all workers."""
        put_keys = {put.key for put in self.puts}
        slots = {
            slot
            for slot in self.used_slots
            if self.worker.is_mine(slot) and slot.key not in put_keys
        }
        mine = {
            connection.key: connection
            for connection in self.view.connections
            if connection.slot in slots
        }
        new = mine.keys() - self.worker.active.keys()
        # The highest revision that all workers with a lease have acknowledged.
        last_seen = min((member.seen for member in self.others), default=math.inf)
        gone_members = self.view.vanished.values() if new else ()
        if not all(self.has_passed(at + self.longest_wait) for at in gone_members):
            last_seen = 0
        return {
            key: connection
            for key, connection in mine.items()
            if key not in new or self.view.touched_at(connection) <= last_seen
        }

    def unserved(self) -> list[Connection]:
        view = self.view
        wait = UNSERVED * view.longest_lease
        free = {
            slot: self.free_since(slot)
            for slot in self.used_slots
            if (holder := view.holder(slot)) is None or holder.state == "ended"
        }
        return [
            connection
            for connection in (view.connections if free else ())
            if connection.slot in free
            and self.has_passed(
                max(free[connection.slot], view.last_change(connection.bucket_key).at) + wait
            )
        ]


# --- the assignment of slots ---------------------------------------------------------------------


def share(
    slots: Collection[Slot], holders: Mapping[Slot, str], zones: Mapping[str, Collection[str]]
) -> dict[Slot, str]:
    """
    Return the worker of each slot, the same in all workers with the same view. Workers that may
    hold the same slots get nearly equal numbers of them, and few slots move. Slots that no worker
    may hold are left out.

    Args:
        holders: slot -> its current holder; holders that `zones` does not contain are ignored.
        zones: worker that may hold slots -> its zones.
    """
    pools: defaultdict[tuple[str, ...], list[Slot]] = defaultdict(list)
    for slot in sorted(slots):
        pools[tuple(sorted(worker for worker in zones if slot.zone in zones[worker]))].append(slot)
    return {
        slot: worker
        for workers, pool in pools.items()
        if workers
        for slot, worker in _shared(pool, holders, workers)
    }


def _shared(
    slots: list[Slot], holders: Mapping[Slot, str], workers: tuple[str, ...]
) -> Iterator[tuple[Slot, str]]:
    """Yield the worker of each slot; all of these workers may hold any of them."""
    has: dict[str, list[Slot]] = {worker: [] for worker in workers}
    free: list[Slot] = []
    for slot in slots:
        has.get(holders.get(slot, ""), free).append(slot)
    least, more = divmod(len(slots), len(workers))
    # The workers with the most slots get the larger quotas, so that fewer slots move.
    by_size = sorted(workers, key=lambda worker: (-len(has[worker]), worker))
    quota = {worker: least + (at < more) for at, worker in enumerate(by_size)}
    for worker, its in has.items():
        free += its[quota[worker] :]
        del its[quota[worker] :]
    for worker, its in has.items():
        while len(its) < quota[worker]:
            its.append(free.pop())
        yield from ((slot, worker) for slot in its)
