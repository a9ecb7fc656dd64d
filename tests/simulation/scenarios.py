"""Scenarios of a simulated world: who asks whom, over what, and what goes wrong."""

import asyncio
import contextlib
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from libmodbus_py import Client, Gateway, Route
from tests.services.workers import simulated as workers_simulated

from .fleets import fleet, plant
from .reports import around_writes, of_odd_hosts, on_busy_line, with_new_clients
from .rules import Pause
from .world import Ask, World, asking_gateway, clients

# How long no client asks after the faults: units are paused for half a minute at most.
SETTLING = 70.0


async def _play(world: World, asks: Sequence[Ask], numbers: range) -> None:
    """Let all clients ask while things go wrong, and each ask every unit when nothing does."""
    until = world.events.now + world.options.seconds
    await asyncio.gather(*(world.act(ask, numbers, until) for ask in asks))
    await _serve_all(world, asks, numbers)


async def _serve_all(world: World, asks: Sequence[Ask], numbers: range) -> None:
    """End all faults; then each call must succeed."""
    checker = world.checker
    world.calm()
    await asyncio.sleep(SETTLING)
    failed = checker.failed
    for ask in asks:
        for number in numbers:
            await ask(number)
            checker.late()
            if checker.failed > failed:
                checker.fail("everybody is served when the faults are over", f"unit {number}")
                checker.look()


async def _direct(world: World, url: str, numbers: range, timeout: float, most: int) -> None:
    """Clients that ask units themselves, all over one connection where there can be only one."""
    retries = world.random.choice([0, 0, 2])
    one = timeout * (1 + retries)
    is_line = not url.startswith("tcp")
    tasks = world.options.clients
    count = 1 if is_line else most
    # Waiting for others' requests does not count: for their ends before a new connection is made.
    # Nor does a trial: what is lost beside others is asked again alone, when these have ended, and
    # others wait meanwhile.
    beside_others = 2 * one + 4 * timeout
    limit = (
        (3 * one + 2 * timeout) * tasks if is_line else (one if count == tasks else beside_others)
    )
    async with clients(url, count, timeout=timeout, retries=retries) as plcs:
        asks = [world.asking(plcs[number % len(plcs)], limit) for number in range(tasks)]
        await _play(world, asks, numbers)


async def _on_tcp(world: World) -> None:
    """Clients and a device over Modbus/TCP."""
    numbers, timeout = _units(world), world.random.choice([0.2, 1.0])
    url = world.host("tcp://10.0.0.1", numbers, timeout)
    await _direct(world, url, numbers, timeout, world.random.randint(1, world.options.clients))


async def _on_line(world: World) -> None:
    """Clients and units on a serial line."""
    numbers, timeout = _units(world), world.random.choice([0.3, 1.0])
    baudrate = world.random.choice([9600, 19_200, 115_200])
    world.bus("/dev/line", numbers, timeout, baudrate)
    await _direct(world, f"rtu:///dev/line?baudrate={baudrate}", numbers, timeout, 1)


async def _on_rtu_over_tcp(world: World) -> None:
    """Clients and units whose frames have no transaction ids, over TCP."""
    numbers, timeout = _units(world), world.random.choice([0.3, 1.0])
    url = world.host("rtu+tcp://10.0.0.1", numbers, timeout)
    await _direct(world, url, numbers, timeout, 1)


def _units(world: World) -> range:
    return range(1, 1 + world.options.units)


async def _through_gateway(world: World) -> None:
    """Clients, a gateway, a line, and a device over Modbus/TCP."""
    random, numbers = world.random, range(1, 1 + max(2, world.options.units))
    half = len(numbers) // 2 + 1
    timeout = random.choice([0.3, 0.5])
    world.bus("/dev/line", range(1, half), timeout, 19_200)
    behind = world.host("tcp://10.0.0.1", range(half, numbers.stop), timeout)
    options = f"timeout={timeout}"
    routes = [
        Route(f"rtu:///dev/line?baudrate=19200&{options}", range(1, half), merge=_chance(random)),
        Route(f"{behind}?{options}", range(half, numbers.stop), cache=random.choice([0.0, 0.1])),
    ]
    gateway = Gateway(
        routes, queue=random.choice([1, 16]), longest_wait=5.0, writes_first=_chance(random)
    )
    patience = random.choice([0.5, 3.0])
    async with asking_gateway(world, gateway, world.options.clients, patience, age=0.1) as asks:
        try:
            await _play(world, asks, numbers)
        finally:
            _look_at_gateway(world, gateway)


async def _past_silent_unit(world: World) -> None:
    """A gateway whose first unit gives no answer, until the faults are over."""
    options = replace(world.options, faults=())
    world.options = options
    random, numbers, timeout = world.random, range(1, 2 + options.units), 0.5
    if random.random() < 0.5:
        world.bus("/dev/line", numbers, timeout, 19_200)
        url = f"rtu:///dev/line?baudrate=19200&timeout={timeout}"
    else:
        # With a given number, a request that is lost beside others is not asked again alone, which
        # happens before the line knows that the unit is silent.
        place = world.host("tcp://10.0.0.1", numbers, timeout)
        url = f"{place}?timeout={timeout}&max_in_flight=16"
    world.units[0].behaviour = replace(world.units[0].behaviour, silent=1.0)
    world.checker.paused[1] = Pause(timeout)
    gateway = Gateway([Route(url, numbers)])
    async with asking_gateway(world, gateway, options.clients, 5.0) as asks:
        await _play(world, asks, numbers)


