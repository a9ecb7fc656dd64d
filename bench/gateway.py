"""
What a gateway costs, and what it does with silent and late units: ``python -m bench.gateway``.

Devices and clients are processes or threads beside it. The figures that people know of others
are those of mbusd 0.5.3: 10 requests a second by default, 2.16 s that a good unit waits for a
dead one each time, and 7 wrong answers of 8 when a unit is late.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import subprocess
import sys
import time
from collections.abc import Iterator

from libmodbus_py import AsyncClient, Client, ExceptionResponse, pdu
from libmodbus_py.tools.testing.wires import SerialWire

from .bus import Bus

ME = [sys.executable, "-m", "libmodbus_py"]
READ = pdu.ReadHoldingRegisters(0, 10)


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[str]:
    """A command of this package that listens; gives where."""
    with subprocess.Popen([*ME, *arguments], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.terminate()


@contextlib.contextmanager
def gateway(line: str) -> Iterator[str]:
    with running("gateway", "tcp://127.0.0.1:0", "--to", line) as url:
        yield url


def one_by_one(url: str, count: int) -> float:
    """Requests a second of a client that waits for each answer; the best of five."""
    with Client(url, unit=1, timeout=5) as context:
        context.execute(READ)
        best = 0.0
        for _ in range(5):
            start = time.perf_counter()
            for _ in range(count // 5):
                context.execute(READ)
            best = max(best, count // 5 / (time.perf_counter() - start))
    return best


async def in_flight(url: str, clients: int, each: int, count: int) -> float:
    """Requests a second of several clients, so many of each in flight."""
    async with contextlib.AsyncExitStack() as stack:
        made = [
            await stack.enter_async_context(
                AsyncClient(url, unit=1, timeout=20, max_in_flight=each)
            )
            for _ in range(clients)
        ]
        start = time.perf_counter()
        jobs = (c.execute_many([READ] * (count // clients)) for c in made)
        await asyncio.gather(*jobs)
        return count / (time.perf_counter() - start)


def rates(count: int = 10_000) -> None:
    for baudrate in (19200, 115200):
        with SerialWire() as wire, running("serve", f"rtu://{wire.server}?baudrate={baudrate}"):
            line = f"rtu://{wire.client}?baudrate={baudrate}"
            direct = one_by_one(line, count // 10)
            with gateway(f"{line}&timeout=2") as url:
                through = one_by_one(url, count // 10)
        told(f"pty, {baudrate} bit/s, one at a time", direct, through)
    with running("serve", "tcp://127.0.0.1:0") as server:
        with gateway(f"{server}?timeout=5") as url:
            told("tcp, one at a time", one_by_one(server, count), one_by_one(url, count))
        for on_line, (clients, entry) in itertools.product((1, 16), ((1, 16), (8, 16))):
            with gateway(f"{server}?timeout=5&max_in_flight={on_line}") as url:
                direct, through = (
                    asyncio.run(in_flight(where, clients, entry, 3 * count))
                    for where in (server, url)
                )
            told(f"tcp, {clients} x {entry} in flight, {on_line} behind it", direct, through)


def told(what: str, direct: float, through: float) -> None:
    print(f"{what:40} direct {direct:7.0f}/s   through {through:7.0f}/s   {through / direct:.2f}")


def silent_unit(count: int = 500) -> None:
    """One client polls a good unit and a silent one in turn, as most clients do."""
    with Bus() as bus, gateway(f"rtu://{bus.path}?timeout=0.5") as url:
        waits: list[float] = []
        with Client(url, timeout=5) as context:
            begin = time.perf_counter()
            for number in range(count):
                start = time.perf_counter()
                with contextlib.suppress(ExceptionResponse):
                    context.for_unit(9).read_holding_registers(0, 1)
                context.for_unit(1).read_holding_registers(number % 100, 1)
                waits.append(time.perf_counter() - start)
            took = time.perf_counter() - begin
    waits.sort()
    print(
        f"a dead unit beside a good one: {count} rounds in {took:.1f} s; median"
        f" {waits[count // 2] * 1000:.1f} ms, worst {waits[-1] * 1000:.0f} ms (timeout 500 ms)"
    )


def beside_silent_unit(count: int = 500) -> None:
    """Another client polls the good unit meanwhile: how long it waits."""

    async def ask(client: AsyncClient, unit: int, waits: list[float], stop: asyncio.Event) -> None:
        number = 0
        while not stop.is_set():
            start = time.perf_counter()
            with contextlib.suppress(ExceptionResponse):
                await client.for_unit(unit).read_holding_registers(number % 100, 1)
            waits.append(time.perf_counter() - start)
            number += 1
            if unit == 1 and number == count:
                stop.set()
            await asyncio.sleep(0.005)

    async def both(url: str) -> list[float]:
        good: list[float] = []
        stop = asyncio.Event()
        async with AsyncClient(url, timeout=5) as one, AsyncClient(url, timeout=5) as other:
            await asyncio.gather(ask(one, 1, good, stop), ask(other, 9, [], stop))
        return good

    with Bus() as bus, gateway(f"rtu://{bus.path}?timeout=0.5") as url:
        good = asyncio.run(both(url))
    first, rest = max(good[:20]), sorted(good[20:])
    print(
        f"a good unit while another client asks a dead one: first round {first * 1000:.0f} ms,"
        f" then median {rest[len(rest) // 2] * 1000:.1f} ms, worst {rest[-1] * 1000:.1f} ms"
    )


def late_unit(count: int = 10_000) -> None:
    """A unit whose every fifth answer comes after its timeout, two good ones, four clients."""

    async def poll(client: AsyncClient, unit: int, first: int, tally: dict[str, int]) -> None:
        for at in range(first, first + count // 4):
            try:
                got = await client.for_unit(unit).read_holding_registers(at % 65536, 1)
            except ExceptionResponse:
                tally["refused"] += 1
            else:
                right = got == [Bus.value(unit, at % 65536)]
                tally["right" if right else "wrong"] += 1

    async def all_of_them(url: str) -> dict[str, int]:
        tally = {"right": 0, "wrong": 0, "refused": 0}
        async with contextlib.AsyncExitStack() as stack:
            jobs = []
            for unit, first in ((1, 0), (2, 3000), (3, 9000), (2, 20_000)):
                client = await stack.enter_async_context(AsyncClient(url, timeout=30))
                jobs.append(poll(client, unit, first, tally))
            await asyncio.gather(*jobs)
        return tally

    with (
        Bus(late={2: 5}, seconds=0.15) as bus,
        gateway(f"rtu://{bus.path}?baudrate=115200&timeout=0.1") as url,
    ):
        print(f"a late unit, {count} requests: {asyncio.run(all_of_them(url))}")


if __name__ == "__main__":
    rates()
    silent_unit()
    beside_silent_unit()
    late_unit()
