"""
What stands in the bucket: keys and values, in and out. No socket, no clock.

::

    settings                        of the whole fleet: lease, what to do when the engine is gone
    connection.ZONE.DIGEST          a connection and its devices, as `push` wrote them
    slot.ZONE.NUMBER                who has the connections whose digests begin with that number
    worker.NAME.NONCE               the lease of a worker, and what it says of itself
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

__all__ = [
    "SETTINGS",
    "Connection",
    "FleetSettings",
    "Holding",
    "Member",
    "RecordError",
    "Slot",
    "State",
    "decode",
    "digest_of",
    "encode_holder",
    "in_key",
    "slot_of",
]

FORMAT = 1
"""Of all of it; a bucket of another one is refused."""

SETTINGS = "settings"

State = Literal["here", "ended"]

OnLoss = Literal["stop", "continue"]

# NATS takes 1 MiB unless told otherwise.
MAX_VALUE = 1 << 20

_TOKEN = re.compile(r"[A-Za-z0-9_-]{1,60}")
_DIGEST = re.compile(r"[0-9a-f]{32}")

SHORTEST_LEASE, LONGEST_LEASE = 0.5, 60.0


class RecordError(ValueError):
    """A value that no worker wrote, or one of another version; it begins with the key."""


class Slot(NamedTuple):
    """A part of the connections of a zone: those whose digest begins with one byte."""

    zone: str
    number: int

    @property
    def key(self) -> str:
        return f"slot.{in_key(self.zone)}.{self.number}"


@dataclass(frozen=True)
class FleetSettings:
    """
    What all workers must agree on.

    Attributes:
        lease: seconds; 0.5..60.
        on_engine_loss: whether polling goes on without a lease.
        commands: whether devices may be written to over the engine.
        results: the limits of the stream of results, by name.
    """

    lease: float = 10.0
    on_engine_loss: OnLoss = "stop"
    commands: bool = False
    results: Mapping[str, Any] = field(default_factory=dict)

    def encode(self) -> bytes:
        return _encode(
            format=FORMAT,
            lease=self.lease,
            on_engine_loss=self.on_engine_loss,
            commands=self.commands,
            results=dict(self.results),
        )


@dataclass(frozen=True)
class Connection:
    """
    A connection and its devices.

    Attributes:
        key: as `DeviceConfig.connection_key` has it.
        timeout: seconds; the longest that an answer is waited for there.
        devices: JSON, as `devices_to_json` wrote it.
    """

    zone: str
    key: str
    timeout: float
    devices: str

    @property
    def bucket_key(self) -> str:
        return f"connection.{in_key(self.zone)}.{digest_of(self.key)}"

    @property
    def slot(self) -> Slot:
        return slot_of(self.zone, digest_of(self.key))

    def encode(self) -> bytes:
        return _encode(connection=self.key, timeout=self.timeout, devices=json.loads(self.devices))


@dataclass(frozen=True)
class Member:
    """
    A worker, as it wrote of itself; its lease begins anew with each such value.

    Attributes:
        id: its name, and what tells it from others of that name: its key after `worker.`.
        zones: whose devices it takes.
        lease: seconds that this value is good for.
        beat: counts up.
        seen: all that stands in the bucket up to this revision is heeded.
        report: what it says of its devices, for people.
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

    @property
    def name(self) -> str:
        return self.id.partition(".")[0]

    def is_as(self, other: Member) -> bool:
        """Return True if others have to treat this worker as before."""
        return (self.state, self.zones, self.lease) == (other.state, other.zones, other.lease)

    def encode(self) -> bytes:
        return _encode(
            state=self.state,
            zones=self.zones,
            lease=self.lease,
            beat=self.beat,
            seen=self.seen,
            report=dict(self.report),
        )


def digest_of(connection: str) -> str:
    """What stands for a connection in keys, which take few characters."""
    return hashlib.sha256(connection.encode()).hexdigest()[:32]


def slot_of(zone: str, digest: str) -> Slot:
    return Slot(zone, int(digest[:2], 16))


class Holding(NamedTuple):
    """Who has a slot, and who said so."""

    slot: Slot
    holder: str
    by: str


def encode_holder(worker: str, by: str) -> bytes:
    """The value of a slot that a worker has, as another or itself writes it."""
    return _encode(holder=worker, by=by)


def in_key(zone: str) -> str:
    """
    A zone as keys have it; that of devices without one is "_".

    Raises:
        ValueError: it has other characters than letters, digits, - and _, or more than 60.
    """
    if zone and not _TOKEN.fullmatch(zone):
        raise ValueError(f"zone {zone[:80]!r} must be 1..60 letters, digits, - or _")
    return zone or "_"


Record = FleetSettings | Connection | Member | Holding


def decode(key: str, value: bytes) -> Record:
    """
    Read what stands in the bucket.

    Raises:
        RecordError: no worker and no `push` of this version wrote it.
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
            raise ValueError("no object")
        return reader(rest, given)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise RecordError(f"{key[:200]}: {what[:200] or 'not to be read'}") from None


def _settings(_rest: list[str], given: dict[str, Any]) -> FleetSettings:
    if given["format"] != FORMAT:
        raise ValueError(f"format {given['format']!r}; this version knows {FORMAT}")
    return FleetSettings(
        _lease(given["lease"]),
        _one_of(get_args(OnLoss), given["on_engine_loss"]),
        given["commands"] is True,
        _typed(dict, given.get("results", {})),
    )


def _connection(rest: list[str], given: dict[str, Any]) -> Connection:
    zone, digest = rest
    key = _typed(str, given["connection"])
    if not _DIGEST.fullmatch(digest) or digest_of(key) != digest:
        raise ValueError("connection is not the one of this key")
    timeout = _number(given["timeout"], 0, LONGEST_LEASE)
    return Connection(_zone(zone), key, timeout, json.dumps(given["devices"]))


def _slot(rest: list[str], given: dict[str, Any]) -> Holding:
    zone, number = rest
    slot = Slot(_zone(zone), int(number))
    if slot.number not in range(256) or slot.key != f"slot.{zone}.{number}":
        raise ValueError("slots are 0..255")
    return Holding(slot, _typed(str, given["holder"]), _typed(str, given["by"]))


def _member(rest: list[str], given: dict[str, Any]) -> Member:
    zones = [_typed(str, zone) for zone in _typed(list, given["zones"])]
    return Member(
        ".".join(rest),
        _one_of(get_args(State), given["state"]),
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


def _encode(**values: Any) -> bytes:
    return json.dumps(values, separators=(",", ":"), sort_keys=True).encode()


def _zone(token: str) -> str:
    in_key(token)
    return "" if token == "_" else token


def _typed(kind: type, given: object) -> Any:
    if not isinstance(given, kind) or isinstance(given, bool):
        raise TypeError(f"{str(given)[:60]!r} is no {kind.__name__}")
    return given


def _number(given: object, least: float, most: float) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise TypeError(f"{str(given)[:60]!r} is no number")
    if not least <= given <= most:
        raise ValueError(f"{given} is not in {least}..{most}")
    return float(given)


def _lease(given: object) -> float:
    return _number(given, SHORTEST_LEASE, LONGEST_LEASE)


def _one_of(allowed: tuple[Any, ...], given: object) -> Any:
    if given not in allowed:
        raise ValueError(f"{str(given)[:60]!r} is none of {', '.join(allowed)}")
    return given
