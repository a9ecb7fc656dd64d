"""
Checks before a fleet runs: which devices answer, and which serial lines are overloaded.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...client.asynchronous import AsyncClient
from ...ports.endpoint import Endpoint
from ...protocol.errors import ModbusError
from ...protocol.framing import Frame, make_framer
from .config import DeviceConfig, by_connection
from .poller import OnePoll

if TYPE_CHECKING:
    from ...ports.serial import SerialPort

__all__ = ["Overload", "Tried", "overloads", "trying"]

MOST_AT_ONCE = 64
"""Connections that are tried at the same time."""

SILENCE = 3.5
"""Characters between two frames of RTU (serial line, 2.5.1.1)."""


@dataclass(frozen=True, slots=True)
class Tried:
    """
    One poll of a device: its number of requests, its seconds, and the first error, if there was
    one.
    """

    device: DeviceConfig
    requests: int
    seconds: float
    problem: str


@dataclass(frozen=True, slots=True)
class Overload:
    """
    A serial line that cannot carry all polls: so many seconds are `needed` in each `interval`.
    """

    url: str
    baudrate: int
    needed: float
    interval: float

    def __str__(self) -> str:
        return (
            f"line {self.url.partition('?')[0]} at {self.baudrate}:"
            f" {self.needed:.3g} s of requests each {self.interval:g} s"
        )


def overloads(devices: Iterable[DeviceConfig]) -> list[Overload]:
    """Return the serial lines that cannot keep the intervals of their devices."""
    found: list[Overload] = []
    for group in by_connection(devices).values():
        endpoint = group[0].endpoint
        if not endpoint.is_serial:
            continue
        shares = [share for device in group for share in _shares(device)]
        shortest = min(interval for interval, _ in shares)
        needed = sum(seconds * shortest / interval for interval, seconds in shares)
        if needed > shortest:
            found.append(Overload(endpoint.url, _port(endpoint).baudrate, needed, shortest))
    return found


def _port(endpoint: Endpoint) -> SerialPort:
    from ...ports.serial import SerialPort  # which not every system has

    return SerialPort(endpoint.path, **endpoint.serial_settings)


def _shares(device: DeviceConfig) -> Iterator[tuple[float, float]]:
    """Yield the intervals of the points of a device, and the seconds of a poll of each."""
    names: dict[float, list[str]] = {}
    for name in device.names:
        own = device.map[name].interval
        names.setdefault(device.interval if own is None else own, []).append(name)
    for interval, some in names.items():
        yield interval, _seconds(device, some)


def _seconds(device: DeviceConfig, names: list[str]) -> float:
    """Return the seconds of a poll on a serial line: characters, and silence between frames."""
    endpoint = device.endpoint
    framer = make_framer(endpoint.framing, "client")
    silence = SILENCE if endpoint.framing == "rtu" else 0.0
    reads: Any = device.plan(names).requests
    pdus = [
        pdu for each in reads for pdu in (each.encode(), each.encode_response([0] * each.count))
    ]
    characters = sum(len(framer.encode(Frame(device.unit, pdu))) + silence for pdu in pdus)
    return characters * _port(endpoint).character


async def trying(devices: Sequence[DeviceConfig]) -> AsyncGenerator[Tried, None]:
    """Poll each device once, those of a line one after the other; yield results as they come."""
    found: asyncio.Queue[Tried | Exception] = asyncio.Queue()
    free = asyncio.Semaphore(MOST_AT_ONCE)
    tasks = [
        asyncio.create_task(_try_line(group, free, found))
        for group in by_connection(devices).values()
    ]
    try:
        for _ in devices:
            result = await found.get()
            if isinstance(result, Exception):
                raise result  # a defect, after which no more results of its line come
            yield result
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _try_line(
    devices: list[DeviceConfig],
    free: asyncio.Semaphore,
    found: asyncio.Queue[Tried | Exception],
) -> None:
    async with free:
        client = AsyncClient(devices[0].endpoint.url)
        try:
            for device in devices:
                found.put_nowait(await _try(client, device))
        except Exception as error:
            found.put_nowait(error)
        finally:
            await client.close()


async def _try(client: AsyncClient, device: DeviceConfig) -> Tried:
    now = asyncio.get_running_loop().time
    plan, start = device.plan(), now()
    poll = OnePoll(plan)
    unit = client.for_unit(device.unit, timeout=device.timeout)
    while poll.request is not None:
        try:
            poll.take(await unit.execute(poll.request))
        except ModbusError as error:
            poll.take(error)
    errors = [each for each in poll.values().values() if isinstance(each, Exception)]
    problem = next(map(str, filter(None, [*errors, poll.error])), "")
    return Tried(device, len(plan.requests), now() - start, problem)
