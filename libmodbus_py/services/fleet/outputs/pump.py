"""
The task that moves readings to an output, and opens the output again if it fails.
"""

from __future__ import annotations

import asyncio
import contextlib
import time

from ....protocol.logs import HarmlessLogger
from ...tasks import AGAIN, Pauses, finishing
from ..buffer import MOST_KEPT, Buffer
from ..readings import Reading
from ..statistics import OutputStatistics
from .output import Output, OutputError, ReadingsRefused
from .refusals import Refusals

__all__ = ["Pump"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Readings of a batch: what is sent twice if its confirmation is lost.
MOST_AT_ONCE = 500

MOST_OF_JOURNAL = 5000
"""The most readings at once for an output that is fast, and behind in a journal."""

# Seconds within which such an output takes a batch; else the next ones are as small as before.
QUICK_S = 1.0

# Seconds after which an output without readings is checked by an empty write.
LONGEST_SILENCE_S = 1.0


class Pump:
    """
    Writes the readings that wait for an output.

    Args:
        output: the output.
        most: the most readings that a buffer keeps, unless the output has an attribute `buffer`.
        waiting: the readings, from a journal; None for a buffer.
    """

    def __init__(
        self, output: Output, most: int = MOST_KEPT, *, waiting: Buffer | None = None
    ) -> None:
        self.name: str = output.name
        self._most = MOST_AT_ONCE
        self._may_grow = waiting is not None
        if waiting is None:
            waiting = Buffer(getattr(output, "buffer", most))
        self.buffer: Buffer = waiting
        self.statistics: OutputStatistics = OutputStatistics(self.buffer)
        self._output = output
        self._pauses = Pauses()
        # Polls to write one by one, because one of them may be impossible to write.
        self._doubted = 0
        # Writes in a row during which the connection was lost.
        self._losses = 0
        self._refusals = Refusals(self.buffer)
        self._closing = asyncio.Event()
        # True after a poll was refused while others were accepted: the other side is there.
        self._may_open_at_once = False

    def start(self) -> None:
        """Start the task."""
        self.task: asyncio.Task[None] = asyncio.create_task(self._run(), name=self.name)

    async def ended(self) -> None:
        """
        Wait for the end of the task.

        Raises:
            OutputError: the output failed permanently.
        """
        await asyncio.shield(self.task)

    def close(self, *, is_patient: bool = False) -> None:
        """
        Write the readings that wait, and end after two seconds or a failure.

        Args:
            is_patient: True to end only after a failure.
        """
        self.buffer.close()
        self._closing.set()
        if is_patient:
            return
        self._end_after(finishing())

    def _end_after(self, seconds: float) -> None:
        ending = asyncio.get_running_loop().call_later(seconds, self._end)
        self.task.add_done_callback(lambda task: ending.cancel())

    def _end(self) -> None:
        self.task.cancel()
        self._end_after(AGAIN)  # the client of an output may lose this cancellation

    async def _run(self) -> None:
        try:
            while not await self._give():
                if not self._may_open_at_once:
                    await self._rest()
                self._may_open_at_once = False
        finally:
            self.buffer.give_up()

    async def _give(self) -> bool:
        """Write readings until the output fails; return True if the pump is to end."""
        try:
            await self._output.open()
            self._refusals.note_open()
            while not self.buffer.is_over:
                await self._write_other()
                most = 1 if self._doubted else self._most
                batch = await self.buffer.take_polls(most, LONGEST_SILENCE_S)
                if self._refusals.is_doubtful(batch):
                    self._doubt(batch)
                else:
                    await self._write(batch)
            return True
        except OutputError:
            raise
        except Exception as error:
            self._note_trouble(error)
            # Others are written after readings that are refused, also the last ones.
            return self._closing.is_set() and not isinstance(error, ReadingsRefused)
        finally:
            await self._close_output()

    async def _close_output(self) -> None:
        try:
            await self._output.close()
        except Exception as error:
            self._note_trouble(error)

    async def _write_other(self) -> None:
        """Write another poll before one that may be refused."""
        others = await self._refusals.others()
        if not others:
            return
        is_accepted = False
        try:
            await self._output.write(others)
            is_accepted = True
            self._pauses.reset()
        finally:
            self._refusals.note_other(is_accepted=is_accepted)

    async def _write(self, batch: list[Reading]) -> None:
        begun = asyncio.get_running_loop().time()
        self._most, most = MOST_AT_ONCE, self._most
        try:
            await self._output.write(batch)
        except ConnectionError as error:
            self._note_loss(batch, error)
            raise
        except BaseException as error:
            if isinstance(error, Exception) and not isinstance(error, OSError | OutputError):
                self._note_doubt(batch, error)
            else:
                self.buffer.put_back(batch)
            raise
        is_quick = asyncio.get_running_loop().time() - begun < QUICK_S
        if self._may_grow and is_quick and len(batch) > most // 2:
            self._most = min(2 * most, MOST_OF_JOURNAL)
        await self.buffer.confirm(batch)
        if batch:
            self._losses = 0
        self._refusals.note_accepted(batch)
        self._doubted = max(0, self._doubted - 1)
        self.statistics.written += len(batch)
        if self.statistics.trouble:
            self.statistics.trouble = ""
            self._pauses.reset()
            logger.warning("%s accepts readings again", self.name)

    def _note_loss(self, batch: list[Reading], error: ConnectionError) -> None:
        """Put readings back; drop a poll that is refused while others are accepted."""
        if not batch:
            return
        if self._refusals.is_refused(batch):
            self._refusals.note_dropped(batch[0].device)
            self._drop(batch, f"others were accepted and these were not, several times: {error}")
            self._may_open_at_once = True
            return
        self.buffer.put_back(batch)
        self._losses += 1
        polls = len({each.poll for each in batch})
        if polls == 1:
            self._refusals.suspect(batch)
        elif self._losses > 1:  # one of them may be the reason
            self._doubted = polls

    def _note_doubt(self, batch: list[Reading], error: Exception) -> None:
        """Put readings back; drop them if they are one poll that failed before."""
        if self._doubted and batch:
            self._drop(batch, str(error))
            return
        self._doubt(batch)

    def _doubt(self, batch: list[Reading]) -> None:
        """Put readings back, to be written poll by poll."""
        self.buffer.put_back(batch)
        self._doubted = len({each.poll for each in batch})

    def _drop(self, batch: list[Reading], reason: str) -> None:
        self._doubted = max(0, self._doubted - 1)
        self.buffer.drop(batch)
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

    async def _rest(self) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._pauses.next()):
                await self._closing.wait()


def _message(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or type(error).__name__
