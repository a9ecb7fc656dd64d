"""
The status of a fleet: its workers, their slots, and the parts that no worker polls.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Iterable
from typing import Any

from ..engine.buckets import Bucket
from ..engine.connection import EngineError
from .pushing import devices_of, seen_now
from .records import BucketView, zone_of

__all__ = ["fleet_status", "is_polled", "tables"]

# The time between the two reads of the bucket, as a fraction of a lease. Each live worker renews
# its lease twice in this time.
LOOK = 0.25

# The numbers in the reports of workers.
NUMBERS = ("connections", "devices", "up", "down", "polls")


async def fleet_status(bucket: Bucket) -> dict[str, Any]:
    """Return the status of a fleet. The bucket is read twice, a quarter of a lease apart."""
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
    states = {}
    for id, member in sorted(view.members.items()):
        key = member.bucket_key
        is_new = before.seen_at(key).revision < view.seen_at(key).revision
        states[id] = member.state if member.state == "ended" or is_new else "silent"
    slots = Counter(view.holders[slot] for slot in view.used_slots if slot in view.holders)
    workers = [
        {
            "id": id,
            "state": state,
            "zones": [zone for zone in view.members[id].zones if zone],
            "slots": slots[id],
            **{name: _number(view.members[id].report.get(name)) for name in NUMBERS},
        }
        for id, state in states.items()
    ]
    unreadable = dict(view.unreadable)
    for connection in view.connections:
        try:
            devices_of(connection)
        except ValueError as error:
            unreadable[connection.bucket_key] = str(error)
    here = {id for id, state in states.items() if state == "here"}
    zones = _zones(view, here, unreadable)
    return {"workers": workers, "zones": zones, "unreadable": sorted(unreadable.values())}


def _zones(view: BucketView, here: set[str], unreadable: Iterable[str]) -> dict[str, Any]:
    """Return numbers by zone, for the ids of workers that poll, and unreadable keys."""
    parts = (key.split(".") for key in unreadable)
    numbers = {
        "connections": Counter(each.zone for each in view.connections),
        "slots": Counter(slot.zone for slot in view.used_slots),
        "served_slots": Counter(
            slot.zone for slot in view.used_slots if view.holders.get(slot) in here
        ),
        "workers": Counter(zone for id in here for zone in view.members[id].zones),
        "unreadable": Counter(zone_of(part[1]) for part in parts if part[0] == "connection"),
    }
    return {
        zone: {name: counted[zone] for name, counted in numbers.items()}
        for zone in sorted({*numbers["slots"], *numbers["unreadable"]})
    }


def _number(value: object) -> float:
    """Return a number of a report, which any program may have written; 0 for anything else."""
    return value if isinstance(value, int | float) and math.isfinite(value) else 0


WORKERS = "{:<28} {:<7} {:>5} {:>11} {:>7} {:>6} {:>6} {:>8}  {}"

ZONES = "{:<28} {:>7} {:>11} {:>5} {:>6}  {}"


def tables(status: dict[str, Any]) -> str:
    """Format a status as tables."""
    heads = ("connections", "devices", "up", "down", "polls/s", "zones")
    lines = [WORKERS.format("worker", "state", "slots", *heads)]
    for each in status["workers"]:
        numbers = [f"{each[name]:g}" for name in NUMBERS]
        cells = each["id"][:28], each["state"], each["slots"], *numbers, ", ".join(each["zones"])
        lines.append(WORKERS.format(*cells).rstrip())
    lines += ["", ZONES.format("zone", "workers", "connections", "slots", "served", "").rstrip()]
    for name, each in status["zones"].items():
        numbers = [each[key] for key in ("workers", "connections", "slots", "served_slots")]
        lines.append(ZONES.format(name[:28] or "(none)", *numbers, _remark(each)).rstrip())
    return "\n".join([*lines, *(f"unreadable: {each}" for each in status["unreadable"])])


def _remark(zone: dict[str, Any]) -> str:
    if zone["served_slots"] < zone["slots"]:
        return "moving" if zone["workers"] else "no worker"
    return f"{zone['unreadable']} unreadable" if zone["unreadable"] else ""
