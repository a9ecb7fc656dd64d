"""
The status of a fleet: its workers, their slots, and the parts that no worker polls.
"""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from typing import Any

from ..engine.buckets import Bucket
from ..engine.errors import EngineError
from .pushing import devices_of, seen_now
from .records import Member, zone_of
from .view import BucketView

__all__ = ["fleet_status", "is_polled", "tables"]

# The time between the two reads of the bucket, as a fraction of a lease. Each live worker renews
# its lease twice in this time.
LOOK = 0.25

# The numbers in the reports of workers that are added up.
SUMS = ("connections", "devices", "up", "down", "polls")


async def fleet_status(bucket: Bucket) -> dict[str, Any]:
    """
    Return the status of a fleet. The bucket is read twice, a quarter of a lease apart.

    Raises:
        EngineError: the bucket cannot be read, or contains no fleet in the format of this version.
    """
    before = await seen_now(bucket)
    if before.settings is None:
        why = before.unreadable.get("settings", "there is no fleet yet; put it there with --push")
        raise EngineError(f"{bucket.name}: {why}")
    await asyncio.sleep(before.settings.lease * LOOK)
    return _document(before, await seen_now(bucket))


def is_polled(status: dict[str, Any]) -> bool:
    """Return True if a worker polls each part of the fleet."""
    zones = status["zones"].values()
    return all(each["served_slots"] == each["slots"] and not each["unreadable"] for each in zones)


def _document(before: BucketView, view: BucketView) -> dict[str, Any]:
    slots = Counter(view.holders[slot] for slot in view.used_slots if slot in view.holders)
    workers = [
        _worker(member, _state(member, before, view), slots[member.id])
        for member in sorted(view.members.values(), key=lambda each: each.id)
    ]
    here = [each for each in workers if each["state"] == "here"]
    invalid = dict(_invalid(view))
    reports = [each["report"] for each in here]
    return {
        "lease": view.settings.lease if view.settings else None,
        "on_engine_loss": view.settings.on_engine_loss if view.settings else None,
        "totals": {key: round(sum(_number(each, key) for each in reports), 1) for key in SUMS},
        "workers": workers,
        "zones": _zones(view, {each["id"] for each in here}, invalid),
        "unreadable": sorted([*view.unreadable.values(), *invalid.values()]),
    }


def _state(member: Member, before: BucketView, view: BucketView) -> str:
    """Return "ended"; else "here" if the lease was renewed between the reads, or "silent"."""
    known = before.seen.get(member.bucket_key)
    is_new = known is None or known.revision < view.seen[member.bucket_key].revision
    return member.state if member.state == "ended" or is_new else "silent"


def _worker(member: Member, state: str, slots: int) -> dict[str, Any]:
    return {
        "id": member.id,
        "name": member.name,
        "state": state,
        "zones": [zone for zone in member.zones if zone],
        "slots": slots,
        "report": dict(member.report),
    }


def _invalid(view: BucketView) -> Iterator[tuple[str, str]]:
    """Yield the keys of connections whose devices no worker can read, and the reasons."""
    for connection in view.connections:
        try:
            devices_of(connection)
        except ValueError as error:
            yield connection.bucket_key, str(error)


def _zones(view: BucketView, here: set[str], invalid: Iterable[str]) -> dict[str, Any]:
    """
    Return numbers by zone; the zone of devices without a zone is "".

    Args:
        here: the ids of the workers that poll.
        invalid: the keys of connections whose devices no worker can read.
    """
    unreadable = Counter[str]()
    for key in (*view.unreadable, *invalid):
        kind, _, rest = key.partition(".")
        if kind == "connection":
            unreadable[zone_of(rest.partition(".")[0])] += 1
    connections = Counter(each.zone for each in view.connections)
    used, served = Counter[str](), Counter[str]()
    for slot in view.used_slots:
        used[slot.zone] += 1
        served[slot.zone] += view.holders.get(slot) in here
    workers: defaultdict[str, int] = defaultdict(int)
    for member in view.members.values():
        for zone in member.zones:
            workers[zone] += member.id in here
    return {
        zone: {
            "connections": connections[zone],
            "slots": used[zone],
            "served_slots": served[zone],
            "workers": workers[zone],
            "unreadable": unreadable[zone],
        }
        for zone in sorted({*used, *unreadable})
    }


def _number(report: dict[str, Any], key: str) -> float:
    value = report.get(key, 0)
    return value if isinstance(value, int | float) and value == value else 0


WORKERS = "{:<28} {:<7} {:>5} {:>11} {:>7} {:>6} {:>6} {:>8}  {}"

ZONES = "{:<28} {:>7} {:>11} {:>5} {:>6}  {}"


def tables(status: dict[str, Any]) -> str:
    """Format a status as tables."""
    lines = [
        WORKERS.format(
            "worker", "state", "slots", "connections", "devices", "up", "down", "polls/s", "zones"
        )
    ]
    for each in status["workers"]:
        numbers = [f"{_number(each['report'], key):g}" for key in SUMS]
        zones = ", ".join(each["zones"])
        lines.append(
            WORKERS.format(each["id"][:28], each["state"], each["slots"], *numbers, zones).rstrip()
        )
    lines += ["", ZONES.format("zone", "workers", "connections", "slots", "served", "").rstrip()]
    for name, each in status["zones"].items():
        numbers = [each[key] for key in ("workers", "connections", "slots", "served_slots")]
        lines.append(ZONES.format(name[:28] or "(none)", *numbers, _remark(each)).rstrip())
    return "\n".join([*lines, *(f"unreadable: {each}" for each in status["unreadable"])])


def _remark(zone: dict[str, Any]) -> str:
    if zone["served_slots"] < zone["slots"]:
        return "moving" if zone["workers"] else "no worker"
    return f"{zone['unreadable']} unreadable" if zone["unreadable"] else ""
