"""
All that receive the readings of a fleet: the journal, outputs, and iterators of the program.

Outputs read from the journal, if there is one, so that nothing is lost while they are away.
Others, and iterators, have a buffer of their own.
"""

from __future__ import annotations

import asyncio
import contextlib
import weakref
from collections import Counter
from collections.abc import AsyncIterator, Collection, Iterable, Mapping, Sequence
from typing import Any, Self

from ...protocol.logs import HarmlessLogger
from .commands import Commands
from .config import DeviceConfig
from .journal.journal import Journal
from .journal.place import JournalPlace
from .outputs.output import Output, check_exclusive
from .outputs.pump import Pump
from .readings import Buffer, Reading
from .statistics import FleetStatistics

__all__ = ["Readings", "Receivers"]

logger: HarmlessLogger = HarmlessLogger(__name__)


class Readings(AsyncIterator[Reading]):
    """An asynchronous iterator over the readings of a fleet."""

    def __init__(self, buffer: Buffer) -> None:
        self._buffer = buffer

    @property
    def dropped(self) -> int:
        """Number of readings dropped because the buffer was full."""
        return self._buffer.dropped

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Reading:
        while not self._buffer.is_over:
            if found := await self._buffer.take(1):
                return found[0]
        raise StopAsyncIteration


class Receivers:
    """Passes readings on to the outputs of a fleet and to its iterators."""

    def __init__(
        self, outputs: Sequence[Output], journal: Journal | None, statistics: FleetStatistics
    ) -> None:
        self.outputs: list[Output] = list(outputs)
        check_exclusive(self.outputs, journal)
        self._journal = journal
        self._statistics = statistics
        statistics.journal = journal.statistics if journal else None
        self._pumps: list[Pump] = []
        # Of outputs that read nothing from the journal.
        self._live: list[Buffer] = []
        self._iterated: weakref.WeakSet[Buffer] = weakref.WeakSet()

    @property
    def next_id(self) -> int:
        """The id of the next reading; 0 without a journal."""
        return self._journal.next_id if self._journal else 0

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Pass the devices to the outputs; raise ValueError if one lacks a label."""
        for output in self.outputs:
            if (describe := getattr(output, "describe", None)) is not None:
                describe(devices)

    async def start(self, commands: Commands) -> None:
        """Open the journal and start the outputs; raise JournalError if it cannot be used."""
        places = await self._places()
        names = _unlike(each.name for each in self.outputs)
        for at, output in enumerate(self.outputs):
            attach = getattr(output, "attach", None)
            if attach is not None and getattr(output, "takes_commands", False):
                attach(commands)
            pump = Pump(output, waiting=places.get(at))
            self._statistics.outputs[names[at]] = pump.statistics
            self._pumps.append(pump)
            if at not in places:
                self._live.append(pump.buffer)
            pump.start()

    async def _places(self) -> Mapping[int, JournalPlace]:
        """Open the journal; return the places of the outputs that read from it, by their index."""
        if self._journal is None:
            return {}
        names = _unlike(getattr(each, "identity", each.name) for each in self.outputs)
        kept = {
            at: names[at]
            for at, output in enumerate(self.outputs)
            if not getattr(output, "is_live", False)
        }
        return dict(zip(kept, await self._journal.open([*kept.values()]), strict=True))

    def put(self, readings: list[Reading]) -> None:
        if not readings:
            return
        self._statistics.readings += len(readings)
        if self._journal is not None:
            readings = self._journal.put(readings)
        for buffer in (*self._live, *self._iterated):
            buffer.put(readings)

    def iterate(self, most: int) -> Readings:
        """Return the readings from now on; the oldest of more than so many are dropped."""
        buffer = Buffer(most)
        self._iterated.add(buffer)
        return Readings(buffer)

    def log_ends(self) -> None:
        """Log an output that fails permanently: the program does not wait for its error."""
        for pump in self._pumps:
            pump.task.add_done_callback(_log_end)

    async def ended(self, event: asyncio.Event) -> None:
        """
        Wait for an event, or for an output that fails permanently, which raises its OutputError.
        """
        ends: list[asyncio.Future[Any]] = [
            *(asyncio.ensure_future(each.ended()) for each in self._pumps),
            asyncio.ensure_future(event.wait()),
        ]
        try:
            done, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            for each in done:
                each.result()
        finally:
            for each in ends:
                each.cancel()
            await asyncio.gather(*ends, return_exceptions=True)

    async def stop(self, closing: Collection[asyncio.Task[None]], *, is_patient: bool) -> None:
        """
        Let the outputs write what waits, only until a failure if patient, and close the journal.
        """
        for buffer in self._iterated:
            buffer.close()
        for pump in self._pumps:
            pump.close(is_patient=is_patient)
        try:
            # A second cancellation ends the outputs at once.
            with contextlib.suppress(asyncio.InvalidStateError):
                tasks = [*closing, *(pump.task for pump in self._pumps)]
                await asyncio.gather(*tasks, return_exceptions=True)
        finally:
            for pump in self._pumps:
                pump.task.cancel()
            self._pumps, self._live = [], []
            if self._journal is not None:
                await self._journal.close()


def _log_end(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        logger.error("%s gets no more readings: %s", task.get_name(), error)


def _unlike(names: Iterable[str]) -> list[str]:
    """Return names with numbers behind those that others have too."""
    counts: Counter[str] = Counter()
    found: list[str] = []
    for name in names:
        counts[name] += 1
        found.append(f"{name} ({counts[name]})" if counts[name] > 1 else name)
    return found
