"""
What tests of fleets share: devices, maps, and waiting for what must happen.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from contextvars import ContextVar
from typing import Any, Self, TypeVar

from libmodbus_py import Device, Fleet, Mapping, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from tests.simulation.network import Network
from tests.simulation.sockets import MemorySocket
from tests.support.scripted import all_accepted

METER = RegisterMap(
    [
        Point("voltage", "holding_registers", 0, scale=0.1, units="V", access="read"),
        Point("power", "holding_registers", 1, type="int16", units="W", access="read"),
        Point("setpoint", "holding_registers", 2, minimum=10, maximum=30, units="C"),
    ]
)

LONGEST = 20.0
"""Seconds that anything may take on a busy machine."""

LONGEST_SIMULATED = 3600.0

Answer = Callable[[bytes], Awaitable[bytes | None]]

Result = TypeVar("Result")

NETWORK: ContextVar[Network] = ContextVar("NETWORK")
"""What a test in simulated time runs on."""


def meter(name: str, url: str, **keys: Any) -> DeviceConfig:
    return DeviceConfig(**{"name": name, "url": url, "map": METER, "interval": 0.1, **keys})


def simulated(voltage: int = 2305) -> Device:
    return Device(Mapping(holding_registers={0: [voltage, 0xFFFF, 20]}))


async def while_polled(
    fleet: Fleet, main: Callable[[], Awaitable[None]], note: Callable[[Reading], object]
) -> None:
    """Run a test while a fleet polls, and note each of its readings until it has ended."""

    async def collect() -> None:
        async for reading in fleet.readings():
            note(reading)

    collecting = asyncio.create_task(collect())
    await asyncio.sleep(0)
    async with fleet:
        await main()
    await collecting


@asynccontextmanager
async def polling(
    *devices: DeviceConfig, **options: Any
) -> AsyncIterator[tuple[Fleet, list[Reading]]]:
    """A fleet that polls, and all that it reads."""
    readings: list[Reading] = []

    async def collect() -> None:
        async for reading in kept:
            readings.append(reading)

    fleet = Fleet(devices, **options)
    kept = fleet.readings()
    collecting = asyncio.create_task(collect())
    try:
        async with fleet:
            yield fleet, readings
    finally:
        await asyncio.wait_for(collecting, LONGEST)


def simulated_run(test: Coroutine[Any, Any, Result], network: Network | None = None) -> Result:
    """Run a test in simulated time, on a network in memory."""
    network = network or Network()

    async def main() -> Result:
        NETWORK.set(network)
        return await asyncio.wait_for(test, LONGEST_SIMULATED)

    return network.run(main)


def stand_still(seconds: float) -> None:
    """Let simulated time pass while nobody in the event loop does anything."""
    events = NETWORK.get().events
    until = events.now + seconds
    while events.now < until:
        events.advance(until)


async def until(is_so: Callable[[], object]) -> None:
    """Wait for it."""
    async with asyncio.timeout(LONGEST):
        while not is_so():
            await asyncio.sleep(0.01)


class Peer:
    """
    A Modbus/TCP server of any manners, on the network of `simulated_run`.

    Args:
        answer: gives the bytes to send for a request, in its own time; None for nothing.

    Attributes:
        requests: all that came, and `times` when.
        connections: all that were made.
    """

    def __init__(self, answer: Answer | None = None) -> None:
        self._answer = answer or good
        self.requests: list[bytes] = []
        self.times: list[float] = []
        self.connections: list[Connection] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._network = NETWORK.get()

    @property
    def units(self) -> list[int]:
        return [request[6] for request in self.requests]

    async def __aenter__(self) -> Self:
        self.url: str = self._network.listen("tcp://10.9.0.1:0", self._accept)
        self.port: int = int(self.url.rpartition(":")[2])
        return self

    async def __aexit__(self, *_: object) -> None:
        self._network.unlisten(self.url)
        for connection in self.connections:
            connection.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _accept(self, end: MemorySocket, address: tuple[str, int]) -> None:
        self.connections.append(Connection(end, self._take))

    def _take(self, connection: Connection, request: bytes) -> None:
        self.requests.append(request)
        self.times.append(self._network.events.now)
        task = asyncio.create_task(self._reply(request, connection))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reply(self, request: bytes, connection: Connection) -> None:
        answer = await self._answer(request)
        if answer is not None:
            connection.write(answer)


class Connection:
    """A connection of a `Peer`, which cuts what comes into requests."""

    def __init__(self, end: MemorySocket, take: Callable[[Connection, bytes], None]) -> None:
        self._end = end
        self._request_came = take
        self._pending = bytearray()
        self._unsent = bytearray()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(end.fileno(), self._read)

    def is_closing(self) -> bool:
        return self._end.is_closed

    def close(self) -> None:
        if not self._end.is_closed:
            self._loop.remove_reader(self._end.fileno())
            self._loop.remove_writer(self._end.fileno())
            self._end.close()

    def write(self, data: bytes) -> None:
        """Send bytes, as many at once as there is room for."""
        self._unsent += data
        self._send()

    def _send(self) -> None:
        try:
            while self._unsent and not self._end.is_closed:
                del self._unsent[: self._end.send(self._unsent)]
        except BlockingIOError:
            self._loop.add_writer(self._end.fileno(), self._send)
            return
        except OSError:
            self.close()
            return
        if not self._end.is_closed:
            self._loop.remove_writer(self._end.fileno())

    def _read(self) -> None:
        try:
            data = self._end.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.close()
            return
        self._pending += data
        while len(self._pending) >= 6:
            size = 6 + int.from_bytes(self._pending[4:6], "big")
            if len(self._pending) < size:
                break
            request = bytes(self._pending[:size])
            del self._pending[:size]
            self._request_came(self, request)


class RealPeer:
    """The same on a real socket, in the same event loop: for outputs that are real."""

    def __init__(self, answer: Answer | None = None) -> None:
        self._answer = answer or good
        self.requests: list[bytes] = []
        self.connections: list[asyncio.StreamWriter] = []
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port: int = self._server.sockets[0].getsockname()[1]
        self.url = f"tcp://127.0.0.1:{self.port}"
        return self

    async def __aexit__(self, *_: object) -> None:
        await all_accepted()
        self._server.close()
        for writer in self.connections:
            writer.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections.append(writer)
        with suppress(asyncio.IncompleteReadError, OSError):
            while True:
                head = await reader.readexactly(6)
                request = head + await reader.readexactly(int.from_bytes(head[4:], "big"))
                self.requests.append(request)
                task = asyncio.create_task(self._reply(request, writer))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        writer.close()

    async def _reply(self, request: bytes, writer: asyncio.StreamWriter) -> None:
        answer = await self._answer(request)
        if answer is not None:
            writer.write(answer)


async def good(request: bytes) -> bytes:
    """The answer to a read of registers, each 7; to a write its echo."""
    if request[7] != 3:
        return request[:12].replace(request[4:6], b"\0\6", 1)
    count = int.from_bytes(request[10:12], "big")
    body = bytes([request[6], 3, 2 * count]) + b"\0\7" * count
    return request[:4] + len(body).to_bytes(2, "big") + body
