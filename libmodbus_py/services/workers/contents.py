"""
The contents of the bucket as a whole: a push writes the devices of a fleet file that differ; the
status shows the workers, their slots, and the parts of the fleet that no worker polls.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from ...client.options import checked_options
from ..engine.buckets import Bucket
from ..engine.connection import EngineError, EngineGone
from ..fleet.config import (
    DeviceConfig,
    by_connection,
    checked_devices,
    devices_from_json,
    devices_to_json,
)
from .records import SETTINGS, BucketView, Connection, FleetSettings, in_key, zone_of
from .worker import Put

if TYPE_CHECKING:
    from ..engine.buckets import Change

MOST_TRIES = 5  # the most attempts while other programs change the bucket at the same time
AT_ONCE = 64  # the most writes that are sent at once
TIMEOUT_S = 10.0  # seconds within which the whole bucket must arrive
LONGEST_ANSWER = 0.3  # the largest timeout of a device, as a fraction of a lease

# The time between the two reads of the bucket for a status, as a fraction of a lease. Each live
# worker renews its lease twice in this time.
LOOK = 0.25

# The numbers in the reports of workers.
NUMBERS = ("connections", "devices", "up", "down", "polls")


class PushCounts(NamedTuple):
    """The numbers of connections that were added, changed and deleted."""

    additions: int
    changes: int
    deletions: int


def connections_of(devices: Iterable[DeviceConfig], lease: float) -> list[Connection]:
    """Return the connections of devices, as the bucket holds them; ValueError if that is wrong."""
    connections = []
    for key, group in by_connection(devices).items():
        first = group[0]
        in_key(first.zone)
        for device in group:
            if device.zone != first.zone:
                raise ValueError(
                    f"device {device.name!r} is in zone {device.zone!r}, but {first.name!r}, which"
                    f" uses the same connection {key}, is in zone {first.zone!r}"
                )
        usual = checked_options(first.endpoint, {})["timeout"]
        timeout = max(usual if member.timeout is None else member.timeout for member in group)
        if timeout > lease * LONGEST_ANSWER:
            raise ValueError(
                f"device {first.name!r}: a timeout of {timeout:g} s needs an engine.lease of"
                f" {timeout / LONGEST_ANSWER:.3g} s or more, not {lease:g}"
            )
        connections.append(Connection(first.zone, key, timeout, devices_to_json(group)))
    return connections


def devices_of(connection: Connection) -> list[DeviceConfig]:
    """Return the devices of a connection; ValueError if another program has written wrong ones."""
    try:
        devices = devices_from_json(connection.devices)
        if any(device.connection_key != connection.key for device in devices):
            raise ValueError("a device belongs to another connection")
        return checked_devices(devices)
    except Exception as error:
        text = f"{connection.key}: its devices in the bucket are invalid: {error}"
        raise ValueError(text) from None


def changes(
    view: BucketView, settings: FleetSettings, connections: Iterable[Connection]
) -> Iterator[Put]:
    """Yield the writes that make the bucket match: first additions and changes, then deletions."""
    if view.settings != settings:
        yield Put(SETTINGS, settings.encode(), view.last_change(SETTINGS).revision)
    # Compared as encoded: the order of keys has no meaning.
    target = {connection.bucket_key: connection.encode() for connection in connections}
    values = {connection.bucket_key: connection.encode() for connection in view.all_connections}
    for key, value in target.items():
        if values.get(key) != value:
            yield Put(key, value, view.last_change(key).revision)
    for key in values.keys() - target.keys():
        yield Put(key, None, view.last_change(key).revision)


async def push(
    bucket: Bucket, settings: FleetSettings, connections: list[Connection]
) -> PushCounts:
    """Make the bucket match a fleet file, unless other programs change it at the same time."""
    additions = updates = deletions = 0
    for _ in range(MOST_TRIES):
        view = await read_bucket(bucket)
        puts = list(changes(view, settings, connections))
        if not puts:
            return PushCounts(additions, updates, deletions)
        # Revisions do not show which keys are new: deleted keys have revisions, too.
        keys = {SETTINGS, *(connection.bucket_key for connection in view.all_connections)}
        writes = [put for put in puts if put.value is not None]
        removals = [put for put in puts if put.value is None]
        additions += sum(put.key not in keys for put in writes)
        updates += sum(put.key in keys and put.key != SETTINGS for put in writes)
        deletions += len(removals)
        for several in (writes, removals):
            for at in range(0, len(several), AT_ONCE):
                await asyncio.gather(*(bucket.put(*put) for put in several[at : at + AT_ONCE]))
    raise EngineError(f"{bucket.name}: other programs change the bucket at the same time")


async def read_bucket(bucket: Bucket) -> BucketView:
    """Return the current contents of a bucket; they must arrive within 10 s."""
    view = BucketView()
    is_whole = asyncio.Event()

    def receive(change: Change | None) -> None:
        if change is None:
            is_whole.set()
        else:
            view.add(change, 0.0)

    watch = await bucket.watch(receive)
    try:
        async with asyncio.timeout(TIMEOUT_S):
            await is_whole.wait()
    except TimeoutError:
        raise EngineGone(
            f"{bucket.name}: the contents of the bucket did not arrive within {TIMEOUT_S:g} s"
        ) from None
    finally:
        await watch.end()
    return view


async def read_fleet(bucket: Bucket) -> tuple[BucketView, FleetSettings]:
    """Return what `read_bucket` does, and the settings; raise EngineError if there is no fleet."""
    view = await read_bucket(bucket)
    if view.settings is None:
        why = view.unreadable.get(SETTINGS, "there is no fleet yet; put it there with --push")
        raise EngineError(f"{bucket.name}: {why}")
    return view, view.settings


# --- the status ---------------------------------------------------------------------------------


async def fleet_status(bucket: Bucket) -> dict[str, Any]:
    """Return the status of a fleet. The bucket is read twice, a quarter of a lease apart."""
    before, settings = await read_fleet(bucket)
    await asyncio.sleep(settings.lease * LOOK)
    return _document(before, await read_bucket(bucket))


def is_polled(status: dict[str, Any]) -> bool:
    zones = status["zones"].values()
    return all(zone["served_slots"] == zone["slots"] and not zone["unreadable"] for zone in zones)


def _document(before: BucketView, view: BucketView) -> dict[str, Any]:
    slots = Counter(view.holders[slot] for slot in view.used_slots if slot in view.holders)
    workers: list[dict[str, Any]] = []
    for id, member in sorted(view.members.items()):
        key = member.bucket_key
        is_new = before.last_change(key).revision < view.last_change(key).revision
        numbers = {name: _number(member.report.get(name)) for name in NUMBERS}
        state = member.state if member.state == "ended" or is_new else "silent"
        zones = [zone for zone in member.zones if zone]
        workers.append({"id": id, "state": state, "zones": zones, "slots": slots[id], **numbers})
    unreadable = dict(view.unreadable)
    for connection in view.connections:
        try:
            devices_of(connection)
        except ValueError as error:
            unreadable[connection.bucket_key] = str(error)
    here = {worker["id"] for worker in workers if worker["state"] == "here"}
    return {
        "workers": workers,
        "zones": _zones(view, here, unreadable),
        "unreadable": sorted(unreadable.values()),
    }


def _zones(view: BucketView, here: set[str], unreadable: Iterable[str]) -> dict[str, Any]:
    """Return numbers by zone, for the ids of workers that poll, and unreadable keys."""
    parts = (key.split(".") for key in unreadable)
    numbers = {
        "connections": Counter(connection.zone for connection in view.connections),
        "slots": Counter(slot.zone for slot in view.used_slots),
        "served_slots": Counter(
            slot.zone for slot in view.used_slots if view.holders.get(slot) in here
        ),
        "workers": Counter(zone for id in here for zone in view.members[id].zones),
        "unreadable": Counter(zone_of(part[1]) for part in parts if part[0] == "connection"),
    }
    return {
        zone: {name: counts[zone] for name, counts in numbers.items()}
        for zone in sorted({*numbers["slots"], *numbers["unreadable"]})
    }


def _number(value: object) -> float:
    """Return a number of a report, which any program may have written; 0 for anything else."""
    return value if isinstance(value, int | float) and math.isfinite(value) else 0


WORKERS = "{:<28} {:<7} {:>5} {:>11} {:>7} {:>6} {:>6} {:>8}  {}"

ZONES = "{:<28} {:>7} {:>11} {:>5} {:>6}  {}"


def tables(status: dict[str, Any]) -> str:
    heads = ("connections", "devices", "up", "down", "polls/s", "zones")
    lines = [WORKERS.format("worker", "state", "slots", *heads)]
    for row in status["workers"]:
        numbers = [f"{row[name]:g}" for name in NUMBERS]
        cells = row["id"][:28], row["state"], row["slots"], *numbers, ", ".join(row["zones"])
        lines.append(WORKERS.format(*cells).rstrip())
    lines += ["", ZONES.format("zone", "workers", "connections", "slots", "served", "").rstrip()]
    for name, row in status["zones"].items():
        numbers = [row[key] for key in ("workers", "connections", "slots", "served_slots")]
        lines.append(ZONES.format(name[:28] or "(none)", *numbers, _remark(row)).rstrip())
    return "\n".join([*lines, *(f"unreadable: {row}" for row in status["unreadable"])])


def _remark(zone: dict[str, Any]) -> str:
    if zone["served_slots"] < zone["slots"]:
        return "moving" if zone["workers"] else "no worker"
    return f"{zone['unreadable']} unreadable" if zone["unreadable"] else ""
