"""
How far one request goes in the package: calls, files that it visits, and moves between files.

A move is a call into another file of the package, or the return from it. Run it with the
package to measure on the path:

    PYTHONPATH=. python bench/moves.py [-v]
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import libmodbus_py
from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Fleet,
    Gateway,
    Hook,
    Mapping,
    Point,
    RegisterMap,
    Route,
    Server,
)
from libmodbus_py.fleet import DeviceConfig

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = str(Path(libmodbus_py.__file__).parent)

# Requests before the one that is measured: caches are filled, late imports done.
BEFORE = 5


class Profile:
    """
    Counts what happens in the package while it is the profile function of a thread.

    Attributes:
        calls: the functions of the package that were called, in order, as "file function".
    """

    def __init__(self) -> None:
        self.calls: list[str] = []
        self._files: list[str] = []

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if not code.co_filename.startswith(ROOT):
            return
        if event == "call":
            self._files.append(code.co_filename)
            self.calls.append(f"{code.co_filename[len(ROOT) + 1 :]} {code.co_qualname}")
        elif event == "return" and frame.f_back is not None:
            caller = frame.f_back.f_code.co_filename
            if caller.startswith(ROOT):
                self._files.append(caller)

    def __str__(self) -> str:
        files = self._files
        moves = sum(one != other for one, other in pairwise(files))
        return f"{len(self.calls):5} calls {len(set(files)):4} files {moves:5} moves"


@contextmanager
def profiled(name: str) -> Iterator[None]:
    """Print the calls in the package while the block runs."""
    profile = Profile()
    sys.setprofile(profile)
    try:
        yield
    finally:
        sys.setprofile(None)
        print(f"{name:32}{profile}")
        if "-v" in sys.argv:
            print(*(f"    {call}" for call in profile.calls), sep="\n")


def blocking(url: str) -> None:
    with Client(url) as client:
        for _ in range(BEFORE):
            client.read_holding_registers(0, 10)
        with profiled("blocking read"):
            client.read_holding_registers(0, 10)


async def awaited(url: str) -> None:
    async with AsyncClient(url) as client:
        for _ in range(BEFORE):
            await client.read_holding_registers(0, 10)
        with profiled("asyncio read"):
            await client.read_holding_registers(0, 10)


async def exchanged(url: str) -> Callable[[], Awaitable[Any]]:
    """Return a function that reads ten registers without this package."""
    host, port = url.removeprefix("tcp://").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))

    async def exchange() -> None:
        writer.write(bytes.fromhex("0001 0000 0006 01 03 0000 000A"))
        await reader.readexactly(29)
        await asyncio.sleep(0)  # and the steps after the answer

    for _ in range(BEFORE):
        await exchange()
    return exchange


async def answered(name: str, device: Device) -> None:
    async with Server(device).serving("tcp://127.0.0.1:0") as running:
        exchange = await exchanged(running.urls[0])
        with profiled(name):
            await exchange()


async def passed_on() -> None:
    with Server(device()).background("rtu+tcp://127.0.0.1:0") as behind:
        gateway = Gateway([Route(behind.urls[0], [1])])
        async with gateway.serving("tcp://127.0.0.1:0") as running:
            exchange = await exchanged(running.urls[0])
            with profiled("gateway, to a line"):
                await exchange()


async def polled(url: str) -> None:
    points = [Point("level", "holding_registers", 0), Point("flow", "holding_registers", 1)]
    config = DeviceConfig("meter", url, RegisterMap(points), interval=0.5)
    async with Fleet([config]) as fleet:
        readings = fleet.readings()
        for _ in range(2 * BEFORE):
            await anext(readings)
        with profiled("fleet poll of two points"):
            await anext(readings)
            await anext(readings)


def device(**options: Any) -> Device:
    return Device(Mapping(holding_registers=100), **options)


def main() -> None:
    with Server(device()).background("tcp://127.0.0.1:0") as running:
        blocking(running.urls[0])
        asyncio.run(awaited(running.urls[0]))
    asyncio.run(answered("server, plain", device()))
    hook = Hook(lambda access: None, holding_registers=range(100))
    asyncio.run(answered("server, with a hook", device(before_read=hook)))
    asyncio.run(passed_on())
    with Server(device()).background("tcp://127.0.0.1:0") as running:
        asyncio.run(polled(running.urls[0]))


if __name__ == "__main__":
    main()
