"""
The simulated engine: whole workers run on it, and it fails in the ways it is told to.
"""

import asyncio

import pytest

from libmodbus_py import Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.engine.connection import EngineError
from libmodbus_py.services.workers.records import FleetSettings

from .engine import Engine, EngineClient, with_engine
from .network import Network
from .workers import SimulatedWorker, push_fleet

LEVEL = RegisterMap([Point("level", "holding_registers", 0)])
LEASE = 2.0


def exchange(seed: int) -> list[tuple[float, str, bytes]]:
    """Stop a worker for a minute, and kill it; return what it and its heir wrote to the stream."""
    network = Network(seed)
    engine = Engine(network)

    async def main() -> None:
        server = Server({1: Device(Mapping(holding_registers=1))})
        async with server.serving("tcp://10.0.0.1"):
            device = DeviceConfig("d", "tcp://10.0.0.1", LEVEL, interval=1.0, timeout=0.2)
            await push_fleet(engine, [device], FleetSettings(LEASE))
            one, other = (SimulatedWorker(network, engine, name) for name in "ab")
            await one.start()
            await asyncio.sleep(7.5)
            one.process.stop()
            stopped_at, count = network.events.now, len(engine.stream)
            assert count >= 4
            await asyncio.sleep(60)
            assert len(engine.stream) == count
            one.process.go_on()
            await asyncio.sleep(2 * LEASE)
            # Its lease was over: it asked nobody until it had another one.
            assert engine.stream[count][0] > stopped_at + 60
            await other.start()
            one.kill()
            count = len(engine.stream)
            await asyncio.sleep(3 * LEASE)
            assert len(engine.stream) > count
            await other.leave()
            await one.ended()

    network.run(main)
    return list(engine.stream)


def test_workers_are_stopped_and_killed_and_equal_seeds_have_equal_traces() -> None:
    assert exchange(seed=4) == exchange(seed=4) != exchange(seed=5)


async def unheard(client: EngineClient) -> None:
    """Let a request fail."""
    with pytest.raises(EngineError):
        await client.engine.bucket(client).put("settings", b"2", 0)


@with_engine
async def test_what_waits_at_a_cut_arrives_when_it_is_mended_soon(
    engine: Engine, client: EngineClient
) -> None:
    client.link.cut()
    await unheard(client)
    assert engine.revision == 0
    client.link.mend()
    await asyncio.sleep(0.1)
    assert engine.revision == 1
    assert client.is_connected


@pytest.mark.parametrize("breaks", ["stop", "cut"])
@with_engine
async def test_a_lost_connection_is_noticed_and_made_again(
    engine: Engine, client: EngineClient, breaks: str
) -> None:
    changes: list[bool] = []
    client.on_change = lambda: changes.append(client.is_connected)
    if breaks == "stop":
        engine.stop()
    else:
        client.link.cut()
    await asyncio.sleep(7)
    assert changes == [False]
    await unheard(client)
    engine.start()
    client.link.mend()
    engine.write("slot._.1", b"{}")
    await asyncio.sleep(1)
    assert changes == [False, True]
    assert await engine.bucket(client).put("settings", b"", 0) == 2


@with_engine
async def test_whoever_watches_is_told_all_and_knows_of_gaps(
    engine: Engine, client: EngineClient
) -> None:
    for at in range(5):
        engine.write(f"slot._.{at}", b"{}")
    engine.write("slot._.0", None)
    told: list[Change | None] = []
    watch = await engine.bucket(client).watch(told.append)
    await asyncio.sleep(0.1)
    assert [each and each.revision for each in told] == [2, 3, 4, 5, 6, None]
    engine.losses = 1.0
    engine.write("settings", b"1")
    engine.losses = 0.0
    await asyncio.sleep(0.1)
    assert not watch.is_broken  # nobody can know yet
    engine.write("settings", b"2")
    await asyncio.sleep(0.1)
    assert watch.is_broken


@with_engine
async def test_the_server_goes_back_and_a_write_rests_on_the_revision_of_its_key(
    engine: Engine, client: EngineClient
) -> None:
    bucket = engine.bucket(client)
    assert await bucket.put("settings", b"1", 0) == 1
    await asyncio.sleep(10)
    assert await bucket.put("settings", b"2", 0) == 0
    assert await bucket.put("settings", b"2", 1) == 2
    await bucket.put("slot._.1", b"x", 0)
    engine.forget(5)
    assert engine.latest is not None
    assert {key: entry.value for key, entry in engine.latest.items()} == {"settings": b"1"}
    assert engine.revision == 1
    await asyncio.sleep(1)
    assert await bucket.put("settings", None, 0) == 0
    assert await bucket.put("settings", None, 1) == 1
