"""
Cancellations that arrive at the moment at which what is waited for happens.

`asyncio.wait_for` of Python 3.11 loses them; the libraries of MQTT and NATS use it.
"""

import asyncio
from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.pump import Pump
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
async def test_a_cancellation_is_not_lost_while_a_pump_rests() -> None:
    pump = Pump(FakeOutput(refused=("a",), error=OSError("away")))
    pump.buffer.put_readings([reading("a", "one")])
    pump.start()
    await asyncio.sleep(0.1)
    pump.close_pump(is_patient=True)
    pump.task.cancel()
    await asyncio.wait([pump.task])
    assert pump.task.cancelled()
