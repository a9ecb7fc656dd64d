"""
Outputs that a pump writes to, or a test directly.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.output import Output
from libmodbus_py.services.fleet.outputs.pump import Pump
from libmodbus_py.services.fleet.readings import MOST_KEPT

__all__ = ["pumping", "write"]


@asynccontextmanager
async def pumping(output: Output, most: int = MOST_KEPT) -> AsyncIterator[Pump]:
    """Write what is put into the buffer of a pump, also at the end of the block."""
    pump = Pump(output, most)
    pump.start()
    yield pump
    pump.close()
    await pump.ended()


async def write(output: Output, *polls: Sequence[Reading]) -> None:
    """Open an output, write readings in so many calls, and close it."""
    await output.open()
    try:
        for each in polls:
            await output.write(each)
    finally:
        await output.close()
