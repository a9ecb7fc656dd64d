"""
The keys and values of the bucket, and the view that a program has of it, without sockets or clocks.
Each value is a JSON object.

::

    settings                        the settings of the fleet, such as the length of leases
    connection.ZONE.DIGEST          a connection and its devices, written by `push`
    slot.ZONE.NUMBER                the worker for connections whose digests begin with this byte
    worker.NAME.NONCE               the lease of a worker, and its report

Devices without a zone have the zone "", which is "_" in keys.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from ...files.schema import one_of
from ...protocol.checks import number
from ...protocol.json_text import SORTED_JSON, json_text
from ..engine.buckets import Change
from ..fleet.config import ENGINE, LONGEST_LEASE, SHORTEST_LEASE, OnLoss

BUCKET = "modbus-fleet"

SETTINGS = "settings"

# The version of the format of all records; a bucket with another version is refused.
FORMAT = 1

_TOKEN = re.compile(r"[A-Za-z0-9_-]{1,60}")


class RecordError(ValueError):
    """A record is invalid, or has another version. The message begins with the key."""


class Slot(NamedTuple):
    """The connections of a zone whose digests begin with the same byte."""

    zone: str
    number: int

    @property
    def key(self) -> str:
        return f"slot.{in_key(self.zone)}.{self.number}"


class Holding(NamedTuple):
    """The holder of a slot, and the worker that wrote it."""

    slot: Slot
    holder: str
    by: str

    def encode(self) -> bytes:
        return _encode(holder=self.holder, by=self.by)


@dataclass(frozen=True)
class FleetSettings:
    """The settings of a fleet, which are the same for all workers, as ``[engine]`` has them."""

    lease: float = 10.0
    on_engine_loss: OnLoss = "stop"
    commands: bool = False
    max_age: float = 86_400.0
    max_bytes: int = 1 << 30

    def encode(self) -> bytes:
        return _encode(format=FORMAT, **asdict(self))


@dataclass(frozen=True)
class Connection:
    """
    A connection, with the `DeviceConfig.connection_key` and the longest timeout of its devices.

    Attributes:
        devices: JSON, written by `devices_to_json`, or by any other program.
    """

    zone: str
    key: str
    timeout: float
    devices: str

    @cached_property
    def bucket_key(self) -> str:
        return f"connection.{in_key(self.zone)}.{digest_of(self.key)}"

    @cached_property
    def slot(self) -> Slot:
        return Slot(self.zone, int(digest_of(self.key)[:2], 16))

    @cached_property
    def names(self) -> frozenset[str]:
        """The names of its devices, or none if they are invalid."""
        try:
            return frozenset(device["name"] for device in json.loads(self.devices)["devices"])
        except (KeyError, TypeError):
            return frozenset()

    def encode(self) -> bytes:
        return _encode(connection=self.key, timeout=self.timeout, devices=json.loads(self.devices))


@dataclass(frozen=True)
class Member:
    """
    The record that a worker writes about itself. Each new value renews its lease.

    Attributes:
        id: ``NAME.NONCE``.
        state: "here", or "ended" when its slots are free.
        beat: the number of this value, which is higher than that of the value before.
        seen: the revision up to which the worker has applied the changes of the bucket.
        report: numbers about its devices, for `fleet status`.
    """

    id: str
    state: str
    zones: tuple[str, ...]
    lease: float
    beat: int = 0
    seen: int = 0
    report: Mapping[str, Any] = field(default_factory=dict)

    @property
    def bucket_key(self) -> str:
        return f"worker.{self.id}"

    def encode(self) -> bytes:
        values = asdict(self)
        del values["id"]
        return _encode(**values)


Record = FleetSettings | Connection | Member | Holding


def digest_of(connection: str) -> str:
    return hashlib.sha256(connection.encode()).hexdigest()[:32]


def in_key(zone: str) -> str:
    """Return the form of a zone in keys; ValueError if that cannot be in keys."""
    if zone and not _TOKEN.fullmatch(zone):
        raise ValueError(f"zone {zone[:80]!r} must be 1..60 letters, digits, - or _")
    return zone or "_"


def zone_of(token: str) -> str:
    """Return the zone with a form in keys."""
    return "" if token == "_" else token


def _encode(**values: Any) -> bytes:
    return SORTED_JSON.encode(values).encode()


def decode(key: str, value: bytes) -> Record:
    """Decode a value of the bucket, which any program may have written; or raise RecordError."""
    try:
        return _decoded(key.split("."), json.loads(value))
    except Exception as error:
        what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise RecordError(f"{key[:200]}: {what[:200] or 'the value cannot be read'}") from None


def _decoded(key: list[str], value: Any) -> Record:
    fields = _typed(dict, value)
    match key:
        case ["settings"]:
            if (version := fields.pop("format")) != FORMAT:
                raise ValueError(
                    f"format {version!r} is not supported; this version reads format {FORMAT}"
                )
            return FleetSettings(**ENGINE.read((), fields))
        case ["connection", zone, digest]:
            connection = _typed(str, fields["connection"])
            if digest_of(connection) != digest:
                raise ValueError("connection does not match the digest in the key")
            timeout = float(number("timeout", fields["timeout"], 0, LONGEST_LEASE))
            return Connection(_zone(zone), connection, timeout, json_text(fields["devices"]))
        case ["slot", zone, index]:
            slot = Slot(_zone(zone), int(index))
            if slot.number not in range(256) or slot.key != ".".join(key):
                raise ValueError("the number of a slot must be 0..255")
            return Holding(slot, _typed(str, fields["holder"]), _typed(str, fields["by"]))
        case ["worker", name, nonce]:
            zones = [_typed(str, zone) for zone in _typed(list, fields["zones"])]
            return Member(
                f"{name}.{nonce}",
                one_of("here", "ended")(("state",), fields["state"]),
                tuple(sorted({zone for zone in zones if in_key(zone)})),
                float(number("lease", fields["lease"], SHORTEST_LEASE, LONGEST_LEASE)),
                _typed(int, fields["beat"]),
                _typed(int, fields["seen"]),
                _typed(dict, fields.get("report", {})),
            )
    raise ValueError("no such key")


def _zone(token: str) -> str:
    in_key(token)
    return zone_of(token)


def _typed(kind: type, value: object) -> Any:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"{str(value)[:60]!r} must be of type {kind.__name__}")
    return value


# --- the view ----------------------------------------------------------------------------------

# The bucket is one stream: all workers see its changes in the same order, but not at the same time.

HEARD_PART = 0.5
"""The fraction of a lease for which a worker that has renewed it counts as heard."""


class LastChange(NamedTuple):
    """The last change of a key: its revision, and the time at which it was first seen."""

    revision: int
    at: float


NEVER = LastChange(0, float("-inf"))


class BucketView:
    """
    The bucket, up to a revision.

    Attributes:
        last_touched: the last revision that all workers must acknowledge.
        vanished: ids of workers whose keys were deleted although they had not ended, each with the
            time of the deletion.
        uncertain: keys of slots whose holder changed although the previous holder neither wrote
            this nor had ended, each with the revision of the change.
        unreadable: the keys with invalid values, each with the reason. Their previous values
            are forgotten.
        since: the time at which the view was complete.
        longest_lease: that any worker ever had, in seconds.
    """

    def __init__(self) -> None:
        self.revision: int = 0
        self.last_touched: int = 0
        self.settings: FleetSettings | None = None
        self.members: dict[str, Member] = {}
        self.holders: dict[Slot, str] = {}
        self.last_changes: dict[str, LastChange] = {}
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
        if change.revision <= self.last_change(change.key).revision:
            return False
        self.last_changes[change.key] = LastChange(change.revision, at)
        self.revision = max(self.revision, change.revision)
        holder = self._forget(change, at)
        if change.value is not None:
            self._learn(change.key, change.value, change.revision, holder)
        return True

    def follow(self, before: BucketView, at: float) -> None:
        """Replace another view at this time; keep what that one knows about the same bucket."""
        self.since = at
        # Otherwise it is another bucket, or one that lost changes: equal revisions mean nothing.
        is_same = self.revision >= before.revision
        self.longest_lease = max(self.longest_lease, before.longest_lease)
        for key, revision in before.last_changes.items():
            mine = self.last_changes.get(key)
            if mine is None:
                # Deleted at an unknown time.
                self.last_changes[key] = LastChange(0, at)
                self._touch(key, self.revision)
            elif is_same and mine.revision == revision.revision:
                self.last_changes[key] = revision
                if before.uncertain.get(key) is None:
                    self.uncertain.pop(key, None)
        for name, member in before.members.items():
            if name not in self.members and member.state != "ended":
                self.vanished[name] = at
        self.vanished = {**before.vanished, **self.vanished}

    def heard_until(self, member: Member) -> float:
        """Return the time at which a worker counts as dead unless it renews its lease."""
        return self.last_change(member.bucket_key).at + member.lease * HEARD_PART

    def is_heard(self, member: Member, now: float) -> bool:
        """Return True if a worker has renewed its lease recently, and has not ended."""
        return member.state != "ended" and now < self.heard_until(member)

    @property
    def all_connections(self) -> list[Connection]:
        """The connections; one that is in two zones is there twice."""
        return [record for record in self._records.values() if isinstance(record, Connection)]

    @property
    def connections(self) -> Collection[Connection]:
        """The connections; of one that is in two zones, only the newer record."""
        if self._connections is None:
            by_age = sorted(
                self.all_connections,
                key=lambda connection: self.last_changes[connection.bucket_key],
            )
            self._connections = {connection.key: connection for connection in by_age}
        return self._connections.values()

    @property
    def used_slots(self) -> set[Slot]:
        return {connection.slot for connection in self.all_connections}

    def touched_at(self, connection: Connection) -> int:
        """Return the revision that other workers must acknowledge before a connection is polled."""
        revision = self._touched.get(digest_of(connection.key), 0)
        return max(revision, self.uncertain.get(connection.slot.key, 0))

    def holder(self, slot: Slot) -> Member | None:
        """Return the holder of a slot; None if the holder is not a known worker."""
        return self.members.get(self.holders.get(slot, ""))

    def last_change(self, key: str) -> LastChange:
        return self.last_changes.get(key, NEVER)

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
            former = self.members.get(before)
            if (before and record.by == before) or (former is not None and former.state == "ended"):
                self.uncertain.pop(key, None)
            else:
                self.uncertain[key] = revision
                self.last_touched = max(self.last_touched, revision)
