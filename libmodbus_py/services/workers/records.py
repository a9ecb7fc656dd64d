"""
The keys and values of the bucket, without sockets or clocks.

::

    settings                        the settings of the fleet, such as the length of leases
    connection.ZONE.DIGEST          a connection and its devices, written by `push`
    slot.ZONE.NUMBER                the worker for connections whose digests begin with this byte
    worker.NAME.NONCE               the lease of a worker, and its report
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

from ...protocol.checks import number
from ...protocol.json_text import SORTED_JSON, json_text
from ...tools.files.schema import one_of
from ..fleet.config import ENGINE, LONGEST_LEASE, SHORTEST_LEASE, OnLoss

__all__ = [
    "BUCKET",
    "SETTINGS",
    "Connection",
    "FleetSettings",
    "Holding",
    "Member",
    "Record",
    "RecordError",
    "Slot",
    "State",
    "decode",
    "digest_of",
    "encode_holder",
    "in_key",
    "zone_of",
]

BUCKET = "modbus-fleet"
"""The name of the bucket."""

FORMAT = 1
"""The version of the format of all records. A bucket with another version is refused."""

SETTINGS = "settings"

State = Literal["here", "ended"]

# The longest value in bytes: the default limit of NATS, 1 MiB.
MAX_VALUE = 1 << 20

_TOKEN = re.compile(r"[A-Za-z0-9_-]{1,60}")
_DIGEST = re.compile(r"[0-9a-f]{32}")


class RecordError(ValueError):
    """A record is invalid, or has another version. The message begins with the key."""


class Slot(NamedTuple):
    """The connections of a zone whose digests begin with the same byte."""

    zone: str
    number: int

    @property
    def key(self) -> str:
        return f"slot.{in_key(self.zone)}.{self.number}"


@dataclass(frozen=True)
class FleetSettings:
    """
    The settings of a fleet, which are the same for all workers.

    Attributes:
        lease: the length of a lease in seconds, 0.5..60.
        on_engine_loss: "stop" or "continue" polling when the lease has expired.
        commands: True if points may be written through NATS.
        max_age, max_bytes: the limits of the stream of readings; the age is in seconds.
    """

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
    A connection and its devices.

    Attributes:
        zone: the zone of its devices; empty for none.
        key: the `DeviceConfig.connection_key` of its devices.
        timeout: the longest timeout of its devices, in seconds.
        devices: JSON, written by `devices_to_json`.
    """

    zone: str
    key: str
    timeout: float
    devices: str

    @property
    def bucket_key(self) -> str:
        return f"connection.{in_key(self.zone)}.{digest_of(self.key)}"

    @cached_property
    def slot(self) -> Slot:
        return Slot(self.zone, int(digest_of(self.key)[:2], 16))

    def encode(self) -> bytes:
        return _encode(connection=self.key, timeout=self.timeout, devices=json.loads(self.devices))


@dataclass(frozen=True)
class Member:
    """
    The record that a worker writes about itself. Each new value renews its lease.

    Attributes:
        id: ``NAME.NONCE``: the key of the record without ``worker.``.
        state: "here", or "ended" when its slots are free.
        zones: the zones whose devices it polls.
        lease: the length of the lease in seconds.
        beat: the number of this value, which is higher than that of the value before.
        seen: the revision up to which the worker has applied the changes of the bucket.
        report: numbers about its devices, for `fleet status`.
    """

    id: str
    state: State
    zones: tuple[str, ...]
    lease: float
    beat: int = 0
    seen: int = 0
    report: Mapping[str, Any] = field(default_factory=dict)

    @property
    def bucket_key(self) -> str:
        return f"worker.{self.id}"

    def is_as(self, other: Member) -> bool:
        """Return True if another record has the same state, zones and length of the lease."""
        return (self.state, self.zones, self.lease) == (other.state, other.zones, other.lease)

    def encode(self) -> bytes:
        values = asdict(self)
        del values["id"]
        return _encode(**values)


