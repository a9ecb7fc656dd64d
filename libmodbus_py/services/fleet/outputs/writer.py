"""
The task that moves readings to an output, opens the output again if it fails, and finds the poll
that the other side refuses.

A poll that fails alone, with an error that is not one of the system, is refused. A connection that
ends shows nothing about what was being sent: the other side may be away. So it takes several ends
at the same poll, each right after another poll was accepted; for the next polls of that device it
takes one, until one is accepted. What is refused is logged, dropped and counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import time

from ....protocol.logs import HarmlessLogger
from ... import tasks
from ..readings import Buffer, Reading
from ..statistics import OutputStatistics
from .output import Output, OutputError, ReadingsRefused

logger: HarmlessLogger = HarmlessLogger(__name__)

# Readings of a batch: what is sent twice if its confirmation is lost.
MOST_AT_ONCE = 500

MOST_OF_JOURNAL = 5000
"""The most readings at once for an output that is fast, and behind in a journal."""

# Seconds within which such an output takes a batch; else the next ones are as small as before.
QUICK_S = 1.0

# Seconds after which an output without readings is checked by an empty write.
LONGEST_SILENCE_S = 1.0

# Connections that end at a poll, each right after another one was accepted, before it is dropped.
MOST_LOSSES = 3

# The polls behind it that are tried in turn.
MOST_OTHERS = 100


class OutputWriter:
    """Writes the readings that wait for an output, in a journal or in a buffer of its own."""

    def __init__(self, output: Output, *, waiting: Buffer | None = None) -> None:
        self.name: str = output.name
        self._most = MOST_AT_ONCE
        self._most_ever = MOST_AT_ONCE if waiting is None else MOST_OF_JOURNAL
        if waiting is None:
            waiting = Buffer(output.buffer)
        self.buffer: Buffer = waiting
        self.statistics: OutputStatistics = OutputStatistics(self.buffer)
        self._output = output
        self._pauses = tasks.Pauses()
        self._closing = asyncio.Event()
        # Polls to write one by one, and writes of several in a row that ended the connection.
        self._single = 0
        self._losses = 0
        # The poll at which a connection ended, and how often since, behind another one.
        self._suspect: tuple[str, float] | None = None
        self._ends = 0
        # Which of the polls behind it is written first; True if this connection accepted any.
        self._at = 0
        self._has_accepted = False
        # Devices whose last poll was refused, and True if that was a moment ago.
        self._refused: set[str] = set()
        self._may_open_at_once = False

    def start(self) -> None:
        self.task: asyncio.Task[None] = asyncio.create_task(self._run(), name=self.name)

    def close_writer(self, *, is_patient: bool = False) -> None:
        """
        Write the readings that wait, and end after a failure, or two seconds unless it is patient.
        """
        self.buffer.close_buffer()
        self._closing.set()
        if not is_patient:
            self._end_after(tasks.FINISHING_S)

    def _end_after(self, seconds: float) -> None:
        ending = asyncio.get_running_loop().call_later(seconds, self._end)
        self.task.add_done_callback(lambda task: ending.cancel())

    def _end(self) -> None:
        self.task.cancel()
        self._end_after(tasks.AGAIN)  # the client of an output may lose this cancellation

    async def _run(self) -> None:
        try:
            while not await self._give_readings():
                if not self._may_open_at_once:
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(self._pauses.next()):
                            await self._closing.wait()
                self._may_open_at_once = False
        finally:
            self.buffer.give_up()

    async def _give_readings(self) -> bool:
        """Write readings until the output fails; return True if the writer is to end."""
        try:
            await self._output.open_output()
            self._has_accepted = False
            while not self.buffer.is_over:
                await self._write_another()
                most = 1 if self._single else self._most
                batch = await self.buffer.take_polls(most, LONGEST_SILENCE_S)
                self.statistics.note_batch(len(batch))
                if _polls(batch) > 1 and any(reading.device in self._refused for reading in batch):
                    self.buffer.put_back(batch)
                    self._single = _polls(batch)
                else:
                    await self._write_readings(batch)
            return True
        except OutputError as error:
            self.statistics.trouble, self.statistics.trouble_since = _message(error), time.time()
            raise
        except Exception as error:
            self._note_trouble(error)
            # Others are written after readings that are refused, also the last ones.
            return self._closing.is_set() and not isinstance(error, ReadingsRefused)
        finally:
            try:
                await self._output.close_output()
            except Exception as error:
                self._note_trouble(error)

    async def _write_another(self) -> None:
        """
        Write another poll before the suspected one, to see whether the other side is there.

        It stays in the buffer: sent again in its turn, it is the newest of its device in the end.
        """
        if self._suspect is None or self._has_accepted:
            return
        first, *others = await self.buffer.polls(self._at + 2) or [[]]
        if not first or first[0].poll != self._suspect:  # there was no room for it
            self._suspect = None
        elif others:
            at = self._at % len(others)
            self._at = (at + 1) % MOST_OTHERS  # if it is lost, too, the next time it is another
            await self._output.write_readings(others[at])
            self._at = at
            self._has_accepted = True
            self._pauses.reset()

    async def _write_readings(self, batch: list[Reading]) -> None:
        start_time = asyncio.get_running_loop().time()
        most, self._most = self._most, MOST_AT_ONCE
        try:
            await self._output.write_readings([*batch])  # which may change the list
        except BaseException as error:
            self._note_failure(batch, error)
            raise
        is_quick = asyncio.get_running_loop().time() - start_time < QUICK_S
        if is_quick and len(batch) > most // 2:
            self._most = min(2 * most, self._most_ever)
        await self.buffer.confirm_readings(batch)
        if batch:
            self._losses = 0
            self._has_accepted = True
            self._refused.difference_update(reading.device for reading in batch)
        self._single = max(0, self._single - 1)
        self.statistics.written += len(batch)
        if self.statistics.trouble:
            self.statistics.trouble = ""
            self._pauses.reset()
            logger.warning("%s accepts readings again", self.name)

    def _note_failure(self, batch: list[Reading], error: BaseException) -> None:
        """Put readings back, or drop them if they are one poll that is refused."""
        polls = _polls(batch)
        is_loss = isinstance(error, ConnectionError)
        is_odd = isinstance(error, Exception) and not isinstance(error, OSError | OutputError)
        if is_odd and self._single and batch:
            self._drop_readings(batch, str(error))
        elif is_loss and polls == 1 and self._is_refused(batch[0]):
            self._refused.add(batch[0].device)
            self._may_open_at_once = True
            self._drop_readings(
                batch, f"others were accepted and these were not, several times: {error}"
            )
        else:
            self.buffer.put_back(batch)
            self._losses += is_loss and bool(batch)
            if is_odd or (is_loss and polls > 1 and self._losses > 1):
                self._single = polls

    def _is_refused(self, reading: Reading) -> bool:
        """Count a connection that ended at one poll; return True if the poll is to be dropped."""
        if self._suspect != reading.poll:
            self._suspect, self._ends = reading.poll, 0
        else:
            self._ends += self._has_accepted
        most = 0 if reading.device in self._refused else MOST_LOSSES
        return self._has_accepted and self._ends >= most

    def _drop_readings(self, batch: list[Reading], reason: str) -> None:
        self._single = max(0, self._single - 1)
        self.buffer.drop_readings(batch)
        device, count = batch[0].device, len(batch)
        logger.error("%s: %d readings of %s are dropped: %s", self.name, count, device, reason)

    def _note_trouble(self, error: Exception) -> None:
        self.statistics.failures += 1
        message = _message(error)
        if message != self.statistics.trouble:
            is_usual = isinstance(error, OSError | ReadingsRefused)
            logger.warning("%s: %s", self.name, message, exc_info=None if is_usual else error)
        if not self.statistics.trouble:
            self.statistics.trouble_since = time.time()
        self.statistics.trouble = message


def _polls(readings: list[Reading]) -> int:
    return len({reading.poll for reading in readings})


def _message(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or type(error).__name__
