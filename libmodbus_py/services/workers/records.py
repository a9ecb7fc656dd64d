"""
The keys and values of the bucket, without sockets or clocks. Each value is a JSON object.

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
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from ...protocol.checks import number
from ...protocol.json_text import SORTED_JSON, json_text
from ...tools.files.schema import one_of
from ..fleet.config import ENGINE, LONGEST_LEASE, SHORTEST_LEASE, OnLoss

# fmt: off
__all__ = [
    "BUCKET", "SETTINGS", "Connection", "FleetSettings", "Holding", "Member", "Record",
    "RecordError", "Slot", "decode", "digest_of", "in_key", "zone_of",
]
# fmt: on

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
            return frozenset(each["name"] for each in json.loads(self.devices)["devices"])
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
    """Return the digest that represents a connection in keys."""
    return hashlib.sha256(connection.encode()).hexdigest()[:32]


def in_key(zone: str) -> str:
    """
    Return the form of a zone in keys.

    Raises:
        ValueError: the zone has other characters than letters, digits, - and _, or over 60.
    """
    if zone and not _TOKEN.fullmatch(zone):
        raise ValueError(f"zone {zone[:80]!r} must be 1..60 letters, digits, - or _")
    return zone or "_"


def zone_of(token: str) -> str:
    """Return the zone with a form in keys."""
    return "" if token == "_" else token


def _encode(**values: Any) -> bytes:
    return SORTED_JSON.encode(values).encode()


def decode(key: str, value: bytes) -> Record:
    """
    Decode a value of the bucket, which any program may have written.

    Raises:
        RecordError: the key is unknown, or its value is invalid.
    """
    try:
        return _decoded(key.split("."), json.loads(value))
    except Exception as error:
        what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise RecordError(f"{key[:200]}: {what[:200] or 'the value cannot be read'}") from None


def _decoded(key: list[str], value: Any) -> Record:
    given = _typed(dict, value)
    match key:
        case ["settings"]:
            if (found := given.pop("format")) != FORMAT:
                raise ValueError(
                    f"format {found!r} is not supported; this version reads format {FORMAT}"
                )
            return FleetSettings(**ENGINE.read((), given))
        case ["connection", zone, digest]:
            connection = _typed(str, given["connection"])
            if digest_of(connection) != digest:
                raise ValueError("connection does not match the digest in the key")
            timeout = float(number("timeout", given["timeout"], 0, LONGEST_LEASE))
            return Connection(_zone(zone), connection, timeout, json_text(given["devices"]))
        case ["slot", zone, index]:
            slot = Slot(_zone(zone), int(index))
            if slot.number not in range(256) or slot.key != ".".join(key):
                raise ValueError("the number of a slot must be 0..255")
            return Holding(slot, _typed(str, given["holder"]), _typed(str, given["by"]))
        case ["worker", name, nonce]:
            zones = [_typed(str, zone) for zone in _typed(list, given["zones"])]
            return Member(
                f"{name}.{nonce}",
                one_of("here", "ended")(("state",), given["state"]),
                tuple(sorted({zone for zone in zones if in_key(zone)})),
                float(number("lease", given["lease"], SHORTEST_LEASE, LONGEST_LEASE)),
                _typed(int, given["beat"]),
                _typed(int, given["seen"]),
                _typed(dict, given.get("report", {})),
            )
    raise ValueError("no such key")


def _zone(token: str) -> str:
    in_key(token)
    return zone_of(token)


def _typed(kind: type, given: object) -> Any:
    if not isinstance(given, kind) or isinstance(given, bool):
        raise TypeError(f"{str(given)[:60]!r} must be of type {kind.__name__}")
    return given
