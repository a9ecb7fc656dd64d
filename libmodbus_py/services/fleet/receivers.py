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
from collections.abc import Collection, Iterable, Mapping, Sequence

from ...protocol.logs import HarmlessLogger
from ...protocol.mistakes import WrongType
from .commands import Commands
from .config import DeviceConfig
from .journal.journal import Journal
from .outputs.output import Output, check_exclusive
from .outputs.writer import OutputWriter
from .readings import Buffer, Reading
from .statistics import FleetStatistics

logger: HarmlessLogger = HarmlessLogger(__name__)


class Receivers:
    """Passes readings on to the outputs of a fleet and to its iterators."""

    def __init__(
        self, outputs: Sequence[Output], journal: Journal | None, statistics: FleetStatistics
    ) -> None:
        self.outputs: list[Output] = _checked(outputs)
        if not isinstance(journal, Journal | None):
            raise WrongType("journal", f"must be a Journal, not {type(journal).__name__}")
        check_exclusive(self.outputs, () if journal is None else journal.exclusive)
        self._journal = journal
        self._statistics = statistics
        statistics.journal = journal.statistics if journal else None
        self._writers: list[OutputWriter] = []
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
            output.describe_devices(devices)

    async def start(self, commands: Commands) -> None:
        """Open the journal and start the outputs; raise JournalError if it cannot be used."""
        names = _unlike(output.name for output in self.outputs)
        places: dict[int, Buffer] = {}
        if self._journal is not None:
            identities = _unlike(output.identity for output in self.outputs)
            at = [i for i, output in enumerate(self.outputs) if not output.is_live]
            buffers = await self._journal.open([identities[number] for number in at])
            places = dict(zip(at, buffers, strict=True))
        for number, output in enumerate(self.outputs):
            if output.takes_commands:
                output.attach_commands(commands)
            writer = OutputWriter(output, waiting=places.get(number))
            self._statistics.outputs[names[number]] = writer.statistics
            self._writers.append(writer)
            if number not in places:
                self._live.append(writer.buffer)
            writer.start()

    def put_readings(self, readings: list[Reading]) -> None:
        if not readings:
            return
        self._statistics.readings += len(readings)
        if self._journal is not None:
            readings = self._journal.put_readings(readings)
        for buffer in self._live:
            buffer.put_readings(readings)
        if self._iterated:  # a loop over weak references costs a microsecond, even over none
            for buffer in self._iterated:
                buffer.put_readings(readings)

    def iterate(self, most: int) -> Buffer:
        """Return the readings from now on; the oldest of more than so many are dropped."""
        buffer = Buffer(most)
        self._iterated.add(buffer)
        return buffer

    def log_ends(self) -> None:
        """Log an output that fails permanently: the program does not wait for its error."""
        for writer in self._writers:
            writer.task.add_done_callback(_log_end)

    async def wait_for_end(self, event: asyncio.Event) -> None:
        """Wait for an event, or for an output that fails permanently: raise its OutputError."""
        waiting = asyncio.create_task(event.wait())
        try:
            tasks = [waiting, *(writer.task for writer in self._writers)]
            ends, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in ends:
                task.result()
        finally:
            waiting.cancel()

    async def stop(self, closing: Collection[asyncio.Task[None]], *, is_patient: bool) -> None:
        """Let the outputs write what waits, until a failure if patient, and close the journal."""
        for buffer in self._iterated:
            buffer.close_buffer()
        for writer in self._writers:
            writer.close_writer(is_patient=is_patient)
        try:
            # A second cancellation ends the outputs at once.
            with contextlib.suppress(asyncio.InvalidStateError):
                tasks = [*closing, *(writer.task for writer in self._writers)]
                await asyncio.gather(*tasks, return_exceptions=True)
        finally:
            for writer in self._writers:
                writer.task.cancel()
            self._writers, self._live = [], []
            if self._journal is not None:
                await self._journal.close()


def _log_end(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        logger.error("%s gets no more readings: %s", task.get_name(), error)


def _checked(outputs: object) -> list[Output]:
    if isinstance(outputs, str | bytes) or not isinstance(outputs, Iterable):
        raise WrongType("outputs", f"must be a list of outputs, not {type(outputs).__name__}")
    result = list(outputs)
    for at, output in enumerate(result):
        if not isinstance(output, Output):
            raise WrongType(("outputs", at), f"must be an Output, not {type(output).__name__}")
    return result


def _unlike(names: Iterable[str]) -> list[str]:
    """Return names with numbers behind those that others have too."""
    counts: Counter[str] = Counter()
    result: list[str] = []
    for name in names:
        counts[name] += 1
        result.append(f"{name} ({counts[name]})" if counts[name] > 1 else name)
    return result
