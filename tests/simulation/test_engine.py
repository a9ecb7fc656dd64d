"""The simulated engine: whole workers run on it, and it fails in the ways it is told to."""

import asyncio

from libmodbus_py import Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.workers.records import FleetSettings

from .engine import Engine
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


def test_simulated_workers_stop_and_die_and_equal_seeds_have_equal_traces() -> None:
    assert exchange(seed=4) == exchange(seed=4) != exchange(seed=5)
