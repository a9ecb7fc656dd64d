"""A fleet file that is pushed into a bucket: what is written, what is counted, what is refused."""

import asyncio
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.engine.connection import EngineError, EngineGone
from libmodbus_py.services.workers.contents import PushCounts, connections_of, push, read_bucket
from libmodbus_py.services.workers.records import SETTINGS, FleetSettings
from tests.simulation.engine import Engine, EngineClient, with_engine

LEASE = 10.0
MAP = RegisterMap([Point("level", "holding_registers", 0)])


def device(host: int, name: str = "", **options: Any) -> DeviceConfig:
    return DeviceConfig(name or f"pump {host}", f"tcp://192.0.2.{host}", MAP, **options)


async def pushed(bucket: Any, *devices: DeviceConfig, lease: float = LEASE) -> PushCounts:
    return await push(bucket, FleetSettings(lease), connections_of(devices, lease))


@with_engine
async def test_only_what_differs_is_written_and_counted(engine: Engine, client: EngineClient):
    bucket = engine.bucket(client)
    assert engine.latest is not None
    assert await pushed(bucket) == PushCounts(0, 0, 0)
    assert engine.latest.keys() == {SETTINGS}
    for expected in (PushCounts(3, 0, 0), PushCounts(0, 0, 0)):
        assert await pushed(bucket, *map(device, range(1, 4))) == expected
        assert engine.revision == 4  # the settings, too
    changed = device(2, interval=60)
    assert await pushed(bucket, device(1), changed, device(4), device(5)) == PushCounts(2, 1, 1)
    assert engine.revision == 8
    last = max(engine.latest.values(), key=lambda each: each.revision)
    assert last.value is None  # deletions come last
    assert await pushed(bucket, device(3)) == PushCounts(1, 0, 4)
    assert await pushed(bucket, device(3), lease=20.0) == PushCounts(0, 0, 0)
    assert engine.latest[SETTINGS].revision == engine.revision
    many = [device(host) for host in range(1, 131)]
    assert (await pushed(bucket, *many)).additions == 129
    assert len((await read_bucket(bucket)).all_connections) == 130


@with_engine
async def test_nothing_is_pushed_while_others_push(
    engine: Engine, client: EngineClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    put, leases = engine.put, iter(range(11, 99))

    def overtaken(*arguments: Any) -> None:
        engine.write(SETTINGS, FleetSettings(next(leases)).encode())
        put(*arguments)

    monkeypatch.setattr(engine, "put", overtaken)
    with pytest.raises(EngineError, match="other programs change the bucket"):
        await pushed(engine.bucket(client))
    assert next(leases) == 16  # after five attempts


@with_engine
async def test_a_bucket_that_does_not_arrive_is_given_up_after_ten_seconds(
    engine: Engine, client: EngineClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.write(SETTINGS, FleetSettings(LEASE).encode())
    monkeypatch.setattr(engine, "_feed", lambda consumer: None)
    start = engine.events.now
    with pytest.raises(EngineGone, match="within 10 s"):
        await read_bucket(engine.bucket(client))
    assert engine.events.now - start == pytest.approx(10.0, abs=0.1)
    await asyncio.sleep(1)
    assert engine._consumers == []


def test_devices_of_a_connection_are_in_one_record() -> None:
    first, second = device(1, "a", unit=1, timeout=0.2), device(1, "b", unit=2, timeout=0.7)
    (connection,) = connections_of([first, second], LEASE)
    assert connection.timeout == 0.7
    with pytest.raises(ValueError, match="zone 'north'"):
        connections_of([first, device(1, "b", unit=2, zone="north")], LEASE)


def test_an_answer_may_take_three_tenths_of_a_lease() -> None:
    assert connections_of([device(1, timeout=3.0)], LEASE)[0].timeout == 3.0
    with pytest.raises(ValueError, match=r"engine\.lease of 10 s or more, not 10"):
        connections_of([device(1, timeout=3.01)], LEASE)


@pytest.mark.parametrize("zone", ["a.b", "a b", "*", ">", "a" * 61])
def test_a_zone_that_cannot_be_a_key_is_refused(zone: str) -> None:
    with pytest.raises(ValueError, match="zone"):
        connections_of([device(1, zone=zone)], LEASE)
