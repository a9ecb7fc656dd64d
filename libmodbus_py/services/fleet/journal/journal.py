"""
The journal of a fleet: readings are written to it, and outputs are supplied from it.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import chain
from os import PathLike, fspath

from ....protocol.logs import HarmlessLogger
from ....protocol.mistakes import WrongType
from ....tools.files.amounts import in_bytes, in_seconds
from ...tasks import end_tasks, finish
from ..outputs.exclusive import file_at
from ..outputs.writer_thread import WriterThread
from ..readings import Reading
from ..statistics import JournalStatistics
from .errors import JournalDamaged, JournalError, JournalTrouble
from .journal_file import Begun, JournalFile, JournalState, force
from .journal_reader import HistoricalValue, JournalReader, history
from .numbers import Unused
from .place import LONGEST_EPISODE, JournalPlace
from .polls import JournalPoll, numbered
from .tail import Tail

__all__ = ["KEEP_BOUNDS", "SIZE_BOUNDS", "Journal"]

logger: HarmlessLogger = HarmlessLogger(__name__)

KEEP_BOUNDS = ("1 minute", "100 years")
SIZE_BOUNDS = ("10 MB", "100 TB")

# The most readings that wait for the disk, about 75 MB; it may take none for seconds.
MOST_WAITING = 500_000

# The newest readings, kept for outputs that keep up.
MOST_IN_MEMORY = 50_000

# The most readings of a transaction.
MOST_AT_ONCE = 20_000

# Seconds for which readings are collected, unless an output waits for its place to be written.
GATHERED = 0.05

# Seconds until data that were written are forced onto the disk, if nothing else is written.
FORCED = 0.5

# Seconds between attempts while the disk does not take readings, and between those to read.
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 5.0

# Seconds that the last transaction may take, on a disk that hangs.
LAST_WAIT = 5.0


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
        self, path: str | PathLike[str], *, keep: str = "90 days", size: str = "2 GB"
    ) -> None:
        if not isinstance(path, str | PathLike) or not fspath(path):
            raise WrongType("journal", f"must be the path of a file, not {path!r}")
        self.path: str = fspath(path)
        self.exclusive: tuple[str, ...] = tuple(
            file_at(f"{self.path}{end}") for end in ("", "-wal", "-shm", "-lock")
        )
        self.statistics: JournalStatistics = JournalStatistics()
        self._file = JournalFile(
            self.path,
            in_seconds("keep", keep, *KEEP_BOUNDS),
            in_bytes("size", size, *SIZE_BOUNDS),
        )
        self._writing = WriterThread(self.path)
        self._reading = WriterThread(self.path)
        self._forcing_thread = WriterThread(self.path)
        self._reader = JournalReader(self.path)
        self._places: list[JournalPlace] = []
        self._unused = Unused()
        self._tail = Tail(MOST_IN_MEMORY, 0)
        self._queue: deque[JournalPoll] = deque()
        self._queued = 0
        # Polls of the transaction under way.
        self._batch: list[JournalPoll] = []
        self._noting: asyncio.Future[None] | None = None
        self._damage: JournalDamaged | None = None
        self._moved: str | None = None
        self._told_until = -math.inf
        self._pause = FIRST_PAUSE
        self._wake = asyncio.Event()
        self._gathering: asyncio.TimerHandle | None = None
        # Until what was written is on the disk.
        self._forcing: asyncio.TimerHandle | None = None
        self._forced: asyncio.Task[None] | None = None
        self._task: asyncio.Task[None] | None = None
        self.last: int = 0

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
        Open the file, and return the place of each output.

        An output without a place in the file begins with the next reading.

        Args:
            outputs: the names of the outputs.

        Raises:
            JournalError: the file cannot be used; the message names it and the reason.
            RuntimeError: the journal is open already.
        """
        if self._task is not None:
            raise RuntimeError(f"the journal {self.path} is already in use; make another one")
        self._start_thread(self._writing)
        try:
            self._start_thread(self._reading)
            self._start_thread(self._forcing_thread)
            begun = await self._begun(outputs)
        except BaseException as error:
            if self._reading.is_running:  # the thread may be opening the file now
                await finish(self._writing.call(self._file.close), LAST_WAIT)
            self._stop_threads()
            if isinstance(error, JournalTrouble):
                raise JournalError(str(error)) from error
            raise
        self._unused = Unused(begun.runs)
        self.last = begun.first - 1
        self._tail = Tail(MOST_IN_MEMORY, self.last)
        self._places = [JournalPlace(name, self, begun.places[name]) for name in outputs]
        self._task = asyncio.create_task(self._run(), name=f"journal {self.path}")
        return self._places

    async def _begun(self, outputs: Sequence[str]) -> Begun:
        try:
            begun: Begun = await self._writing.call(self._file.open, outputs)
        except JournalDamaged as error:
            moved = await self._writing.call(self._file.set_aside)
            _tell_replaced(error, moved)
            begun = await self._writing.call(self._file.open, outputs)
        return begun

    def _start_thread(self, thread: WriterThread) -> None:
        try:
            thread.start()
        except OSError as error:
            raise JournalError(f"{self.path}: {error.strerror}") from None

    def _stop_threads(self) -> None:
        for thread in (self._writing, self._reading, self._forcing_thread):
            if thread.is_running:
                thread.stop()

    async def close(self) -> None:
        """Write what waits, and close the file; a disk that hangs delays this by 5 s."""
        task, self._task = self._task, None
        if task is None:
            return
        await end_tasks([task])
        for timer in (self._gathering, self._forcing):
            if timer is not None:
                timer.cancel()
        if self._forced is not None:
            await end_tasks([self._forced])
        self._gathering = self._forcing = self._forced = None
        try:
            await finish(self._end(), LAST_WAIT)
        finally:
            self._settle()
            self._stop_threads()

    async def _end(self) -> None:
        try:
            while self._batch or self._queue:
                await self._write()
            await self._write()
        except JournalError as error:
            lost = self._queued + sum(len(each.readings) for each in self._batch)
            self.statistics.dropped += lost
            logger.error("%s; %d readings are lost", error, lost)
        await self._reading.call(self._reader.close)
        await self._writing.call(self._file.close)

    # --- what a fleet calls -----------------------------------------------------------------

    @property
    def next_id(self) -> int:
        """The id of the next reading."""
        return self.last + 1

    def put(self, readings: Iterable[Reading]) -> list[Reading]:
        """Add readings, and return them with their ids. This never blocks."""
        if self._task is None:
            return list(readings)
        told: list[Reading] = []
        for poll in numbered(readings, self.next_id):
            self.last = poll.last
            self._tail.add(poll)
            self._queue.append(poll)
            self._queued += len(poll.readings)
            told += poll.readings
        self._drop_oldest()
        for place in self._places:
            place.wake()
        self._gather()
        return told

    def _gather(self) -> None:
        """Write what waits after a while, together with what comes until then."""
        if self._gathering is None and self._task is not None:
            self._gathering = asyncio.get_running_loop().call_later(GATHERED, self._ring)

    def _drop_oldest(self) -> None:
        while self._queued > MOST_WAITING:
            count = len(self._queue.popleft().readings)
            self._queued -= count
            self.statistics.dropped += count
            now = asyncio.get_running_loop().time()
            if now > self._told_until:
                logger.error(
                    "%s: the disk is too slow, or takes no readings; the oldest are dropped",
                    self.path,
                )
            self._told_until = now + LONGEST_EPISODE

    # --- what places need -------------------------------------------------------------------

    def between(self, after: int, last: int) -> int:
        """Return the number of readings that have ids above `after`, up to `last`."""
        return self._unused.between(after, last)

    def note(self) -> asyncio.Future[None]:
        """Begin to write the places; return a future that ends when they are, or cannot be."""
        if self._noting is None:
            self._noting = asyncio.get_running_loop().create_future()
        self._wake.set()
        return self._noting

    async def after(self, number: int, most: int) -> tuple[list[JournalPoll], int]:
        """Return polls behind an id, and the id up to which there are no others."""
        polls = self._tail.after(number, most)
        if polls is not None:
            return polls, number
        # Those behind this id are not in the file yet.
        unwritten = next(chain(self._batch, self._queue), None)
        written = unwritten.first - 1 if unwritten else self.last
        before = min(self._tail.before, written)
        try:
            polls = await self._reading.call(self._reader.read, number, most)
        except JournalError as error:
            self._note_unread(error)
            await asyncio.sleep(FIRST_PAUSE)
            return [], number
        return polls, number if polls else max(number, before)

    def _note_unread(self, error: JournalError) -> None:
        if isinstance(error, JournalDamaged):
            self._damage = error
            self._wake.set()
        self._note_trouble(error)

    # --- the task ---------------------------------------------------------------------------

    def _ring(self) -> None:
        self._gathering = None
        self._wake.set()

    async def _run(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            try:
                if self._damage is not None:
                    await self._replace(self._damage)
                await self._write()
            except JournalDamaged as error:
                self._damage = error
                self._note_trouble(error)
                self._wake.set()
                await self._rest()
            except JournalError as error:
                self._note_trouble(error)
                self._wake.set()
                await self._rest()

    async def _rest(self) -> None:
        await asyncio.sleep(self._pause)
        self._pause = min(2 * self._pause, LONGEST_PAUSE)

    async def _write(self) -> None:
        """
        Write polls and places in one transaction.

        Raises:
            JournalError: nothing was written; the polls are written the next time.
        """
        self._take_batch()
        noting, self._noting = self._noting, None
        places = {each.name: each.confirmed for each in self._places}
        confirmed = min(places.values(), default=self.last)
        try:
            written = await self._writing.call(self._file.write, self._batch, places, confirmed)
        finally:
            if noting is not None and not noting.done():
                noting.set_result(None)  # outputs do not wait for a disk that takes nothing
        self._note_written(written)

    def _take_batch(self) -> None:
        """Move polls from the queue to the transaction, unless one is to be tried again."""
        if self._batch:
            return
        count = 0
        while self._queue and count < MOST_AT_ONCE:
            poll = self._queue.popleft()
            count += len(poll.readings)
            self._batch.append(poll)
        self._queued -= count

    def _note_written(self, written: JournalState) -> None:
        statistics = self.statistics
        statistics.bytes = written.size
        statistics.written += sum(len(each.readings) for each in self._batch)
        self._batch = []
        self._pause = FIRST_PAUSE
        if statistics.trouble:
            statistics.trouble = ""
            logger.warning("%s accepts readings again", self.path)
        for place in self._places:
            place.deleted(written.deleted)
            place.wake()
        if self._queued >= MOST_AT_ONCE or not written.is_over:
            self._wake.set()
        elif self._queue:
            self._gather()
        if self._forcing is None and self._task is not None:
            self._forcing = asyncio.get_running_loop().call_later(FORCED, self._force)

    def _force(self) -> None:
        self._forced = asyncio.create_task(self._force_onto_disk())

    async def _force_onto_disk(self) -> None:
        try:
            await self._forcing_thread.call(force, self.path)
        except JournalError as error:
            self._note_trouble(error)
        finally:
            self._forcing = None

    def _note_trouble(self, error: JournalError) -> None:
        self.statistics.failures += 1
        told = str(error)
        if told != self.statistics.trouble:
            logger.warning("%s", told)
        self.statistics.trouble = told

    async def _replace(self, error: JournalError) -> None:
        """Begin a new file in place of a damaged one."""
        places = {each.name: each.confirmed for each in self._places}
        await self._reading.call(self._reader.close)
        first = self._batch[0].first if self._batch else self.next_id
        moved = self._moved
        if moved is None:
            moved = self._moved = await self._writing.call(self._file.set_aside)
        await self._writing.call(self._file.open, places, first)
        _tell_replaced(error, moved)
        self._damage, self._moved = None, None

    def _settle(self) -> None:
        if self._noting is not None and not self._noting.done():
            self._noting.set_result(None)


def _tell_replaced(error: JournalError, moved: str) -> None:
    kept = f"it is kept as {moved}, and a" if moved else "a"
    logger.error("%s; %s new journal begins", error, kept)
