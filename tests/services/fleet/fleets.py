"""What tests of fleets share: devices, maps, and waiting for what must happen."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from contextvars import ContextVar
from functools import partial, wraps
from typing import Any, Self, TypeVar

from libmodbus_py import Device, Fleet, Mapping, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted, Write
from tests.support.scripted import Scripted as RealScripted

METER = RegisterMap(
    [
        Point("voltage", "holding_registers", 0, scale=0.1, units="V", access="read"),
        Point("power", "holding_registers", 1, type="int16", units="W", access="read"),
        Point("setpoint", "holding_registers", 2, minimum=10, maximum=30, units="C"),
    ]
)

LONGEST = 20.0  # seconds that anything may take on a busy machine


LONGEST_SIMULATED = 3600.0

Answer = Callable[[bytes], Awaitable[bytes | None]]

Result = TypeVar("Result")

NETWORK: ContextVar[Network] = ContextVar("NETWORK")  # what a test in simulated time runs on


def meter(name: str, url: str, **keys: Any) -> DeviceConfig:
    return DeviceConfig(**{"name": name, "url": url, "map": METER, "interval": 0.1, **keys})


def simulated(voltage: int = 2305) -> Device:
    return Device(Mapping(holding_registers={0: [voltage, 0xFFFF, 20]}))


@asynccontextmanager
async def polling(
    *devices: DeviceConfig, **options: Any
) -> AsyncIterator[tuple[Fleet, list[Reading]]]:
    """A fleet that polls, and all that it reads."""
    readings: list[Reading] = []

    async def collect() -> None:
        async for reading in iterator:
            readings.append(reading)

    fleet = Fleet(devices, **options)
    iterator = fleet.readings()
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


def in_simulated_time(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Decorate a test that runs in simulated time."""

    @wraps(test)
    def run(*arguments: Any, **fixtures: Any) -> None:
        simulated_run(test(*arguments, **fixtures))

    return run


def stand_still(seconds: float) -> None:
    """Let simulated time pass while nobody in the event loop does anything."""
    events = NETWORK.get().events
    until = events.now + seconds
    while events.now < until:
        events.advance(until)


async def until(is_so: Callable[[], object]) -> None:
    """Wait for it; pauses in simulated time are up to half a minute."""
    async with asyncio.timeout(LONGEST if NETWORK.get(None) is None else LONGEST_SIMULATED):
        while not is_so():
            await asyncio.sleep(0.01)


class Peer:
    """
    A Modbus/TCP server of any manners, on the network of `simulated_run`. `answer`: gives the bytes
    to send for a request, in its own time; None for nothing.
    """

    url: str

    def __init__(self, answer: Answer | None = None) -> None:
        self._answer = answer or good
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        # What comes is noted while the loop waits, so that it must be woken.
        wake = partial(asyncio.get_running_loop().call_soon_threadsafe, self._take)
        self._peer = Scripted(NETWORK.get(), "tcp://10.9.0.1:0", wake)
        self.url = self._peer.url
        return self

    async def __aexit__(self, *_: object) -> None:
        NETWORK.get().unlisten(self.url)
        for connection in self.connections:
            connection.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _take(self, request: bytes, write: Write) -> None:
        task = asyncio.create_task(self._reply(request, write))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _reply(self, request: bytes, write: Write) -> None:
        if (answer := await self._answer(request)) is not None:
            write(answer)

    @property
    def requests(self) -> list[bytes]:
        return self._peer.requests

    @property
    def connections(self) -> list[Any]:
        return self._peer.ends

    @property
    def units(self) -> list[int]:
        return [request[6] for request in self.requests]


def real_peer() -> AbstractAsyncContextManager[RealScripted]:
    """A server on a real socket, in the same event loop: for outputs that are real."""
    return RealScripted(lambda request, write: write(sevens(request))).serving()


def sevens(request: bytes) -> bytes:
    """The answer to a read of registers, each 7; to a write its echo."""
    if request[7] != 3:
        return request[:12].replace(request[4:6], b"\0\6", 1)
    count = int.from_bytes(request[10:12], "big")
    body = bytes([request[6], 3, 2 * count]) + b"\0\7" * count
    return request[:4] + len(body).to_bytes(2, "big") + body


async def good(request: bytes) -> bytes:
    return sevens(request)


async def silent(request: bytes) -> None:
    """No answer to any request."""
