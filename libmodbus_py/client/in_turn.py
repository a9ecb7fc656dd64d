"""
Matching on framings without transaction ids: one request at a time.

Their frames do not show which request they answer. So after a failure, the line must be quiet for
one timeout before the same unit gets another request. The answer of another unit is recognised by
its unit, and a collision by its check bytes. An answer that may belong to an earlier request
(`suspicion`) is taken only if no other answer follows.
"""

from __future__ import annotations

from ..ports.endpoint import Endpoint
from ..ports.port import Silence
from ..ports.trace import Trace
from ..protocol.errors import (
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
)
from ..protocol.framing import LINE_FEED, AsciiFramer, Frame, Framer, delimiter_after, make_framer
from .batch import Batch, Pending, Reply
from .local_echo import LocalEcho
from .matching import MAX_KEPT, Matching, Replies, no_answer
from .statistics import Statistics
from .suspicion import Suspicion

__all__ = ["InTurn"]

# A unit that answers twice may send the copy later than 3.5 characters after the first answer.
SHORTEST_COPY, LONG_SILENCE, LONG_MEMORY = 4, 0.02, 60.0


class InTurn(Matching):
    """
    Matching on lines, where one request is pending at a time.

    Args:
        silence: the silence of the port.
        delimiter: the byte after CR in ASCII frames.
    """

    has_ids = False

    def __init__(
        self,
        endpoint: Endpoint,
        statistics: Statistics,
        trace: Trace,
        *,
        silence: Silence,
        delimiter: int = LINE_FEED,
    ) -> None:
        self._delimiter = delimiter
        self._pause = endpoint.pause
        super().__init__(endpoint, statistics, trace)
        self._echo = LocalEcho(str(endpoint), statistics, bool(endpoint.options.get("echo")))
        self._silence = silence
        self._pending: Pending | None = None
        self._replies: Replies = []
        self._wrong: ModbusError | None = None  # the error of bytes received before the answer
        self._came_early = False  # an answer arrived before its request can have been sent
        self._suspicion: Suspicion  # of this connection; set by `reset`
        self._held: bytes | None = None  # an answer that may belong to an earlier request
        self._held_until: float
        self._heard_at: float  # the time at which bytes were last received
        self._received = bytearray()
        self._late = bytearray()
        self._quiet_at: float | None = None
        # Unit -> the time at which it may get a request again, and the timeout of its last request.
        self._doubts: dict[int, tuple[float, float]] = {}
        # Batch -> the time since which it waits for silence.
        self._waiting: dict[Batch, float] = {}
        self._is_noisy = False  # bytes arrived on this connection that were not an answer
        self._doubled_until = 0.0  # until then, answers may come twice, as they did recently

    def _make_framer(self) -> Framer:
        framer = make_framer(self._framing, "client", self._pause)
        if isinstance(framer, AsciiFramer):
            framer.delimiter = self._delimiter
        return framer

    def accepts(self, unit: int, request: bytes, pdu: bytes, since: float, now: float) -> bool:
        if now < self._silence.left_at:
            return False
        if self._echo.is_there is not False and not self._echo.accepts(request, pdu):
            return False
        return self._suspicion.accepts(unit, request, pdu, now - since)

    # --- asking --------------------------------------------------------------------------

    def may_start(self, batch: Batch, now: float) -> bool:
        over_at = self._silence.over_at
        if now < over_at and not self._late:  # the pause between two frames
            self._wake(over_at)
            return False
        ready_at = max(over_at, self.ready_at(batch.unit)) if self._doubts else over_at
        if ready_at <= now:
            return True
        self._wake(ready_at)
        self._check_wait(batch, now)
        return False

    def ready_at(self, unit: int) -> float:
        if unit or not self._doubts:
            return self._doubts[unit][0] if unit in self._doubts else 0.0
        # A broadcast is for all units, so it waits until all are ready.
        return max(ready_at for ready_at, _ in self._doubts.values())

    def _check_wait(self, batch: Batch, now: float) -> None:
        """
        Limit the wait for silence to two timeouts, or to one if the line brought more bytes than a
        late answer can have.

        Raises:
            FrameError: the wait is over.
        """
        timeout = batch.timeouts.timeout
        since = self._waiting.setdefault(batch, now)
        limit = since + timeout * (1 if len(self._late) >= MAX_KEPT else 2)
        if limit > now:
            self._wake(limit)
            return
        del self._waiting[batch]
        raise FrameError("the line does not fall silent", received=bytes(self._late))

    def start(self, batch: Batch, index: int, now: float, adu: bytes | None = None) -> Pending:
        if adu is None:
            if self._is_noisy or self._framer.pending:
                self._framer = self._make_framer()
            adu = self._framer.encode(Frame(batch.unit, batch.pdus[index]))
        if self._doubts:
            self._end_doubt(batch.unit)
        if self._waiting:
            self._waiting.pop(batch, None)
        self._received.clear()
        self._late.clear()
        self._quiet_at = None
        self._silence.sent(len(adu), now)
        if self._echo.is_there:
            self._echo.sent(adu)
        self._wrong = None
        self._held = None
        self._came_early = False
        self.unasked = 0
        pending = Pending(batch, index, adu, now)
        if not (batch.silent and batch.silent[index]):
            self._pending = pending
        return pending

    def _end_doubt(self, unit: int) -> None:
        if unit == 0:
            self._doubts.clear()
        else:
            self._doubts.pop(unit, None)

    # --- bytes ----------------------------------------------------------------------------

    def take(self, data: bytes, now: float) -> Replies:
        if self._pending is None and not self._doubts and len(data) >= SHORTEST_COPY:
            self._doubled_until = now + LONG_MEMORY
        self._silence.heard(now)
        self._heard_at = now
        if now < self._doubled_until:
            self._silence.over_at = max(self._silence.over_at, now + LONG_SILENCE)
        if self._pending is None:
            self._take_unasked(data, now)
            return []
        self._received += data[: MAX_KEPT - len(self._received)]
        if self._echo.is_there:
            data = self._echo.without(data)
        self._judge(self._framer.scan(data), now)
        if self._pending is not None:
            if self._framer.pending or self._wrong or self._echo.is_holding:
                self._quiet_at = now + (self._framer.quiet or 0.0)
                self._wake(self._quiet_at)
            if not self._framer.pending:
                self._end_if_damaged(now)
        return self._replies_so_far()

    def _replies_so_far(self) -> Replies:
        replies, self._replies = self._replies, []
        return replies

    def _take_unasked(self, data: bytes, now: float) -> None:
        """Take a late answer or noise: units that may still answer must be quiet anew."""
        self._is_noisy = True
        self.is_clean = False
        if self._doubts:
            self._statistics.late_answers += not self._late
            for unit, (_, timeout) in self._doubts.items():
                self._doubts[unit] = now + timeout, timeout
        self._late += data[: MAX_KEPT - len(self._late)]
        self.unasked += len(data)
        if self._trace.is_on():
            self._tell_unasked(data)

    def _tell_unasked(self, data: bytes) -> None:
        framer = self._make_framer()
        for each in [*framer.scan(data), *framer.scan_silence()]:
            self._tell(each)
        if framer.pending:  # the beginning of a frame, perhaps
            self._trace.tell("received", data[-framer.pending :])

    def _judge(self, found: list[Frame | FrameError], now: float) -> None:
        for each in found:
            pending = self._pending
            if self._trace.is_on():
                self._tell(each)
            if isinstance(each, FrameError):
                self._note_noise(each)
            elif pending is None:
                self._statistics.late_answers += 1
                self._is_noisy = True
                self.is_clean = False
            elif each.unit != pending.batch.unit:
                self._note_other(each.unit, now)
            elif each.pdu == (request := pending.batch.pdus[pending.index]) and self._is_echo(
                pending, request, now
            ):
                self._is_noisy = True
                self._wrong = InvalidResponse("the request itself came back; echo=True?")
            elif now < self._silence.left_at:
                self._note_early()
            elif each.pdu[0] & 0x7F != request[0]:
                self._note_other_function(pending, each)
            else:
                self._weigh(pending, each.pdu, now)

    def _tell(self, found: Frame | FrameError) -> None:
        if isinstance(found, FrameError):
            self._trace.tell("received", found.received)
        else:
            self._trace.tell("received", self._framer.encode(found), found.unit, found.pdu[0])

    def _weigh(self, pending: Pending, pdu: bytes, now: float) -> None:
        """Take an answer; if it may belong to an earlier request, only if no other follows."""
        unit, request = pending.batch.unit, pending.batch.pdus[pending.index]
        is_first = self._held is None
        if not is_first:
            self._note_surplus(now)
        if self._suspicion.accepts(unit, request, pdu, self._heard_at - pending.sent):
            self._end(pending, pdu, now)
            return
        if is_first or not self._suspicion.repeats(unit, request, pdu):
            self._held = pdu
            self._held_until = pending.sent + self._suspicion.patience(unit, request, pdu)
        self._wake(min(self._held_until, pending.deadline))

    def _note_surplus(self, now: float) -> None:
        """Note that there are more answers than requests: require longer silence for a while."""
        self._is_noisy = True
        self._statistics.late_answers += 1
        self._doubled_until = now + LONG_MEMORY

    def _note_noise(self, error: FrameError) -> None:
        self._statistics.invalid += 1
        self._is_noisy = True
        if self._pending is None:
            self.is_clean = False
        else:
            self._wrong = error

    def _note_other(self, unit: int, now: float) -> None:
        """Note an answer of another unit, which does not end the wait (serial line, 2.4.1)."""
        self._is_noisy = True
        if unit in self._doubts:
            self._statistics.late_answers += 1
            timeout = self._doubts[unit][1]
            self._doubts[unit] = now + timeout, timeout
        else:
            self._statistics.invalid += 1
            self._wrong = InvalidResponse(f"unit {unit} answered")
            self._wrong.answers_another = True

    def _note_other_function(self, pending: Pending, frame: Frame) -> None:
        """Note an answer to another function, which does not end the wait either."""
        self._is_noisy = True
        self._statistics.invalid += 1
        self._wrong = InvalidResponse(
            f"function {frame.pdu[0] & 0x7F} was answered, not {pending.function}"
        )
        self._wrong.answers_another = True

    def _note_early(self) -> None:
        """Note a repeated earlier answer: the unit cannot have received this request yet."""
        self._is_noisy = self._came_early = True
        self._statistics.late_answers += 1

    def _is_echo(self, pending: Pending, request: bytes, now: float) -> bool:
        """Return True if the bytes are an echo of the request, and not an answer equal to it."""
        if self._echo.may_be(request):
            return True
        try:
            pending.batch.requests[pending.index].decode_response(request)
        except ModbusError:
            return True
        except BaseException as error:  # a mistake in a request class is its caller's
            self._end(pending, error, now)
            return True
        return False

    def _end_if_damaged(self, now: float) -> None:
        """End the wait for a damaged answer; after mere noise, an answer may still follow."""
        pending = self._pending
        if (
            pending is not None
            and self._held is None  # else an undamaged answer is held
            and isinstance(self._wrong, FrameError)
            and self._is_damaged(pending)
        ):
            self._end(pending, self._wrong, now)

    def _is_damaged(self, pending: Pending) -> bool:
        rest = bytes(self._received).replace(pending.adu, b"", 1)  # its echo
        unit, function = pending.batch.unit, pending.function
        starts = [bytes([unit, function]), bytes([unit, function | 0x80])]
        if self._framing == "ascii":
            starts = [b":%02X%02X" % (start[0], start[1]) for start in starts]
            rest = rest.upper()
        return any(start in rest for start in starts)

    def _end(self, pending: Pending, reply: Reply, now: float) -> None:
        self._pending = None
        if isinstance(reply, ModbusError):
            reply.received = bytes(self._received)
        elif isinstance(reply, bytes):
            self.unanswered = 0
            if self._echo.is_there is not False or pending.adu in self._received:
                self._echo.learn(pending.batch.pdus[pending.index], pending.adu, self._received)
            is_exact = self._wrong is None and not self._framer.pending
            is_quiet = not (self._is_noisy or self._echo.is_there)
            self.is_clean = is_exact and is_quiet and not self._doubts
        self._replies.append((pending, reply))

    def received_with(self, pending: Pending, pdu: bytes) -> bytes:
        return bytes(self._received)

    # --- no answer ------------------------------------------------------------------------

    def expire(self, now: float) -> Replies:
        self._note_quiet(now)
        pending = self._pending
        if pending is not None and self._held is not None:
            self._take_held(pending, self._held, now)
        elif pending is not None and pending.deadline > now:
            self._wake(pending.deadline)
        elif pending is not None:
            self._pending = None
            if self._came_early:  # and nothing else: bytes take no time here
                self._silence.is_timed = False
            self._echo.learn(pending.batch.pdus[pending.index], pending.adu, self._received)
            received = bytes(self._received)
            error = self._wrong or no_answer(pending.batch.timeouts.timeout, received)
            error.received = received
            self._replies.append(self._time_out(pending, error))
        return self._replies_so_far()

    def _take_held(self, pending: Pending, pdu: bytes, now: float) -> None:
        """Take an answer that was held, because no other answer arrived in time."""
        if (until := min(self._held_until, pending.deadline)) > now:
            self._wake(until)
            return
        request = pending.batch.pdus[pending.index]
        took = self._heard_at - pending.sent
        self._suspicion.clear(pending.batch.unit, request, pdu, took)
        self._end(pending, pdu, now)

    def _note_quiet(self, now: float) -> None:
        """Judge the bytes before a silence."""
        if self._quiet_at is None or self._pending is None:
            return
        if self._quiet_at > now:
            self._wake(self._quiet_at)
            return
        self._quiet_at = None
        self._judge(self._framer.scan(self._echo.release()), now)
        self._judge(self._framer.scan_silence(), now)
        self._end_if_damaged(now)

    def conclude(self, pending: Pending, error: ModbusError | None, now: float) -> None:
        if error is None and self._framing == "ascii":
            self._follow(pending.batch.pdus[pending.index])
        elif error and not isinstance(error, ExceptionResponse | ModbusConnectionError):
            self._doubt(pending.batch, now)

    def _doubt(self, batch: Batch, now: float) -> None:
        """Require silence before the next request to this unit, which may still answer."""
        timeout = batch.timeouts.timeout
        self.is_clean = False
        self._doubts[batch.unit] = now + timeout, timeout

    def _doubt_unanswered(self, pending: Pending, now: float) -> None:
        """Require silence as after a timeout, even if the caller gave up before the timeout."""
        self._doubt(pending.batch, max(now, pending.deadline))

    def _follow(self, pdu: bytes) -> None:
        delimiter = delimiter_after(pdu, self._delimiter)
        if delimiter != self._delimiter:
            self._delimiter = delimiter
            self._framer = self._make_framer()

    def withdraw(self, batch: Batch, now: float) -> list[Pending]:
        self._waiting.pop(batch, None)
        pending = self._pending
        if pending is None or pending.batch is not batch:
            return []
        self._pending = None
        self._doubt_unanswered(pending, now)
        return [pending]

    def reset(self, now: float) -> list[Pending]:
        super().reset(now)
        self._is_noisy = False
        self._echo.reset()
        self._suspicion = Suspicion()
        self._doubled_until = 0.0
        self._waiting.clear()
        pending, self._pending = self._pending, None
        if pending is None:
            return []
        self._doubt_unanswered(pending, now)  # the unit is not on this side of the connection
        return [pending]
