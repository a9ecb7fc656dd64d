"""Checks before a fleet runs: which devices answer, and which serial lines are overloaded."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ...client.asynchronous import AsyncClient
from ...protocol.errors import ModbusError
from ...protocol.framing import Frame, make_framer
from .config import DeviceConfig, by_connection
from .poller import Poller
from .readings import classification

MOST_AT_ONCE = 64  # connections that are tried at the same time
SILENCE = 3.5  # characters between two frames of RTU (serial line, 2.5.1.1)


class TrialPoll(NamedTuple):
    """One poll of a device: its requests, its seconds, and why it or some points have no values."""

    device: DeviceConfig
    requests: int
    seconds: float
    problem: str


def overloads(devices: Iterable[DeviceConfig]) -> list[str]:
    """Return a sentence for each serial line that cannot keep the intervals of its devices."""
    sentences: list[str] = []
    for group in by_connection(devices).values():
        endpoint = group[0].endpoint
        if not endpoint.is_serial:
            continue
        from ...ports.serial import SerialPort  # which not every system has

        port = SerialPort(endpoint.path, **endpoint.serial_settings)
        loads = [
            (interval, characters * port.character)
            for device in group
            for interval, characters in _characters(device).items()
        ]
        shortest = min(interval for interval, _ in loads)
        load = sum(seconds * shortest / interval for interval, seconds in loads)
        if load > shortest:
            line = f"line {endpoint.url.partition('?')[0]} at {port.baudrate}"
            sentences.append(f"{line}: {load:.3g} s of requests each {shortest:g} s")
    return sentences


def _characters(device: DeviceConfig) -> dict[float, float]:
    """Return the characters of a poll, silence included, of the points of each interval."""
    framing = device.endpoint.framing
    framer = make_framer(framing, "client")
    silence = SILENCE if framing == "rtu" else 0.0
    points: defaultdict[float, list[int]] = defaultdict(list)
    for at, own in enumerate(device.reads.intervals):
        points[own or device.interval].append(at)
    counts = dict.fromkeys(points, 0.0)
    for interval, due in points.items():
        requests: Any = device.reads.plan_of(tuple(due)).requests
        for request in requests:
            for pdu in (request.encode(), request.encode_response([0] * request.count)):
                counts[interval] += len(framer.encode(Frame(device.unit, pdu))) + silence
    return counts


async def trial_polls(devices: Sequence[DeviceConfig]) -> AsyncGenerator[TrialPoll, None]:
    """Poll each device once, those of a line one after the other; yield results as they come."""
    results: asyncio.Queue[TrialPoll | Exception] = asyncio.Queue()
    free = asyncio.Semaphore(MOST_AT_ONCE)
    tasks = [
        asyncio.create_task(_try_line(group, free, results))
        for group in by_connection(devices).values()
    ]
    try:
        for _ in devices:
            result = await results.get()
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
    results: asyncio.Queue[TrialPoll | Exception],
) -> None:
    async with free:
        client = AsyncClient(devices[0].endpoint.url)
        try:
            for device in devices:
                results.put_nowait(await _try(client, device))
        except Exception as error:
            results.put_nowait(error)
        finally:
            await client.close()


async def _try(client: AsyncClient, device: DeviceConfig) -> TrialPoll:
    now = asyncio.get_running_loop().time
    start, poller = now(), Poller(device)
    unit = client.for_unit(device.unit, timeout=device.timeout)
    poller.begin()
    while poller.request is not None:
        try:
            poller.take_outcome(await unit.execute(poller.request), now())
        except ModbusError as error:
            poller.take_outcome(error, now())
    problem = _problem_of(poller, poller.values())
    return TrialPoll(device, len(poller.reads.plan.requests), now() - start, problem)


def _problem_of(poller: Poller, values: Mapping[str, Any]) -> str:
    """Return why a device is down, or why a point has no good value, and how many have none."""
    if poller.misses:
        return str(poller.error)
    bad = {name: value for name, value in values.items() if classification(value)[1] != "good"}
    texts = [
        str(value) if isinstance(value, Exception) else f"{name}: {classification(value)[2]}"
        for name, value in bad.items()
    ]
    count = f"; points without a good value: {len(bad)} of {len(values)}"
    return texts[0] + (count if len(bad) > 1 else "") if bad else ""