def digest_of(connection: str) -> str:
    """Return the digest that represents a connection in keys."""
    return hashlib.sha256(connection.encode()).hexdigest()[:32]


class Holding(NamedTuple):
    """The holder of a slot, and the worker that wrote it."""

    slot: Slot
    holder: str
    by: str


def encode_holder(worker: str, by: str) -> bytes:
    """Encode the holder of a slot, and the worker that writes the record."""
    return _encode(holder=worker, by=by)


def in_key(zone: str) -> str:
    """
    Return the form of a zone in keys: "_" for devices without a zone.

    Raises:
        ValueError: the zone is longer than 60 characters, or contains characters other than
            letters, digits, - and _.
    """
    if zone and not _TOKEN.fullmatch(zone):
        raise ValueError(f"zone {zone[:80]!r} must be 1..60 letters, digits, - or _")
    return zone or "_"


def zone_of(token: str) -> str:
    """Return the zone with a form in keys."""
    return "" if token == "_" else token


Record = FleetSettings | Connection | Member | Holding


def decode(key: str, value: bytes) -> Record:
    """
    Decode a value of the bucket.

    Raises:
        RecordError: the key is unknown, or its value is invalid.
    """
    kind, *rest = key.split(".")
    reader = _READERS.get((kind, len(rest)))
    if reader is None:
        raise RecordError(f"{key[:200]}: no such key")
    try:
        if len(value) > MAX_VALUE:
            raise ValueError(f"more than {MAX_VALUE} bytes")
        given = json.loads(value)
        if not isinstance(given, dict):
            raise ValueError("must be a JSON object")
        return reader(rest, given)
    except Exception as error:
        what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise RecordError(f"{key[:200]}: {what[:200] or 'the value cannot be read'}") from None


def _settings(_rest: list[str], given: dict[str, Any]) -> FleetSettings:
    if (found := given.pop("format")) != FORMAT:
        raise ValueError(f"format {found!r} is not supported; this version reads format {FORMAT}")
    return FleetSettings(**ENGINE.read((), given))


def _connection(rest: list[str], given: dict[str, Any]) -> Connection:
    zone, digest = rest
    key = _typed(str, given["connection"])
    if not _DIGEST.fullmatch(digest) or digest_of(key) != digest:
        raise ValueError("connection does not match the digest in the key")
    timeout = float(number("timeout", given["timeout"], 0, LONGEST_LEASE))
    return Connection(_zone(zone), key, timeout, json_text(given["devices"]))


def _slot(rest: list[str], given: dict[str, Any]) -> Holding:
    zone, number = rest
    slot = Slot(_zone(zone), int(number))
    if slot.number not in range(256) or slot.key != f"slot.{zone}.{number}":
        raise ValueError("the number of a slot must be 0..255")
    return Holding(slot, _typed(str, given["holder"]), _typed(str, given["by"]))


def _member(rest: list[str], given: dict[str, Any]) -> Member:
    zones = [_typed(str, zone) for zone in _typed(list, given["zones"])]
    return Member(
        ".".join(rest),
        one_of(*get_args(State))(("state",), given["state"]),
        tuple(sorted({zone for zone in zones if in_key(zone)})),
        _lease(given["lease"]),
        _typed(int, given["beat"]),
        _typed(int, given["seen"]),
        _typed(dict, given.get("report", {})),
    )


_READERS: dict[tuple[str, int], Callable[[list[str], dict[str, Any]], Record]] = {
    (SETTINGS, 0): _settings,
    ("connection", 2): _connection,
    ("slot", 2): _slot,
    ("worker", 2): _member,
}


def _zone(token: str) -> str:
    in_key(token)
    return zone_of(token)


def _encode(**values: Any) -> bytes:
    return SORTED_JSON.encode(values).encode()


def _typed(kind: type, given: object) -> Any:
    if not isinstance(given, kind) or isinstance(given, bool):
        raise TypeError(f"{str(given)[:60]!r} must be of type {kind.__name__}")
    return given


def _lease(given: object) -> float:
    return float(number("lease", given, SHORTEST_LEASE, LONGEST_LEASE))
