"""
The task that moves readings to an output, opens the output again if it fails, and finds the poll
that the other side refuses by ending the connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence

from ....protocol.logs import HarmlessLogger
from ...tasks import AGAIN, Pauses, finishing
from ..readings import MOST_KEPT, Buffer, Reading
from ..statistics import OutputStatistics
from .output import Output, OutputError, ReadingsRefused

__all__ = ["Pump", "Refusals"]


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
    """Writes the readings that wait for an output, in a journal or in a buffer of its own."""

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
        """Wait for the end of the task; raise OutputError if the output failed permanently."""
        await asyncio.shield(self.task)

    def close(self, *, is_patient: bool = False) -> None:
        """
        Write the readings that wait, and end after a failure, or two seconds unless it is patient.
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
        except OutputError as error:
            self.statistics.trouble, self.statistics.trouble_since = _message(error), time.time()
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
            await self._output.write([*batch])  # which may change the list
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
            self._drop(batch, f"others were accepted and these were not, several times: {error}")
            self._may_open_at_once = True
            return
        self.buffer.put_back(batch)
        self._losses += 1
        polls = len({each.poll for each in batch})
        if polls > 1 and self._losses > 1:  # one of them may be the reason
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


# Connections that end at a poll, each right after another one was accepted, before it is dropped;
# one of a device whose last poll was dropped is dropped after one.
MOST_LOSSES = 3


class Refusals:
    """
    Finds out whether the first poll that waits is refused.

    A connection that ends while readings are sent shows nothing about them: the other side may be
    away. They are refused if others are accepted right before, several times.
    """

    def __init__(self, waiting: Buffer) -> None:
        self._waiting = waiting
        # The poll at which a connection ended, and how often others ended at it since, each behind
        # another poll; the position of that one behind it.
        self._suspect: tuple[str, float] | None = None
        self._losses = 0
        self._at = 0
        # Devices whose last poll was dropped, and whether this connection accepted anything.
        self._known: set[str] = set()
        self._has_accepted = False

    def note_open(self) -> None:
        """Note another connection."""
        self._has_accepted = False

    def note_accepted(self, readings: Sequence[Reading]) -> None:
        """Note readings that were accepted; their devices are as good as others then."""
        self._has_accepted |= bool(readings)
        if self._known:
            self._known -= {each.device for each in readings}

    def is_refused(self, readings: Sequence[Reading]) -> bool:
        """Note that a connection ended at readings; return True if they are one poll to drop."""
        first = readings[0]
        if any(each.poll != first.poll for each in readings):
            return False
        if self._suspect != first.poll:
            self._suspect, self._losses = first.poll, 0
        elif self._has_accepted:
            self._losses += 1
        is_known = first.device in self._known
        is_refused = self._has_accepted if is_known else self._losses >= MOST_LOSSES
        if is_refused:
            self._known.add(first.device)
        return is_refused

    def is_doubtful(self, readings: Sequence[Reading]) -> bool:
        """Return True for several polls, of which one is likely to be refused."""
        if not self._known or all(each.device not in self._known for each in readings):
            return False
        return any(each.poll != readings[0].poll for each in readings)

    async def others(self) -> list[Reading]:
        """
        Return another poll, to be sent before the suspected one; none if there is no reason to.

        It is not taken: sent again in its turn, it is the newest of its device in the end.
        """
        if self._suspect is None or self._has_accepted:
            return []
        first, *others = await self._waiting.polls(self._at + 2) or [[]]
        if not first or first[0].poll != self._suspect:  # there was no room for it
            self._suspect = None
            return []
        if len(others) <= self._at:
            self._at = 0
        return others[self._at] if others else []

    def note_other(self, *, is_accepted: bool) -> None:
        """Note what became of the other poll; if it was lost too, the next time it is another."""
        self._has_accepted = is_accepted
        if not is_accepted:
            self._at += 1
