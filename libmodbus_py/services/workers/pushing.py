"""
A fleet file into the bucket: only what is other than what stands there.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from ...client.options import CheckedOptions
from ...protocol.checks import integer, seconds
from ..engine.buckets import Bucket
from ..engine.troubles import EngineError, EngineGone
from ..fleet.config import DeviceConfig, by_connection, devices_to_json
from .records import LONGEST_LEASE, SETTINGS, SHORTEST_LEASE, Connection, OnLoss, Settings, in_key
from .view import Entry, View
from .worker import Put

if TYPE_CHECKING:
    from ..engine.buckets import Change

__all__ = ["Pushed", "changes", "connections_of", "push", "seen_now", "settings_of"]

# As often others may push at the same time.
MOST_TRIES = 5

AT_ONCE = 64

# Seconds for the whole of a bucket.
PATIENCE = 10.0

# Of a lease: how long an answer may be waited for.
LONGEST_ANSWER = 0.3

KEYS = ("lease", "on_engine_loss", "commands", "max_age", "max_bytes")


class Pushed(NamedTuple):
    """How many connections are new, other than before, and gone."""

    new: int
    changed: int
    gone: int


def settings_of(given: Mapping[str, Any]) -> Settings:
    """
    Read the table ``[engine]`` of a fleet file.

    Raises:
        TypeError, ValueError: the message begins with its key.
    """
    for key in given:
        if key not in KEYS:
            raise ValueError(f"engine.{key}: no such key; allowed are {', '.join(KEYS)}")
    usual = Settings()
    lease = seconds("engine.lease", given.get("lease", usual.lease))
    if not SHORTEST_LEASE <= lease <= LONGEST_LEASE:
        wanted = f"{SHORTEST_LEASE}..{LONGEST_LEASE}"
        raise ValueError(f"engine.lease must be in {wanted} s, not {lease}")
    on_loss = given.get("on_engine_loss", usual.on_engine_loss)
    if on_loss not in get_args(OnLoss):
        allowed = " or ".join(get_args(OnLoss))
        raise ValueError(f"engine.on_engine_loss must be {allowed}, not {on_loss!r}")
    commands = given.get("commands", usual.commands)
    if not isinstance(commands, bool):
        raise TypeError(f"engine.commands must be true or false, not {commands!r}")
    results: dict[str, Any] = {}
    if "max_age" in given:
        results["max_age"] = seconds("engine.max_age", given["max_age"], high=3.2e8)
    if "max_bytes" in given:
        results["max_bytes"] = integer("engine.max_bytes", given["max_bytes"], 1 << 16, 1 << 50)
    return Settings(lease, on_loss, commands, results)


def connections_of(devices: Iterable[DeviceConfig], lease: float) -> list[Connection]:
    """
    What stands in the bucket for devices.

    Raises:
        ValueError: devices of one connection are in two zones; an answer may take too much
            of the lease.
    """
    return [_connection(key, group, lease) for key, group in by_connection(devices).items()]


def _connection(key: str, devices: list[DeviceConfig], lease: float) -> Connection:
    first = devices[0]
    in_key(first.zone)
    for device in devices:
        if device.zone != first.zone:
            raise ValueError(
                f"device {device.name!r}: zone {device.zone!r}, but {first.name!r} shares its"
                f" connection {key}, and is in {first.zone!r}"
            )
    usual = CheckedOptions.of(first.endpoint, {}).timeout
    timeout = max(usual if each.timeout is None else each.timeout for each in devices)
    if timeout > lease * LONGEST_ANSWER:
        raise ValueError(
            f"device {first.name!r}: a timeout of {timeout:g} s wants engine.lease of"
            f" {timeout / LONGEST_ANSWER:.3g} s or more, not {lease:g}"
        )
    return Connection(first.zone, key, timeout, devices_to_json(devices))


def changes(view: View, settings: Settings, connections: Iterable[Connection]) -> Iterator[Put]:
    """What to write: what is new or other first, then what is gone."""
    if view.settings != settings:
        yield Put(SETTINGS, settings.encode(), view.seen_at(SETTINGS).revision)
    # Compared as they are written: the order of keys means nothing.
    wanted = {each.bucket_key: each.encode() for each in connections}
    known = {each.bucket_key: each.encode() for each in view.all_connections}
    for key, value in wanted.items():
        if known.get(key) != value:
            yield Put(key, value, view.seen_at(key).revision)
    for key in known.keys() - wanted.keys():
        yield Put(key, None, view.seen_at(key).revision)


async def push(bucket: Bucket, settings: Settings, connections: list[Connection]) -> Pushed:
    """
    Have the bucket say what a fleet file says.

    Raises:
        EngineError: it cannot be written, or others write it all the time.
    """
    biggest = max((len(each.encode()) for each in connections), default=0)
    if biggest > bucket.client.max_payload - 1024:
        raise EngineError(
            f"the devices of a connection take {biggest} bytes; nats-server has a max_payload"
            f" of {bucket.client.max_payload}"
        )
    total = Pushed(0, 0, 0)
    for _ in range(MOST_TRIES):
        view = await seen_now(bucket)
        puts = list(changes(view, settings, connections))
        if not puts:
            return total
        # The revision of a key does not say it: what was deleted before has one, too.
        known = {each.bucket_key for each in view.all_connections}
        told = [put for put in puts if put.key != SETTINGS]
        total = Pushed(
            total.new + sum(put.key not in known for put in told),
            total.changed + sum(put.key in known and put.value is not None for put in told),
            total.gone + sum(put.value is None for put in told),
        )
        await _written(bucket, [put for put in puts if put.value is not None])
        await _written(bucket, [put for put in puts if put.value is None])
    raise EngineError(f"{bucket.name}: others change it all the time")


async def _written(bucket: Bucket, puts: list[Put]) -> None:
    for at in range(0, len(puts), AT_ONCE):
        await asyncio.gather(
            *(bucket.put(put.key, put.value, put.last) for put in puts[at : at + AT_ONCE])
        )


async def seen_now(bucket: Bucket) -> View:
    """
    Read all of a bucket.

    Raises:
        EngineError
    """
    view = View()
    is_whole = asyncio.Event()

    def note(change: Change | None) -> None:
        if change is None:
            is_whole.set()
        else:
            view.add(Entry(*change), 0.0)

    watch = await bucket.watch(note)
    try:
        async with asyncio.timeout(PATIENCE):
            await is_whole.wait()
    except TimeoutError:
        raise EngineGone(f"{bucket.name}: it was not told whole in {PATIENCE:g} s") from None
    finally:
        await watch.end()
    return view
