"""
The simulated engine: whole workers run on it, and it fails in the ways it is told to.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.ports.trace import Traced
from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.engine.connection import EngineError
from libmodbus_py.services.workers.records import FleetSettings

from .engine import Engine
from .network import Network
from .workers import SimulatedWorker, push_fleet

LEVEL = RegisterMap([Point("level", "holding_registers", 0)])
LEASE = 2.0


def devices(count: int) -> list[DeviceConfig]:
    return [
        DeviceConfig(name=f"d{at}", url=f"tcp://10.0.0.{at}", map=LEVEL, interval=1.0, timeout=0.2)
        for at in range(1, count + 1)
    ]


def exchange(seed: int) -> list[tuple[float, str, bytes]]:
    """Let two workers share devices, and kill one; return what they wrote to the stream."""
    network = Network(seed)
    engine = Engine(network)

    async def main() -> None:
        server = Server({1: Device(Mapping(holding_registers=1))})
        async with server.serving(*(each.url for each in devices(8))):
            await push_fleet(engine, devices(8), FleetSettings(LEASE))
            one, other = (SimulatedWorker(network, engine, name) for name in "ab")
            await one.start()
            await other.start()
            await asyncio.sleep(3 * LEASE)
            shares = [len(each.polling.fleet.devices) for each in (one, other)]
            assert sum(shares) == 8
            assert all(shares)
            one.kill()
            await asyncio.sleep(2 * LEASE)
            assert len(other.polling.fleet.devices) == 8
            await other.leave()
            await one.ended()

    network.run(main)
    return list(engine.stream)


def test_workers_share_devices_and_one_takes_over_from_another() -> None:
    subjects = {subject for _, subject, _ in exchange(seed=3)}
    assert subjects == {f"modbus.readings.d{at}" for at in range(1, 9)}


def test_equal_seeds_have_equal_traces() -> None:
    assert exchange(seed=4) == exchange(seed=4)
    assert exchange(seed=4) != exchange(seed=5)


def test_a_write_rests_on_the_revision_of_its_key() -> None:
    network = Network()
    engine = Engine(network)

    async def main() -> None:
        client = engine.client()
        bucket = engine.bucket(client)
        assert await bucket.put("settings", b"1", 0) == 1
        assert await bucket.put("settings", b"2", 0) == 0
        assert await bucket.put("settings", b"2", 1) == 2
        assert await bucket.put("settings", None, 1) == 0
        assert await bucket.put("settings", None, 2) == 1
        await client.close()

    network.run(main)


async def unheard(client: Any) -> None:
    """Let a request fail."""
    with pytest.raises(EngineError):
        await client.engine.bucket(client).put("settings", b"2", 0)


def test_what_waits_at_a_cut_arrives_when_it_is_mended_soon() -> None:
    network = Network()
    engine = Engine(network)

    async def main() -> None:
        client = engine.client()
        engine.cut(client)
        await unheard(client)
        assert engine.revision == 0
        engine.mend(client)
        await asyncio.sleep(0.1)
        assert engine.revision == 1
        assert client.is_connected
        await client.close()

    network.run(main)


@pytest.mark.parametrize("breaks", ["stop", "cut"])
def test_a_lost_connection_is_noticed_and_made_again(breaks: str) -> None:
    network = Network()
    engine = Engine(network)
    changes: list[bool] = []

    async def main() -> None:
        client = engine.client(lambda: changes.append(client.is_connected))
        if breaks == "stop":
            engine.stop()
        else:
            engine.cut(client)
        await asyncio.sleep(7)
        assert changes == [False]
        await unheard(client)
        engine.start()
        engine.mend(client)
        engine.write("slot._.1", b"{}")
        await asyncio.sleep(1)
        assert changes == [False, True]
        assert await engine.bucket(client).put("settings", b"", 0) == 2
        await client.close()

    network.run(main)


def test_whoever_watches_is_told_all_and_knows_of_gaps() -> None:
    network = Network()
    engine = Engine(network)

    async def main() -> None:
        client = engine.client()
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
        await client.close()

    network.run(main)


def test_the_server_goes_back() -> None:
    network = Network()
    engine = Engine(network)

    async def main() -> None:
        client = engine.client()
        bucket = engine.bucket(client)
        await bucket.put("settings", b"1", 0)
        await asyncio.sleep(10)
        await bucket.put("settings", b"2", 1)
        await bucket.put("slot._.1", b"x", 0)
        engine.forget(5)
        assert {key: entry.value for key, entry in (engine.latest or {}).items()} == {
            "settings": b"1"
        }
        assert engine.revision == 1
        await asyncio.sleep(1)
        assert await bucket.put("settings", b"3", 1) == 2
        await client.close()

    network.run(main)


def test_messages_reach_who_subscribed() -> None:
    network = Network()
    engine = Engine(network)

    async def main() -> None:
        client, other = engine.client(), engine.client()

        async def answer(message: Any) -> None:
            await other.publish(message.reply, message.data + b"!")

        await other.subscribe("modbus.write.*.*", cb=answer)
        await asyncio.sleep(0.1)
        answered = await client.request("modbus.write.a.b", b"1", timeout=1)
        assert answered.data == b"1!"
        await client.close()
        await other.close()

    network.run(main)


def test_a_stopped_worker_does_nothing_and_then_goes_on() -> None:
    network = Network(seed=2)
    engine = Engine(network)
    asked: list[float] = []

    def note(traced: Traced) -> None:
        if traced.direction == "received":
            asked.append(network.events.now)

    async def main() -> None:
        server = Server({1: Device(Mapping(holding_registers=1))}, trace=note)
        async with server.serving("tcp://10.0.0.1"):
            await push_fleet(engine, devices(1), FleetSettings(LEASE))
            worker = SimulatedWorker(network, engine, "a")
            await worker.start()
            await asyncio.sleep(7.5)
            worker.process.stop()
            count = len(asked)
            assert count >= 4
            stopped_at = network.events.now
            await asyncio.sleep(60)
            assert len(asked) == count
            worker.process.go_on()
            await asyncio.sleep(2 * LEASE)
            assert len(asked) > count
            # Its lease is over: it asks nobody until it has another one.
            assert asked[count] > stopped_at + 60
            await worker.leave()

    network.run(main)
