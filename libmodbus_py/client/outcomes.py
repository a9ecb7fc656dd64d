"""
The outcome of each request: its result, its error, or a repetition.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..protocol.errors import (
    Acknowledge,
    ExceptionResponse,
    IllegalFunction,
    InvalidResponse,
    ModbusError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    alike,
)
from .call import Call, Phase
from .hints import add_hint, explain, explain_role
from .queue import Queue
from .reconnecting import Reconnecting
from .statistics import Statistics, result_of

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from ..ports.port import Port

__all__ = ["Outcomes"]

BUSY = (Acknowledge, ServerDeviceBusy)

# A busy device is asked again after this pause, which is doubled each time up to the longest.
BUSY_PAUSE_S, LONGEST_BUSY_PAUSE_S = 0.1, 1.0


class Outcomes:
    """
    Decides what becomes of the requests of one connection.

    Args:
        endpoint, port: of the connection, for errors.
        queue: takes the requests that are sent again.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        port: Port,
        queue: Queue,
        life: Reconnecting,
        statistics: Statistics,
    ) -> None:
        self._place = str(endpoint)
        self._scheme = endpoint.scheme
        self._port = port
        self._queue = queue
        self._matching = queue.matching
        self._window = queue.window
        self._life = life
        self._statistics = statistics

    def settle(self, call: Call, now: float) -> None:
        """Set the outcome of a request whose reply is here, or send it again."""
        if call is self._queue.alone:
            self._queue.alone = None
            if not call.changes:
                self._end_trial(call)
        reply = call.reply
        if call.is_done:
            self._statistics.note(call.function, "cancelled")
        elif isinstance(reply, ModbusError):
            self._fail(reply, call, now)
        elif isinstance(reply, bytes):
            try:
                outcome = call.request.decode_response(reply)  # type: ignore[union-attr]
            except ModbusError as error:
                self._statistics.invalid += isinstance(error, InvalidResponse)
                error.received = self._matching.received_with(call, reply)
                self._fail(error, call, now)
            except BaseException as mistake:  # of the class of the request
                self._statistics.note(call.function, "invalid")
                call.settle(mistake)
            else:
                self._note_answer(call, "ok", now)
                call.settle(outcome)
                if not self._matching.has_ids:
                    self._matching.conclude(call, None, now)

    def _end_trial(self, call: Call) -> None:
        """Note how a read ended that was asked again alone."""
        if isinstance(call.reply, ModbusTimeoutError):
            self._window.missed(call)
            return
        if not isinstance(call.reply, bytes) or _is_busy(call.reply):
            return
        if call.earlier < 0 or self._matching.is_missing(call.earlier):
            self._window.take_one()
        elif not self._queue.lost:  # once for all that were lost together
            self._window.halve()

    def fail_unsent(self, call: Call, error: ModbusError) -> None:
        """Fail a request that is not sent."""
        if call is self._queue.alone:
            self._queue.alone = None
        if call.request is not None:
            self._statistics.note(call.function, "unsent")
        call.settle(self._outcome(alike(error), call))

    def refuse(self, call: Call, error: ModbusError) -> None:
        """Fail a request that is not sent, or not again; and those of its caller behind it."""
        self.fail_unsent(call, error)
        batch = call.batch
        if batch is not None:
            batch.under_way -= 1
            if (follower := batch.next()) is not None:
                self.refuse(follower, error)

    def _outcome(self, error: ModbusError, call: Call) -> BaseException:
        """Return an error with its request, or the exception that the request's class raised."""
        error.unit, error.endpoint, error.sent = call.unit, self._place, call.adu
        try:
            if call.request is not None:
                error.function, error.asked = call.request.function, str(call.request)
            is_answer = isinstance(error, InvalidResponse | ExceptionResponse)
            if error.received and call.adu and not is_answer:
                add_hint(error, explain(self._scheme, call.adu, error.received))
            if isinstance(error, IllegalFunction):
                add_hint(error, explain_role(self._port.certificate))
            if isinstance(error, ModbusTimeoutError) and self._window.is_at_one:
                add_hint(error, "this device takes one request at a time (max_in_flight=1)")
        except BaseException as mistake:
            return mistake
        return error

    def _note_answer(self, call: Call, result: str, now: float) -> None:
        """Count a valid answer; it proves that the device is alive."""
        took = now - call.sent_at
        self._statistics.note_answer(call.pdu[0], result, took, now)
        if self._life.fruitless:
            self._life.prove()
        if self._window.is_open:
            self._window.answered(call, self._matching.pending)

    def _fail(self, error: ModbusError, call: Call, now: float) -> None:
        if isinstance(error, ExceptionResponse):
            self._statistics.exceptions += 1
            self._note_answer(call, "exception", now)
        else:
            self._statistics.note(call.function, result_of(error))
        self._matching.conclude(call, error, now)
        self.go_on_without(error, call, now)

    def go_on_without(self, error: ModbusError, call: Call, now: float) -> None:
        """Send a request again that failed, or settle it."""
        try:
            if self._window.is_lost(error, call):
                call.state, call.reply = Phase.WAITING, error
                self._queue.lost.append(call)
            elif not self._is_repeated(error, call, now):
                call.settle(self._outcome(error, call))
        except BaseException as mistake:  # of the class of the request
            call.settle(mistake)

    def _is_repeated(self, error: ModbusError, call: Call, now: float) -> bool:
        """Send a request again later, if that is allowed; return False if not."""
        is_busy = isinstance(error, BUSY)
        assert call.request is not None
        if not call.is_wanted or (call.changes and self._queue.last_write > call.order):
            return False
        if not is_busy and (isinstance(error, ExceptionResponse) or not call.request.repeatable):
            return False
        done = call.busy_tries if is_busy else call.tries
        if done >= (call.timeouts.busy_retries if is_busy else call.timeouts.retries):
            return False
        if is_busy:
            call.busy_tries += 1
        else:
            call.tries += 1
        pause = min(LONGEST_BUSY_PAUSE_S, BUSY_PAUSE_S * 2**done) if is_busy else 0.0
        call.since = now
        self._queue.put_again(call, now + pause)
        return True


def _is_busy(reply: bytes) -> bool:
    return reply[0] >= 0x80 and reply[1:] == bytes([ServerDeviceBusy.code])
