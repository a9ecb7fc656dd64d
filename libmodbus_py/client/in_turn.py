"""
One request at a time, on framings without transaction ids.

Nothing tells a late answer of a unit from its next one there. So after a failure the line
must have been quiet for one timeout before the same unit is asked again; an answer of
another unit is told by its unit, and a collision by its check bytes.
"""

from __future__ import annotations

from typing import Any

from ..ports.port import Silence
from ..protocol.errors import FrameError, InvalidResponse, ModbusError
from ..protocol.framing import AsciiFramer, Frame, Framer, make_framer
from ..protocol.pdu import Diagnostics, SubFunction
from .batch import Batch, Pending, Reply
from .conversation import Conversation, no_answer

__all__ = ["InTurn"]

# A unit that answers twice may be later with the copy than 3.5 characters.
SHORTEST_COPY, LONG_SILENCE, LONG_MEMORY = 4, 0.02, 60.0

# What errors can carry, and more than a late answer has: the rest is more of the same.
MAX_KEPT = 600


class InTurn(Conversation):
    """
    See `Conversation`.

    Args:
        silence: of the port.
        delimiter: the byte behind CR in ASCII frames.
    """

    def __init__(self, *args: Any, silence: Silence, delimiter: int = 0x0A, **options: Any) -> None:
        self._silence = silence
        self._delimiter = delimiter
        self._asked: Pending | None = None
        self._wrong: ModbusError | None = None  # what came in place of its answer so far
        self._came_early = False  # an answer came before its request can have left
        self._received = bytearray()
        self._late = bytearray()
        self._quiet_at: float | None = None
        # Unit -> when it may be asked again, and the timeout that it had.
        self._doubts: dict[int, tuple[float, float]] = {}
        # Since when a batch waits for silence.
        self._waiting: dict[Batch, float] = {}
        self._is_exact = False  # the last answer came with nothing before it or behind it
        self._is_noisy = False  # something on this connection did not
        self._doubled_until = 0.0  # so long as answers came that nobody asked for or owed
        super().__init__(*args, **options)

    def _make_framer(self) -> Framer:
        framer = make_framer(self._framing, "client")
        if isinstance(framer, AsciiFramer):
            framer.delimiter = self._delimiter
        return framer

    @property
    def is_plain(self) -> bool:
        return self._is_exact and not (
            self._is_noisy
            or self._trace.is_on
            or self._asked
            or self._doubts
            or self._queue
            or self._repeats
            or self._silent
        )

    def next_number(self) -> int:
        return 0

    def _register(self, batch: Batch, adu: bytes, now: float) -> None:
        self._ask(batch, 0, adu, now)

    def opened(self, now: float) -> None:
        self._is_exact = self._is_noisy = False
        self._doubled_until = 0.0
        super().opened(now)

    # --- asking --------------------------------------------------------------------------

    def _pick(self, now: float) -> Batch | None:
        if now < self._silence.over_at and not self._late:
            self._wake(self._silence.over_at)
            return None
        for batch in list(self._queue):
            if not batch.has_next:
                self._queue.remove(batch)
                batch.queued = False
            elif self._may_ask(batch.unit, now):
                self._queue.remove(batch)
                return batch
            elif (error := self._impatience(batch, now)) is not None:
                self._fail_next(batch, error)
        return None

    def _may_ask(self, unit: int, now: float) -> bool:
        if now < self._silence.over_at:
            self._wake(self._silence.over_at)
            return False
        ready_at = self._ready_at(unit)
        if ready_at > now:
            self._wake(ready_at)
        return ready_at <= now

    def _ready_at(self, unit: int) -> float:
        """A broadcast is for all units, so it waits for all."""
        doubts = self._doubts.values() if unit == 0 else [self._doubts.get(unit, (0.0, 0.0))]
        return max((ready_at for ready_at, _ in doubts), default=0.0)

    def _impatience(self, batch: Batch, now: float) -> ModbusError | None:
        """Not for ever; from who sends more than a late answer, not longer than for an answer."""
        timeout = batch.timeouts.timeout
        since = self._waiting.setdefault(batch, now)
        limit = since + timeout * (1 if len(self._late) >= MAX_KEPT else 2)
        if limit > now:
            self._wake(limit)
            return None
        del self._waiting[batch]
        return FrameError("the line does not fall silent", received=bytes(self._late))

    def _begin(self, batch: Batch, index: int, now: float) -> Pending:
        if self._is_noisy or self._framer.pending:
            self._framer = self._make_framer()
        adu = self._framer.encode(Frame(batch.unit, batch.pdus[index]))
        return self._ask(batch, index, adu, now)

    def _ask(self, batch: Batch, index: int, adu: bytes, now: float) -> Pending:
        self._end_doubt(batch.unit)
        self._waiting.pop(batch, None)
        self._received.clear()
        self._late.clear()
        self._quiet_at = None
        self._silence.sent(len(adu), now)
        self._wrong = None
        self._came_early = False
        asked = Pending(batch, index, adu, now)
        if not (batch.silent and batch.silent[index]):
            self._asked = asked
        return asked

    def _end_doubt(self, unit: int) -> None:
        if unit == 0:
            self._doubts.clear()
        else:
            self._doubts.pop(unit, None)

    # --- bytes ----------------------------------------------------------------------------

    def _take(self, data: bytes, now: float) -> None:
        if self._asked is None and not self._doubts and len(data) >= SHORTEST_COPY:
            self._doubled_until = now + LONG_MEMORY
        self._silence.heard(now)
        if now < self._doubled_until:
            self._silence.over_at = max(self._silence.over_at, now + LONG_SILENCE)
        if self._asked is None:
            self._take_unasked(data, now)
            return
        self._received += data[: MAX_KEPT - len(self._received)]
        self._judge(self._framer.scan(data), now)
        if self._asked is not None:
            if self._framer.pending or self._wrong:
                self._quiet_at = now + (self._framer.quiet or 0.0)
                self._wake(self._quiet_at)
            if not self._framer.pending:
                self._end_if_damaged(now)

    def _take_unasked(self, data: bytes, now: float) -> None:
        """A late answer, or noise: whoever owes one must be quiet for as long again."""
        self._is_noisy = True
        if self._doubts:
            self.statistics.late_answers += not self._late
            for unit, (_, timeout) in self._doubts.items():
                self._doubts[unit] = now + timeout, timeout
        self._late += data[: MAX_KEPT - len(self._late)]
        self._note_unasked(len(data))

    def _judge(self, found: list[Frame | FrameError], now: float) -> None:
        for each in found:
            asked = self._asked
            if isinstance(each, FrameError):
                self._note_noise(each)
            else:
                if self._trace.is_on:
                    adu = self._framer.encode(each)
                    self._trace.tell("received", adu, each.unit, each.pdu[0])
                if asked is None:
                    self.statistics.late_answers += 1
                    self._is_noisy = True
                elif each.unit != asked.batch.unit:
                    self._note_other(asked, each.unit, now)
                elif self._is_echo(asked, each.pdu):
                    self._is_noisy = True
                    self._wrong = InvalidResponse("the request itself came back; echo=True?")
                elif now < self._silence.left_at:
                    self._note_early()
                elif each.pdu[0] & 0x7F != asked.function:
                    self._note_other_function(asked, each)
                else:
                    self._end(asked, each.pdu, now)

    def _note_noise(self, error: FrameError) -> None:
        self.statistics.invalid += 1
        self._is_noisy = True
        if self._asked is not None:
            self._wrong = error
        if self._trace.is_on:
            self._trace.tell("received", error.received)

    def _note_other(self, asked: Pending, unit: int, now: float) -> None:
        """Another unit's answer does not end the wait (serial line, 2.4.1)."""
        self._is_noisy = True
        if unit in self._doubts:
            self.statistics.late_answers += 1
            timeout = self._doubts[unit][1]
            self._doubts[unit] = now + timeout, timeout
        else:
            self.statistics.invalid += 1
            self._wrong = InvalidResponse(f"unit {unit} answered")
            self._wrong.answers_another = True

    def _note_other_function(self, asked: Pending, frame: Frame) -> None:
        """The answer to a function that was not asked does not end the wait either."""
        self._is_noisy = True
        self.statistics.invalid += 1
        self._wrong = InvalidResponse(
            f"function {frame.pdu[0] & 0x7F} was answered, not {asked.function}"
        )
        self._wrong.answers_another = True

    def _note_early(self) -> None:
        """An earlier answer came again: the unit cannot have received this request yet."""
        self._is_noisy = self._came_early = True
        self.statistics.late_answers += 1

    def _is_echo(self, asked: Pending, pdu: bytes) -> bool:
        """Whether it is the request, and no answer that repeats it as some do."""
        if pdu != asked.batch.pdus[asked.index]:
            return False
        try:
            asked.batch.requests[asked.index].decode_response(pdu)
        except ModbusError:
            return True
        return False

    def _end_if_damaged(self, now: float) -> None:
        """Noise does not end the wait, for an answer may follow; a damaged answer does."""
        asked = self._asked
        if asked is not None and isinstance(self._wrong, FrameError) and self._is_damaged(asked):
            self._end(asked, self._wrong, now)

    def _is_damaged(self, asked: Pending) -> bool:
        rest = bytes(self._received).replace(asked.adu, b"", 1)  # its echo
        unit, function = asked.batch.unit, asked.batch.pdus[asked.index][0]
        starts = [bytes([unit, function]), bytes([unit, function | 0x80])]
        if self._framing == "ascii":
            starts = [b":%02X%02X" % (start[0], start[1]) for start in starts]
            rest = rest.upper()
        return any(start in rest for start in starts)

    def _end(self, asked: Pending, what: bytes | ModbusError, now: float) -> None:
        self._asked = None
        self._quiet_at = None
        if isinstance(what, ModbusError):
            what.received = bytes(self._received)
        else:
            self._note_life(now)
            self._is_exact = self._wrong is None and not self._framer.pending
        self._found.append((asked, what))

    # --- time ---------------------------------------------------------------------------------

    def _note_quiet(self, now: float) -> None:
        if self._quiet_at is None or self._asked is None:
            return
        if self._quiet_at > now:
            self._wake(self._quiet_at)
            return
        self._quiet_at = None
        self._judge(self._framer.scan_silence(), now)
        self._end_if_damaged(now)

    def _overdue(self, now: float) -> list[tuple[Pending, Reply]]:
        asked = self._asked
        if asked is None:
            return []
        if asked.deadline > now:
            self._wake(asked.deadline)
            return []
        self._asked = None
        if self._came_early:  # and nothing else: bytes take no time here, whatever the settings say
            self._silence.is_timed = False
        received = bytes(self._received)
        error = self._wrong or no_answer(asked.batch.timeouts.timeout, received)
        error.received = received
        return [(asked, error)]

    def _doubt(self, batch: Batch, now: float) -> None:
        """Let the line fall silent before this unit is asked again: it may still answer."""
        timeout = batch.timeouts.timeout
        self._is_exact = False
        self._doubts[batch.unit] = now + timeout, timeout

    def _doubt_unanswered(self, asked: Pending, now: float) -> None:
        """As after a timeout, however early its caller went: the answer may be as late."""
        self._doubt(asked.batch, max(now, asked.deadline))

    def _give_up(self, batch: Batch, now: float) -> list[Pending]:
        self._waiting.pop(batch, None)
        asked = self._asked
        if asked is None or asked.batch is not batch:
            return []
        self._asked = None
        self._doubt_unanswered(asked, now)
        return [asked]

    def _forget(self, now: float) -> list[Pending]:
        self._is_exact = False
        self._waiting.clear()
        asked, self._asked = self._asked, None
        if asked is None:
            return []
        self._doubt_unanswered(asked, now)  # the unit is not on this side of the connection
        return [asked]

    # --- what is left -------------------------------------------------------------------------

    def _received_with(self, asked: Pending, pdu: bytes) -> bytes:
        return bytes(self._received)

    def _follow(self, request: Any) -> None:
        """Functions 8/3 and 8/1: another ASCII delimiter, and the first one again."""
        if isinstance(request, Diagnostics) and self._framing == "ascii":
            if request.sub_function == SubFunction.CHANGE_ASCII_DELIMITER:
                self._delimiter = request.data[0]
            elif request.sub_function == SubFunction.RESTART_COMMUNICATIONS:
                self._delimiter = 0x0A
            self._framer = self._make_framer()
