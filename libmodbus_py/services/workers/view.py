"""
The known contents of the bucket, with the times of changes, without sockets or clocks.

The bucket is one stream: all workers see its changes in the same order, but not at the same time.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from ..engine.buckets import Change
from .records import (
    Connection,
    FleetSettings,
    Holding,
    Member,
    Record,
    RecordError,
    Slot,
    decode,
    digest_of,
)

__all__ = ["HEARD_PART", "BucketView"]

HEARD_PART = 0.5
"""The fraction of a lease for which a worker that has renewed it counts as heard."""


class Seen(NamedTuple):
    """The last change of a key: its revision, and the time at which it was first seen."""

    revision: int
    at: float


NEVER = Seen(0, float("-inf"))


class BucketView:
    """
    The bucket, up to a revision.

    Attributes:
        last_touched: the last revision that all workers must acknowledge.
        settings, members, holders: the records; members by their ids, holders by slots.
        seen: the last change of each key.
        vanished: ids of workers whose keys were deleted although they had not ended, each with the
            time of the deletion.
        uncertain: keys of slots whose holder changed although the previous holder neither wrote
            this nor had ended, each with the revision of the change.
        unreadable: the keys with invalid values, each with the reason. Their previous values
            are forgotten.
        since: the time at which the view was complete.
        longest_lease: the longest lease that any worker ever had, in seconds.
    """

    def __init__(self) -> None:
        self.revision: int = 0
        self.last_touched: int = 0
        self.settings: FleetSettings | None = None
        self.members: dict[str, Member] = {}
        self.holders: dict[Slot, str] = {}
        self.seen: dict[str, Seen] = {}
        self.vanished: dict[str, float] = {}
        self.uncertain: dict[str, int] = {}
        self.unreadable: dict[str, str] = {}
        self.since: float = float("inf")
        self.longest_lease: float = 0.0
        self._records: dict[str, Record] = {}
        # By the digest of a connection, whatever its zone: the revision of its last change.
        self._touched: dict[str, int] = {}
        # By their keys; None after a change.
        self._connections: dict[str, Connection] | None = None

    def add(self, change: Change, at: float) -> bool:
        """Apply a change that was seen at this time; return False if it was applied before."""
        if change.revision <= self.seen_at(change.key).revision:
            return False
        self.seen[change.key] = Seen(change.revision, at)
        self.revision = max(self.revision, change.revision)
        holder = self._forget(change, at)
        if change.value is not None:
            self._learn(change.key, change.value, change.revision, holder)
        return True

    def follow(self, before: BucketView, at: float) -> None:
        """Replace another view at this time; keep what that one knows about the same bucket."""
        self.since = at
        self.longest_lease = max(self.longest_lease, before.longest_lease)
        for key, seen in before.seen.items():
            mine = self.seen.get(key)
            if mine is None:
                # Deleted at an unknown time.
                self.seen[key] = Seen(0, at)
                self._touch(key, self.revision)
            elif mine.revision == seen.revision:
                self.seen[key] = seen
                if before.uncertain.get(key) is None:
                    self.uncertain.pop(key, None)
        for name, member in before.members.items():
            if name not in self.members and member.state != "ended":
                self.vanished[name] = at
        self.vanished = {**before.vanished, **self.vanished}

    def heard_until(self, member: Member) -> float:
        """Return the time at which a worker is not heard any more unless it renews its lease."""
        return self.seen_at(member.bucket_key).at + member.lease * HEARD_PART

    def is_heard(self, member: Member, now: float) -> bool:
        """Return True if a worker has renewed its lease recently, and has not ended."""
        return member.state != "ended" and now < self.heard_until(member)

    @property
    def all_connections(self) -> list[Connection]:
        """The connections; one that is in two zones is there twice."""
        return [each for each in self._records.values() if isinstance(each, Connection)]

    @property
    def connections(self) -> Collection[Connection]:
        """The connections; of one that is in two zones, only the newer record."""
        if self._connections is None:
            by_age = sorted(self.all_connections, key=lambda each: self.seen[each.bucket_key])
            self._connections = {each.key: each for each in by_age}
        return self._connections.values()

    @property
    def used_slots(self) -> set[Slot]:
        """The slots that contain connections."""
        return {each.slot for each in self.all_connections}

    def touched_at(self, connection: Connection) -> int:
        """Return the revision that other workers must acknowledge before a connection is polled."""
        touched = self._touched.get(digest_of(connection.key), 0)
        return max(touched, self.uncertain.get(connection.slot.key, 0))

    def holder(self, slot: Slot) -> Member | None:
        """Return the holder of a slot; None if the holder is not a known worker."""
        return self.members.get(self.holders.get(slot, ""))

    def seen_at(self, key: str) -> Seen:
        return self.seen.get(key, NEVER)

    def _forget(self, change: Change, at: float) -> str:
        """Forget the value of a key. Return the previous holder if the key is a slot's, else ""."""
        self.unreadable.pop(change.key, None)
        self._touch(change.key, change.revision)
        record = self._records.pop(change.key, None)
        if isinstance(record, Holding):
            return self.holders.pop(record.slot)
        if isinstance(record, Member):
            del self.members[record.id]
            if record.state != "ended":
                self.vanished[record.id] = at
        return ""

    def _touch(self, key: str, revision: int) -> None:
        if key.startswith("connection."):
            self._connections = None
            self._touched[key.rpartition(".")[2]] = revision
            self.last_touched = max(self.last_touched, revision)

    def _learn(self, key: str, value: bytes, revision: int, before: str) -> None:
        try:
            record = self._records[key] = decode(key, value)
        except RecordError as error:
            self.unreadable[key] = str(error)
            return
        if isinstance(record, FleetSettings):
            self.settings = record
            self.longest_lease = max(self.longest_lease, record.lease)
        elif isinstance(record, Member):
            self.members[record.id] = record
            self.longest_lease = max(self.longest_lease, record.lease)
            self.vanished.pop(record.id, None)
        elif isinstance(record, Holding):
            self.holders[record.slot] = record.holder
            had = self.members.get(before)
            if (before and record.by == before) or (had is not None and had.state == "ended"):
                self.uncertain.pop(key, None)
            else:
                self.uncertain[key] = revision
                self.last_touched = max(self.last_touched, revision)
