"""
Scenarios that users report: a line on which others talk, clients that are made anew for each poll,
devices that are busy, that close after each answer, or send wrong transaction ids.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any

from libmodbus_py import AsyncClient, pdu
from tests.support.driver import rtu

from .lines import Party
from .world import World

Ask = Callable[[AsyncClient, int], Awaitable[None]]

# A unit that the client does not ask: what its own master asks, and what it answers.
OTHER = (rtu("f0 03 0000 0001"), rtu("f0 03 02 0007"))

TRIES = 10  # after so many requests each unit has answered, although others go on to talk


async def on_busy_line(world: World) -> None:
    """A line with another master, or with stray bytes, for ever."""
    timeout = world.random.choice([0.3, 1.0])
    url = _line(world, timeout)
    if world.random.random() < 0.5:
        pieces, pause = OTHER, (0.3, 1.0)
    else:
        pieces, pause = (world.random.choice([b"\xff", b"\0"]),), (0.4, 0.4)
    noise = asyncio.create_task(_talk(world, pieces, pause))
    try:
        async with _client(url, timeout=timeout) as plc:
            await _poll(world, plc, partial(_ask, world, 8 * timeout))
            await _serve(world, plc, partial(_ask, world, 8 * timeout))
    finally:
        noise.cancel()


async def _talk(world: World, pieces: tuple[bytes, ...], pause: tuple[float, float]) -> None:
    other, line = Party(), world.network.line("/dev/line")
    other.is_unit = True
    while True:
        await asyncio.sleep(world.random.uniform(*pause))
        for piece in pieces:
            line.write(other, piece)
            await asyncio.sleep(0.03)


async def with_new_clients(world: World) -> None:
    """A client for each poll of five requests, as in a function; one answer in 40 is late."""
    timeout = 0.1
    world.options = replace(world.options, faults=("late",))
    is_serial = world.random.random() < 0.5
    url = _line(world, timeout) if is_serial else _host(world, "rtu+tcp", timeout)
    for unit in world.units:
        unit.behaviour = replace(unit.behaviour, late=1 / 40)
    until = world.events.now + world.options.seconds
    while world.events.now < until:
        await asyncio.sleep(world.pause())
        async with _client(url, timeout=timeout) as plc:
            for _ in range(5):
                await _ask(world, 8 * timeout, plc, world.random.choice(_units(world)))


async def around_writes(world: World) -> None:
    """A read and a write of one batch, to devices that are busy: what is repeated stays before."""
    timeout, busy = 0.3, world.random.choice([1, 3])
    url = _host(world, "tcp", timeout) if world.random.random() < 0.5 else _line(world, timeout)
    how = {"busy_retries": busy, "retries": world.random.choice([0, 2])}
    async with _client(url, timeout=timeout, **how) as plc:
        await _poll(world, plc, partial(_ask_around, world))


async def _ask_around(world: World, plc: AsyncClient, unit: int) -> None:
    calls = [world.call(unit, 600.0, function=function) for function in (3, 6, 3)]
    requests: list[pdu.Request[Any]] = []
    for function, address, number in (
        (call.key[1][0], *(int.from_bytes(call.key[1][at : at + 2], "big") for at in (1, 3)))
        for call in calls
    ):
        kind: Any = pdu.ReadHoldingRegisters if function == 3 else pdu.WriteRegister
        requests.append(kind(address, number))
    results = await plc.for_unit(unit).execute_many(requests, return_exceptions=True)
    for call, result in zip(calls, results, strict=True):
        if isinstance(result, BaseException):
            world.checker.error(call, result)
        else:
            world.checker.answer(call, result)
    world.checker.compare_order([call.key for call in calls])


async def of_odd_hosts(world: World) -> None:
    """Hosts that close after each answer, or answer with transaction id 0."""
    url = _host(world, "tcp", 1.0)
    is_closing = world.random.random() < 0.5
    host = world.hosts[-1]
    host.closes, host.has_ids = is_closing, is_closing
    world.calm()
    async with _client(url, timeout=1.0, ids="check" if is_closing else "ignore") as plc:
        await _poll(world, plc, partial(_ask, world, 8.0))
    if world.checker.failed:
        world.checker.fail("an odd host is read", f"{world.checker.failed} calls failed")


@contextlib.asynccontextmanager
async def _client(url: str, **options: Any) -> AsyncIterator[AsyncClient]:
    """Use a client that connects with its first request, because a host may refuse it."""
    plc = AsyncClient(url, **options)
    try:
        yield plc
    finally:
        await plc.close()


def _units(world: World) -> range:
    return range(1, 1 + min(world.options.units, 4))


def _line(world: World, timeout: float) -> str:
    baudrate = world.random.choice([9600, 115_200])
    world.bus("/dev/line", _units(world), timeout, baudrate)
    return f"rtu:///dev/line?baudrate={baudrate}"


def _host(world: World, scheme: str, timeout: float) -> str:
    return world.host(f"{scheme}://10.0.0.1", _units(world), timeout)


async def _ask(world: World, limit: float, plc: AsyncClient, unit: int) -> None:
    await world.ask(plc, world.call(unit, limit))


async def _poll(world: World, plc: AsyncClient, ask: Ask) -> None:
    until = world.events.now + world.options.seconds
    while world.events.now < until:
        await asyncio.sleep(world.pause())
        await ask(plc, world.random.choice(_units(world)))


async def _serve(world: World, plc: AsyncClient, ask: Ask) -> None:
    world.calm()
    for unit in _units(world):
        answers = world.checker.answered
        for _ in range(TRIES):
            await ask(plc, unit)
        if world.checker.answered == answers:
            world.checker.fail("a unit is asked again although others talk", f"unit {unit}")
