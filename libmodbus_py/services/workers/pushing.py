"""
Devices as records of the bucket, and back; a push writes those of a fleet file that differ.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ...client.options import CheckedOptions
from ..engine.buckets import Bucket
from ..engine.connection import EngineError, EngineGone
from ..fleet.config import (
    DeviceConfig,
    by_connection,
    checked,
    devices_from_json,
    devices_to_json,
)
from .records import SETTINGS, BucketView, Connection, FleetSettings, in_key
from .worker import Put

if TYPE_CHECKING:
    from ..engine.buckets import Change

__all__ = ["Pushed", "changes", "connections_of", "devices_of", "push", "seen_now"]

# The most attempts while other programs change the bucket at the same time.
MOST_TRIES = 5

# The most writes that are sent at once.
AT_ONCE = 64

# Seconds within which the whole bucket must arrive.
TIMEOUT_S = 10.0

# The largest timeout of a device, as a fraction of a lease.
LONGEST_ANSWER = 0.3


class Pushed(NamedTuple):
    """The numbers of connections that were added, changed and deleted."""

    new: int
    changed: int
    gone: int


def connections_of(devices: Iterable[DeviceConfig], lease: float) -> list[Connection]:
    """Return the connections of devices, as the bucket holds them; ValueError if that is wrong."""
    found = []
    for key, group in by_connection(devices).items():
        first = group[0]
        in_key(first.zone)
        for device in group:
            if device.zone != first.zone:
                raise ValueError(
                    f"device {device.name!r} is in zone {device.zone!r}, but {first.name!r}, which"
                    f" uses the same connection {key}, is in zone {first.zone!r}"
                )
        usual = CheckedOptions.of(first.endpoint, {}).timeout
        timeout = max(usual if each.timeout is None else each.timeout for each in group)
        if timeout > lease * LONGEST_ANSWER:
            raise ValueError(
                f"device {first.name!r}: a timeout of {timeout:g} s needs an engine.lease of"
                f" {timeout / LONGEST_ANSWER:.3g} s or more, not {lease:g}"
            )
        found.append(Connection(first.zone, key, timeout, devices_to_json(group)))
    return found


def devices_of(connection: Connection) -> list[DeviceConfig]:
    """Return the devices of a connection; ValueError if another program has written wrong ones."""
    try:
        devices = devices_from_json(connection.devices)
        if any(each.connection_key != connection.key for each in devices):
            raise ValueError("a device belongs to another connection")
        return checked(devices)
    except Exception as error:
        text = f"{connection.key}: its devices in the bucket are invalid: {error}"
        raise ValueError(text) from None


def changes(
    view: BucketView, settings: FleetSettings, connections: Iterable[Connection]
) -> Iterator[Put]:
    """Yield the writes that make the bucket match: first additions and changes, then deletions."""
    if view.settings != settings:
        yield Put(SETTINGS, settings.encode(), view.seen_at(SETTINGS).revision)
    # Compared as encoded: the order of keys has no meaning.
    wanted = {each.bucket_key: each.encode() for each in connections}
    known = {each.bucket_key: each.encode() for each in view.all_connections}
    for key, value in wanted.items():
        if known.get(key) != value:
            yield Put(key, value, view.seen_at(key).revision)
    for key in known.keys() - wanted.keys():
        yield Put(key, None, view.seen_at(key).revision)


async def push(bucket: Bucket, settings: FleetSettings, connections: list[Connection]) -> Pushed:
    """Make the bucket match a fleet file, unless other programs change it at the same time."""
    new = changed = gone = 0
    for _ in range(MOST_TRIES):
        view = await seen_now(bucket)
        puts = list(changes(view, settings, connections))
        if not puts:
            return Pushed(new, changed, gone)
        # Revisions do not show which keys are new: deleted keys have revisions, too.
        known = {SETTINGS, *(each.bucket_key for each in view.all_connections)}
        deleted = [put for put in puts if put.value is None]
        written = [put for put in puts if put.value is not None]
        gone += len(deleted)
        new += sum(put.key not in known for put in written)
        changed += sum(put.key in known and put.key != SETTINGS for put in written)
        for several in (written, deleted):
            for at in range(0, len(several), AT_ONCE):
                await asyncio.gather(*(bucket.put(*put) for put in several[at : at + AT_ONCE]))
    raise EngineError(f"{bucket.name}: other programs change the bucket at the same time")


async def seen_now(bucket: Bucket) -> BucketView:
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