async def _many_clients(world: World) -> None:
    """A gateway that all ask at once: one host with many clients, others with one each."""
    options = replace(world.options, faults=(), units=3, seconds=5.0, pause=0.001)
    world.options = options
    numbers = range(1, 4)
    world.bus("/dev/line", numbers, 0.5, 19_200)
    gateway = Gateway([Route("rtu:///dev/line?baudrate=19200&timeout=0.5", numbers)], queue=64)
    hosts = ["10.255.0.1"] * world.random.randint(4, 10)
    hosts += [f"10.255.0.{2 + number}" for number in range(world.random.randint(1, 3))]
    world.wire.hosts_take_turns = True
    async with asking_gateway(world, gateway, len(hosts), 30.0) as asks:
        until = world.events.now + options.seconds
        acts = (world.act(ask, numbers, until, host) for ask, host in zip(asks, hosts, strict=True))
        await asyncio.gather(*(asyncio.create_task(act) for act in acts))
        await _serve_all(world, asks[:1], numbers)


def _workers(world: World) -> None:
    """The deciding part of workers that are stopped, cut off, killed and late."""
    random = world.random
    workers = workers_simulated.World(world.options.seed)
    for number in range(world.options.units):
        workers.configure(number)
    for _ in range(3):
        workers.start("", "north")
    while workers.now < 1000 + world.options.seconds:
        workers.run(random.uniform(0.5, 20))
        _disturb(random, workers)
        if workers.doubles:
            world.checker.fail("no device is asked by two", workers.doubles[0])
            return
        if workers.overslept:
            world.checker.fail("a worker knows when to decide", workers.overslept[0])
            return
    world.events.now += world.options.seconds


def _disturb(random: random.Random, workers: workers_simulated.World) -> None:
    process = random.choice(workers.processes)
    what = random.choice(["stop", "cut", "late", "kill", "start", "good", "good"])
    if what == "kill" and len(workers.processes) > 1:
        workers.kill(process)
    elif what in ("kill", "start") and len(workers.processes) < 6:
        workers.start("", "north")
    process.is_stopped = what == "stop"
    process.is_cut = what == "cut"
    process.delay = random.choice([0.5, 5.0, 30.0]) if what == "late" else 0.01


def _chance(random: random.Random) -> bool:
    return random.random() < 0.5


def _look_at_gateway(world: World, gateway: Gateway) -> None:
    """Nothing waits in a gateway whose clients have all been told."""
    if not world.is_calm:
        return
    for line in gateway.traffic.lines.values():
        if line.waiting or line.in_flight:
            text = f"{line.waiting} wait, {line.in_flight} are in flight"
            world.checker.fail("nothing is left waiting", text)


def _blocking(world: World) -> None:
    """A blocking client that asks units over TCP, with ids or without, or on a line."""
    numbers, timeout = _units(world), world.random.choice([0.3, 1.0])
    kind = world.random.choice(["tcp", "rtu+tcp", "rtu"])
    if kind == "rtu":
        world.bus("/dev/line", numbers, timeout, 19_200)
        url = "rtu:///dev/line?baudrate=19200"
    else:
        url = world.host(f"{kind}://10.0.0.1", numbers, timeout)
    retries = world.random.choice([0, 2])
    # poll counts milliseconds, for each attempt anew.
    limit = ((timeout if kind == "tcp" else 5 * timeout) + 0.001) * (1 + retries)
    checker, until = world.checker, world.events.now + world.options.seconds
    context = Client(url, timeout=timeout, retries=retries)
    with contextlib.closing(context):
        sleep = world.network.waker().sleep
        while world.events.now < until:
            sleep(world.pause())
            world.ask_blocking(context, world.call(world.random.choice(numbers), limit))
        world.calm()
        sleep(SETTLING)
        # What came meanwhile is read with the next request, and the silence counts from then on.
        world.ask_blocking(context, world.call(numbers[0], limit))
        sleep(SETTLING)
        failed = checker.failed
        for number in numbers:
            world.ask_blocking(context, world.call(number, limit))
        if checker.failed > failed:
            checker.fail("everybody is served when the faults are over", str(numbers))


SCENARIOS: dict[str, Callable[[World], Any]] = {
    "tcp": _on_tcp,
    "line": _on_line,
    "rtu+tcp": _on_rtu_over_tcp,
    "gateway": _through_gateway,
    "blocking": _blocking,
    "silent unit": _past_silent_unit,
    "busy line": on_busy_line,
    "new clients": with_new_clients,
    "around writes": around_writes,
    "odd hosts": of_odd_hosts,
    "many clients": _many_clients,
    "workers": _workers,
    "fleet": fleet,
    "plant": plant,
}
