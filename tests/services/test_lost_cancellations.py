"""
Cancellations that arrive at the moment at which what is waited for happens.

`asyncio.wait_for` of Python 3.11 loses them; the libraries of MQTT and NATS use it.
"""

import asyncio
from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.writer import OutputWriter
from libmodbus_py.services.tasks import AGAIN, FINISHING_S
from tests.simulation.runner import simulated
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
    writer = OutputWriter(Careless(2))
    writer.buffer.put_readings([reading("a", "one")])
    writer.start()
    await asyncio.sleep(1)
    writer.close_writer()
    before = asyncio.get_running_loop().time()
    with pytest.raises(asyncio.CancelledError):
        await writer.task
    assert asyncio.get_running_loop().time() - before == FINISHING_S + 2 * AGAIN


@simulated
async def test_a_cancellation_is_not_lost_while_a_writer_pauses() -> None:
    writer = OutputWriter(FakeOutput(refused=("a",), error=OSError("away")))
    writer.buffer.put_readings([reading("a", "one")])
    writer.start()
    await asyncio.sleep(0.1)
    writer.close_writer(is_patient=True)
    writer.task.cancel()
    await asyncio.wait([writer.task])
    assert writer.task.cancelled()
