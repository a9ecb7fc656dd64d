"""
The journal of a fleet: readings are written to it, and outputs are supplied from it.

A reading is in `RecentPolls`, in the event loop, until the file has it. One task writes what is
there, one transaction after the other, and forces it onto the disk::

    a reading arrives         -> a transaction 0.05 s later, with all that arrived until then
    an output confirms        -> a transaction at once
    a transaction has ended   -> the disk is forced within 0.5 s; others may come before
    a transaction has failed  -> the same polls are tried again, after a pause
    the file is damaged       -> it is given another name, and a new one begins

One thread calls the methods of `JournalFile`, in order; it reads for outputs that are behind, too.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
from collections.abc import Iterable, Sequence

from ....files.schema import in_bytes, in_seconds
from ....protocol.logs import HarmlessLogger
from ....protocol.mistakes import WrongType
from ...tasks import Pauses, WriterThread, end_tasks, finish
from ..outputs.output import file_at
from ..readings import Reading
from ..statistics import JournalStatistics
from .journal_file import JournalFile, RunStart
from .journal_reader import HistoricalValue, history
from .place import JournalPlace, RecentPolls
from .schema import JournalDamaged, JournalError, JournalPoll, numbered

logger: HarmlessLogger = HarmlessLogger(__name__)

KEEP_BOUNDS = ("1 minute", "100 years")
SIZE_BOUNDS = ("10 MB", "100 TB")

# The most readings of a transaction: it takes about 0.1 s.
MOST_AT_ONCE = 20_000

# Seconds for which readings are collected, unless an output waits for its place to be written.
GATHERED_S = 0.05

# Seconds until data that were written are forced onto the disk.
FORCED_S = 0.5

# Seconds between attempts to read while the disk reports errors, and the most between those to
# write: what waits in memory may be full after seconds.
READING_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0

# Seconds that the last transaction may take, on a disk that hangs.
LAST_WAIT_S = 5.0


class Journal:
    """
    Keeps the readings of a fleet in a file, so that what an output has not confirmed is not lost
    with the program, the machine or the network.

    A reading is in the file 0.05 s after its poll, which a program that is killed cannot undo,
    and is forced onto the disk at most 0.5 s later: what a machine without power has lost is
    younger than a second. While the disk takes no readings, the newest 500000 wait in memory;
    outputs that keep up still receive them.

    The file is an SQLite database, which other programs can read at the same time.

    Args:
        path: the path of the file; its folder must exist. Two more files beside it, with -wal and
            -shm at the end of their names, belong to it.
        keep: how long readings are kept, in "1 minute".."100 years"; those that an output has not
            confirmed are kept longer.
        size: the size of the file, in "10 MB".."100 TB"; the oldest readings are deleted beyond,
            and are lost for outputs that have not confirmed them.

    Attributes:
        path: as given.
        statistics: counters.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self, path: str | os.PathLike[str], *, keep: str = "90 days", size: str = "2 GB"
    ) -> None:
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise WrongType("journal", f"must be the path of a file, not {path!r}")
        self.path: str = os.fspath(path)
        self.exclusive: tuple[str, ...] = tuple(
            file_at(f"{os.path.realpath(self.path)}{end}") for end in ("", "-wal", "-shm", "-lock")
        )
        self.statistics: JournalStatistics = JournalStatistics()
        self._file = JournalFile(
            self.path, in_seconds("keep", keep, *KEEP_BOUNDS), in_bytes("size", size, *SIZE_BOUNDS)
        )
        self._thread = WriterThread(self.path)
        self._places: list[JournalPlace] = []
        self._recent = RecentPolls(0)
        # Polls of the transaction under way, or of one that failed.
        self._batch: list[JournalPoll] = []
        self._damage: JournalDamaged | None = None
        # Set if there is something to write; and if it cannot wait for other readings.
        self._wake = asyncio.Event()
        self._hurry = asyncio.Event()
        # Done when the places are written, or cannot be.
        self._noting: asyncio.Future[None] | None = None
        self._force_at = math.inf
        self._task: asyncio.Task[None] | None = None

    def history(
        self, device: str, name: str, since: float, until: float, most: int = 1000
    ) -> list[HistoricalValue]:
        """
        Return the values of a point in the past; any thread may call this, which reads the file.

        Args:
            device, name: the names of the device and of the point.
            since, until: the first and the last time, in seconds since the epoch.
            most: the most values that are returned, 3..1000000; if there are more, of each of
                equal spans of time the smallest, the greatest, and the first that is not good.

        Returns:
            The values in the order of their times; none if there is no such device or point.

        Raises:
            JournalError: the file cannot be read.
            TypeError, ValueError: `most` has the wrong type or range.
        """
        return history(self.path, device, name, since, until, most)

    # --- life -------------------------------------------------------------------------------

    async def open(self, outputs: Sequence[str]) -> list[JournalPlace]:
        """
        Open the file, and return the place of each output; a new one begins with the next reading.

        Raises:
            JournalError: the file cannot be used; the message names it and the reason.
            RuntimeError: the journal is open already.
        """
        if self._task is not None:
            raise RuntimeError(f"the journal {self.path} is already in use; make another one")
        self._thread.start()
        try:
            try:
                start: RunStart = await self._thread.call(self._file.open, outputs)
            except JournalDamaged as error:
                start = await self._thread.call(self._file.replace, error, outputs)
        except BaseException:
            await finish(self._thread.call(self._file.close), LAST_WAIT_S)  # it may be opening
            self._thread.stop()
            raise
        self._recent = RecentPolls(start.first - 1)
        self._places = [JournalPlace(name, self, *start.places[name]) for name in outputs]
        self._task = asyncio.create_task(self._run(), name=f"journal {self.path}")
        return self._places

    async def close(self) -> None:
        """Write what waits, and close the file; a disk that hangs delays this by 5 s."""
        task, self._task = self._task, None
        if task is None:
            return
        await end_tasks([task])
        try:
            await finish(self._end(), LAST_WAIT_S)
        finally:
            self._thread.stop()

    async def _end(self) -> None:
        try:
            while self._batch or self._recent.taken < self.last:
                await self._write()
            await self._write()
        except Exception as error:
            self._note_trouble(error)
            count = self.last - self._written
            self.statistics.dropped += count
            logger.error("%s: %d readings are lost", self.path, count)
        await self._thread.call(self._file.close)

    @property
    def last(self) -> int:
        """The id of the last reading."""
        return self._recent.last

    @property
    def next_id(self) -> int:
        """The id of the next reading."""
        return self.last + 1

    def put_readings(self, readings: Iterable[Reading]) -> list[Reading]:
        """Add readings, and return them with their ids. This never blocks."""
        if self._task is None:
            return list(readings)
        numbers: list[Reading] = []
        for poll in numbered(readings, self.next_id):
            self._recent.add(poll)
            numbers += poll.readings
        count, self._recent.dropped = self._recent.dropped, 0
        if count and not self.statistics.dropped:
            logger.error(
                "%s: the disk is too slow, or takes no readings; the oldest are dropped", self.path
            )
        self.statistics.dropped += count
        for place in self._places:
            place.wake(len(numbers))
        self._wake.set()
        return numbers

    def note_places(self) -> asyncio.Future[None]:
        """Begin to write the places; return a future that is done after the attempt."""
        if self._noting is None:
            self._noting = asyncio.get_running_loop().create_future()
        self._wake.set()
        self._hurry.set()
        return self._noting

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]:
        """Return polls behind an id, and the id up to which there are no others."""
        polls = self._recent.after(number, most)
        if polls is not None:
            return polls, number
        before = min(self._recent.before, self._written)
        try:
            polls = await self._thread.call(self._file.read_polls, number, most)
        except JournalError as error:
            self._note_trouble(error)
            self._wake.set()
            await asyncio.sleep(READING_PAUSE_S)
            return [], number
        return polls, number if polls else max(number, before)

    @property
    def _written(self) -> int:
        """The last id before those that the file lacks."""
        return self._batch[0].first - 1 if self._batch else self._recent.taken

    # --- the task ---------------------------------------------------------------------------

    async def _run(self) -> None:
        pauses = Pauses(LONGEST_PAUSE_S)
        while True:
            is_force_due = await self._something_to_do()
            try:
                if self._damage is not None:
                    await self._replace(self._damage)
                if is_force_due:  # before a write that may fail
                    now = asyncio.get_running_loop().time()
                    self._force_at = now + LONGEST_PAUSE_S  # again, if this fails
                    await self._thread.call(self._file.force)
                    self._force_at = math.inf
                await self._write()
                pauses.reset()
            except Exception as error:  # a defect, too, is tried again, and shown
                self._note_trouble(error)
                self._wake.set()
                await asyncio.sleep(pauses.next())

    async def _something_to_do(self) -> bool:
        """
        Wait for readings, for a place to be written, or for the time to force the disk; return
        True if that has come.
        """
        until_force = asyncio.timeout_at(None if self._force_at == math.inf else self._force_at)
        with contextlib.suppress(TimeoutError):
            async with until_force:
                await self._wake.wait()
                async with asyncio.timeout(GATHERED_S):
                    await self._hurry.wait()
        self._wake.clear()
        self._hurry.clear()
        # A timer that has ended is due: asyncio ends timers before their time, if only by the
        # resolution of its clock.
        is_past = asyncio.get_running_loop().time() >= self._force_at
        return until_force.expired() or is_past

    async def _write(self) -> None:
        """Write polls and places in one transaction; polls that cannot be, come the next time."""
        self._batch = self._batch or self._recent.take_unwritten(MOST_AT_ONCE)
        noting, self._noting = self._noting, None
        places = {place.name: place.confirmed for place in self._places}
        confirmed_id = min(places.values(), default=self.last)
        try:
            state = await self._thread.call(
                self._file.write_polls, self._batch, places, confirmed_id
            )
        finally:
            if noting is not None and not noting.done():
                noting.set_result(None)  # outputs do not wait for a disk that takes nothing
        self.statistics.bytes = state.size
        self.statistics.written += sum(len(poll.readings) for poll in self._batch)
        if self._batch or noting is not None:
            self._force_at = min(self._force_at, asyncio.get_running_loop().time() + FORCED_S)
        self._batch = []
        if self.statistics.trouble:
            self.statistics.trouble = ""
            logger.warning("%s accepts readings again", self.path)
        for place in self._places:
            place.note_deletions(state.deleted)
            place.wake()
        if self._recent.taken < self.last or state.deleted:  # there may be more to delete
            self._wake.set()

    def _note_trouble(self, error: Exception) -> None:
        if isinstance(error, JournalDamaged):
            self._damage = error
        self.statistics.failures += 1
        message = str(error)
        if message != self.statistics.trouble:
            is_usual = isinstance(error, JournalError)
            logger.warning("%s", message, exc_info=None if is_usual else error)
        self.statistics.trouble = message

    async def _replace(self, error: JournalDamaged) -> None:
        names = [place.name for place in self._places]
        await self._thread.call(self._file.replace, error, names, self._written + 1)
        self._damage = None
