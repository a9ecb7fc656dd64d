"""Outputs that a writer writes to, or a test directly, and one that takes what it likes."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.output import Output
from libmodbus_py.services.fleet.outputs.writer import OutputWriter
from libmodbus_py.services.fleet.readings import MOST_KEPT


def reading(device: str, name: str, value: Any = 1, time: float = 100.0) -> Reading:
    return Reading(time, device, name, value, "V", "good")


class FakeOutput(Output):
    """
    An output that takes what it likes. `is_away`: True while it can neither be opened nor written
    to; `next`: what the next writes do: an exception to raise, or seconds to take; `refused`:
    devices; a write with readings of one raises `error`; `batches`: the readings of each write that
    succeeded; `failed`: the number of writes that were refused; `opened_at`: the times of the loop
    at which it was opened.
    """

    def __init__(
        self,
        name: str = "fake",
        *,
        is_away: bool = False,
        next: Sequence[BaseException | float] = (),
        refused: Sequence[str] = (),
        error: BaseException | None = None,
        buffer: int = MOST_KEPT,
    ) -> None:
        self.name = name
        self.is_away = is_away
        self.next = [*next]
        self.refused = refused
        self.error = error or ValueError("too long")
        self.buffer = buffer
        self.batches: list[list[Reading]] = []
        self.failed = 0
        self.opened_at: list[float] = []
        self.closed = 0

    @property
    def accepted(self) -> list[Reading]:
        return [reading for batch in self.batches for reading in batch]

    @property
    def ids(self) -> list[int]:
        return [reading.id for reading in self.accepted]

    async def open_output(self) -> None:
        if self.is_away:
            raise ConnectionRefusedError(111, "Connection refused")
        self.opened_at.append(asyncio.get_running_loop().time())

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        if self.is_away:
            raise ConnectionResetError("away")
        if not readings:
            return
        if self.next:
            manner = self.next.pop(0)
            if isinstance(manner, BaseException):
                raise manner
            await asyncio.sleep(manner)
        if any(reading.device in self.refused for reading in readings):
            self.failed += 1
            raise self.error
        self.batches.append([*readings])

    async def close_output(self) -> None:
        self.closed += 1


@asynccontextmanager
async def output_writer(output: Output) -> AsyncIterator[OutputWriter]:
    """Write what is put into the buffer of a writer, also at the end of the block."""
    writer = OutputWriter(output)
    writer.start()
    yield writer
    writer.close_writer()
    await writer.task


async def write_readings(output: Output, readings: Sequence[Reading]) -> OutputWriter:
    """Write readings until each was written or dropped, in simulated time."""
    async with output_writer(output) as writer:
        writer.buffer.put_readings(readings)
        while writer.statistics.written + writer.statistics.dropped < len(readings):
            await asyncio.sleep(0.01)
    return writer


async def write(output: Output, *polls: Sequence[Reading]) -> None:
    """Open an output, write readings in so many calls, and close it."""
    await output.open_output()
    try:
        for poll in polls:
            await output.write_readings(poll)
    finally:
        await output.close_output()
