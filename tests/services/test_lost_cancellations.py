"""
Cancellations that arrive at the moment at which what is waited for happens.

`asyncio.wait_for` of Python 3.11 loses them; the libraries of MQTT and NATS use it.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.engine.buckets import Watch
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from libmodbus_py.services.fleet.outputs.pump import Pump
from libmodbus_py.services.tasks import AGAIN, FINISHING_S, end_tasks, finish
from tests.simulation.given import simulated
from tests.support.outputs import FakeOutput, reading


class Careless(FakeOutput):
    """An output that swallows cancellations of its `write`, the first so many times."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.left = count

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        while self.left:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                self.left -= 1
        await asyncio.Event().wait()


@simulated
async def test_an_output_that_loses_cancellations_ends_with_the_fleet() -> None:
    pump = Pump(Careless(2))
    pump.buffer.put_readings([reading("a", "one")])
    pump.start()
    await asyncio.sleep(1)
    pump.close_pump()
    before = asyncio.get_running_loop().time()
    with pytest.raises(asyncio.CancelledError):
        await pump.task
    assert asyncio.get_running_loop().time() - before == FINISHING_S + 2 * AGAIN


@simulated
async def test_tasks_that_lose_cancellations_are_ended() -> None:
    async def careless(count: int) -> None:
        while count >= 0:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                count -= 1

    tasks = [asyncio.create_task(careless(count)) for count in (0, 1, 4)]
    await asyncio.sleep(0)
    await end_tasks(tasks)
    assert all(task.done() for task in tasks)
    await end_tasks([])


async def cancelled_at_once(waiting: Awaitable[Any], happens: asyncio.Future[None]) -> bool:
    """Let something happen and cancel who waits for it; return True if that was cancelled."""
    task = asyncio.ensure_future(waiting)
    for _ in range(10):
        await asyncio.sleep(0)
    happens.set_result(None)
    task.cancel()
    await asyncio.wait([task])
    return task.cancelled()


def of_file(happens: asyncio.Future[None], path: Path) -> Awaitable[None]:
    output = JsonOutput(str(path))
    thread: Any = SimpleNamespace(is_running=True, call=lambda *_: happens, stop=lambda: None)
    output._thread = thread
    return output.close_output()


def of_watch(happens: asyncio.Future[None], path: Path) -> Awaitable[None]:
    async def unsubscribe() -> None:
        await happens

    watch = Watch("bucket", lambda change: None, lambda: None)
    watch._subscription = cast(Any, SimpleNamespace(unsubscribe=unsubscribe, _sub=None))
    return watch.end()


@pytest.mark.parametrize("waiting", [of_file, of_watch])
def test_a_cancellation_is_not_lost_when_the_last_word_is_said(
    waiting: Callable[[asyncio.Future[None], Path], Awaitable[None]], tmp_path: Path
) -> None:
    async def go() -> bool:
        happens = asyncio.get_running_loop().create_future()
        return await cancelled_at_once(waiting(happens, tmp_path / "readings"), happens)

    assert asyncio.run(go())


@simulated
async def test_a_cancellation_is_not_lost_while_a_pump_rests() -> None:
    pump = Pump(FakeOutput(refused=("a",), error=OSError("away")))
    pump.buffer.put_readings([reading("a", "one")])
    pump.start()
    await asyncio.sleep(0.1)
    pump.close_pump(is_patient=True)
    pump.task.cancel()
    await asyncio.wait([pump.task])
    assert pump.task.cancelled()


@simulated
async def test_an_object_closed_in_a_cancelled_task_is_closed_completely() -> None:
    """`asyncio.timeout` of Python 3.11.2 ends such a task before its last lines."""
    seen: list[str] = []

    async def hangs() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            seen.append("given up")

    async def fails() -> None:
        raise ValueError("gone")

    async def work() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await finish(hangs(), 1.0)
            await finish(fails(), 1.0)
            seen.append("closed")

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])
    assert seen == ["given up", "closed"]
