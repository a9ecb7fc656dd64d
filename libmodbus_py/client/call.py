"""
One request from its submission to its outcome, and several requests of one caller.

    WAITING    in the queue, or waiting for its repetition
    SENT       in flight: its answer, or the end of its time, is awaited
    ANSWERED   its reply is here, and not yet decoded

It is over (`is_done`) when it has its outcome, or no caller waits for it any more; until then it
belongs to the connection. A `Batch` only counts: it says which of its calls may be submitted next,
and when all that matter are over.
"""

from __future__ import annotations

import enum
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from ..protocol.checks import integer, seconds
from ..protocol.errors import (
    NO_UNIT,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    in_hex,
)
from ..protocol.pdu import MAX_PDU, Request

if TYPE_CHECKING:
    from ..ports.trace import Trace
    from .statistics import Statistics

# fmt: off
__all__ = [
    "ANSWERED", "NOT_ASKED", "SENT", "SILENCE", "WAITING", "Batch", "Call", "Matching",
    "Phase", "Timeouts", "no_answer", "raised",
]
# fmt: on

NOT_ASKED: Final = object()
"""The outcome of a request that has none yet, or was never sent."""

SILENCE = (ModbusTimeoutError, *NO_UNIT)
"""The failures of a request to a silent device: no answer, or that of a gateway in its place."""


class Timeouts:
    """The seconds that a request may take, and how often it is sent again."""

    __slots__ = ("busy_retries", "retries", "timeout")

    def __init__(self, timeout: float, retries: int, busy_retries: int) -> None:
        self.timeout: float = timeout
        self.retries: int = retries
        self.busy_retries: int = busy_retries

    def but(self, timeout: float | None, retries: int | None) -> Timeouts:
        """Return this object if both arguments are None, else a copy with those that are not."""
        if timeout is None and retries is None:
            return self
        return Timeouts(
            self.timeout if timeout is None else seconds("timeout", timeout),
            self.retries if retries is None else integer("retries", retries, 0, 100),
            self.busy_retries,
        )


class Phase(enum.Enum):
    """The states of a call; see the head of this module."""

    WAITING = enum.auto()
    SENT = enum.auto()
    ANSWERED = enum.auto()


WAITING, SENT, ANSWERED = Phase.WAITING, Phase.SENT, Phase.ANSWERED  # looked up once


class Call:
    """
    One request to one unit; without a request it only waits for the connection.

    `changes` is True if it may change the device; `is_silent`, if it gets no answer.

    Raises:
        TypeError, ValueError: the request cannot be sent; the message contains its name, which has
            braces for the index.
    """

    __slots__ = (
        *("__weakref__", "adu", "batch", "changes", "is_done", "is_silent", "on_done", "outcome"),
        *("pdu", "reply", "request", "sent_at", "state", "timeouts", "tries", "unit", "waited"),
    )

    def __init__(
        self,
        unit: int,
        request: Request[Any] | None,
        timeouts: Timeouts,
        is_broadcast: bool = False,
        name: str = "request",
        index: int = 0,
        batch: Batch | None = None,
    ) -> None:
        self.unit: int = unit
        self.request: Request[Any] | None = request
        self.timeouts: Timeouts = timeouts
        self.batch: Batch | None = batch
        self.on_done: Callable[[Call], object] | None = None  # not of calls of a batch
        self.state: Phase = WAITING
        self.reply: bytes | ModbusError | None = None  # the PDU of the answer, or an error
        self.outcome: Any = NOT_ASKED  # the result, or the exception
        self.is_done: bool = False
        self.adu: bytes = b""  # the frame that was sent last
        self.sent_at: float = 0.0  # before sending: when it began to wait for a connection
        self.waited: float = 0.0  # seconds of its timeout that had passed when it was connected
        # How often it was sent again: because it was not answered, and because the device was busy.
        self.tries: tuple[int, int] = 0, 0
        if request is None:
            self.pdu: bytes = b""
            self.changes: bool = False
            self.is_silent: bool = False
            return
        if not isinstance(request, Request):
            kind = type(request).__name__
            raise TypeError(f"{name.format(index)} must be a request object of pdu, not {kind}")
        if is_broadcast and not request.may_be_broadcast:
            from ..protocol.pdu import RawRequest

            if not isinstance(request, RawRequest):
                raise ValueError(
                    f"{name.format(index)}: unit 0 is a broadcast, which no unit answers, "
                    f"and {request} is not a write; broadcast=False, if a device answers it"
                )
            is_broadcast = False  # bytes of a caller may be a read, which is answered
        self.pdu = pdu = request.encode()
        if not isinstance(pdu, bytes):
            kind = type(pdu).__name__
            raise TypeError(f"{name.format(index)} must encode to bytes, not {kind}")
        if not 0 < len(pdu) <= MAX_PDU:
            size = f"1..{MAX_PDU} bytes, not {len(pdu)}"
            raise ValueError(f"{name.format(index)} must encode to {size}")
        self.changes = request.changes
        self.is_silent = is_broadcast or not request.expects_response

    @property
    def function(self) -> int:
        return self.pdu[0]

    @property
    def deadline(self) -> float:
        """When its time is over; computed each time, because the timeout may be changed."""
        return self.sent_at - self.waited + self.timeouts.timeout

    def on_end(self, callback: Callable[[Call], object]) -> None:
        """Call a function once the call has its outcome."""
        self.on_done = callback

    def await_connection(self, now: float) -> None:
        """Begin the time of the call, because it waits for a connection."""
        self.sent_at, self.waited = now, 0.0

    def note_connection(self, now: float) -> None:
        """Stop the time until the request is sent: now it waits for other requests."""
        self.waited = now - self.sent_at

    def note_sent(self, adu: bytes, now: float) -> None:
        """Note that a frame of the request is sent: the time goes on."""
        self.adu = adu
        self.sent_at = now
        self.state = SENT

    def answer(self, reply: bytes | ModbusError) -> None:
        """Note the reply, or the error that replaces a reply."""
        self.reply = reply
        self.state = ANSWERED

    def doubt(self, error: ModbusError) -> None:
        """Note an error that is the reply unless an answer follows."""
        self.reply = error

    def hold(self) -> None:
        """Note that an answer was received, which may belong to another request."""
        self.state = ANSWERED

    def try_again(self, now: float, *, is_busy: bool) -> int | None:
        """
        Restart the time for another sending; return how often that was done before.

        None if it may not be sent again.
        """
        (unanswered, busy), timeouts = self.tries, self.timeouts
        tries = busy if is_busy else unanswered
        if tries >= (timeouts.busy_retries if is_busy else timeouts.retries):
            return None
        self.tries = (unanswered, busy + 1) if is_busy else (unanswered + 1, busy)
        self.state = WAITING
        self.sent_at, self.waited, self.reply = now, 0.0, None
        return tries

    def settle(self, outcome: Any) -> None:
        """Set the outcome, unless no caller waits for it."""
        if self.is_done:
            return
        self.is_done = True
        self.outcome = outcome
        if self.batch is not None:
            self.batch.count(self)
        elif self.on_done is not None:
            self.on_done(self)

    def result(self) -> Any:
        """Return the result, or raise the exception that is the outcome."""
        outcome = self.outcome
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    def forget(self) -> None:
        """Note that no caller waits for the outcome any more."""
        self.is_done = True

    def await_another_connection(self) -> None:
        """Wait again, because its connection has ended; its time goes on."""
        self.state = WAITING
        self.sent_at, self.waited = self.sent_at - self.waited, 0.0

    def send_no_more(self) -> None:
        """Note that it is not to be sent again."""
        self.timeouts = Timeouts(self.timeouts.timeout, 0, 0)


_is_silent: Callable[[Call], bool] = attrgetter("is_silent")


class Batch:
    """
    Requests of one caller to one unit, which are sent in their order; if `one_by_one`, each when
    the one before has its outcome.

    It is over as soon as its first failure and all requests before that have an outcome; with
    `go_on`, when every request has one. With `is_poll`, a request without an answer still ends it,
    unless another one was answered: the device is silent, and each of the others would take as
    long. `name` is that of a request in messages, with braces for its index.

    Raises:
        TypeError, ValueError: a request cannot be sent; the message contains its name.
    """

    # fmt: off
    __slots__ = (
        "_go_on", "_is_poll", "_open", "calls", "is_done", "on_done", "one_by_one", "waiting",
    )
    # fmt: on

    def __init__(
        self,
        unit: int,
        requests: list[Request[Any]],
        timeouts: Timeouts,
        *,
        name: str = "request",
        is_broadcast: bool = False,
        one_by_one: bool = True,
        go_on: bool = False,
        is_poll: bool = False,
    ) -> None:
        self.calls: list[Call] = [
            Call(unit, request, timeouts, is_broadcast, name, index, self)
            for index, request in enumerate(requests)
        ]
        self.waiting: list[Call] = self.calls[::-1]  # to be submitted, the next one last
        # Without an answer, it is unknown whether a request was carried out before the next one.
        self.one_by_one: bool = one_by_one or any(map(_is_silent, self.calls))
        self._go_on = go_on
        self._is_poll = is_poll
        self._open = len(self.calls)
        self.is_done: bool = not self.calls
        self.on_done: Callable[[Batch], object] | None = None

    @property
    def outcomes(self) -> list[Any]:
        """The outcomes of the requests, in their order."""
        return [call.outcome for call in self.calls]

    def result(self) -> list[Any]:
        """Return the outcomes; none of them is raised."""
        return self.outcomes

    def on_end(self, callback: Callable[[Batch], object]) -> None:
        """Call a function once the batch is over."""
        self.on_done = callback

    def next(self) -> Call:
        """Remove and return the next call to submit, of those that are `waiting`."""
        return self.waiting.pop()

    def count(self, call: Call) -> None:
        """Count a call that has its outcome; the calls after a failed one are forgotten."""
        self._open -= 1
        outcome = call.outcome
        if isinstance(outcome, BaseException) and self._ends_with(outcome):
            for other in self.calls[self.calls.index(call) + 1 :]:
                if not other.is_done:
                    self._open -= 1
                    other.forget()
            self.waiting.clear()
        if not self._open and not self.is_done:
            self.is_done = True
            if self.on_done is not None:
                self.on_done(self)

    def _ends_with(self, failure: BaseException) -> bool:
        if not (self._go_on and isinstance(failure, ModbusError)):
            return True
        is_silence = self._is_poll and isinstance(failure, SILENCE)
        return is_silence and not any(map(_is_answer, self.outcomes))

    def forget(self) -> None:
        """Note that no caller waits for the outcomes any more."""
        self.is_done = True
        self.waiting.clear()
        for call in self.calls:
            call.forget()

    def settle(self, outcome: Any) -> None:
        """End the batch, with this outcome for all requests that have none yet."""
        for call in self.calls:
            call.settle(outcome)


def _is_answer(outcome: object) -> bool:
    """Return True if a request has an outcome that shows that the device is there."""
    return outcome is not NOT_ASKED and not isinstance(outcome, (*SILENCE, ModbusConnectionError))


class Matching(ABC):
    """
    Decides which answer belongs to which request of a connection: `Ids` by transaction ids, `Line`
    on lines without them, where one request is in flight at a time.
    """

    has_ids = False

    def __init__(self, statistics: Statistics, trace: Trace) -> None:
        # Requests in flight, by their ids, in the order in which they were sent.
        self.pending: dict[int, Call] = {}
        # The time at which `expire` must be called; may be too early, but never too late.
        self.alarm: float = math.inf
        self.unanswered: int = 0  # requests without an answer since the last answer
        self.unasked: int = 0  # bytes since the last request, while no answer was awaited
        self.rest: bytes | bytearray = b""  # the beginning of a frame
        self.is_in_step: bool = True  # False once the bytes cannot be understood any more
        self.is_traced: bool = trace.is_on()
        self._statistics = statistics
        self._trace = trace

    def _begin_again(self, rest: bytes | bytearray) -> None:
        """Forget the requests of an earlier connection; `rest` as the attribute."""
        self.pending = {}
        self.unanswered = self.unasked = 0
        self.is_in_step = True
        self.rest = rest

    def drop_rest(self) -> bool:
        """Drop the beginning of a frame if it can be no part of an answer; return True if so."""
        return False

    def has_begun(self) -> bool:
        """Return True if bytes of an answer have come."""
        return bool(self.rest)

    def trace_frames(self, *, is_on: bool) -> None:
        """Trace received frames from now on, or no longer."""
        self.is_traced = is_on

    def wake(self, at: float) -> None:
        """Set the alarm, unless there is an earlier one."""
        if at < self.alarm:
            self.alarm = at

    def clear_alarm(self) -> None:
        """Note that the alarm has rung."""
        self.alarm = math.inf

    def note_unanswered(self) -> None:
        """Count a request whose caller is gone: it may be one of many that get no answer."""
        self.unanswered += 1

    def may_start(self, call: Call, now: float) -> bool:
        """Return True if a request may be sent now; else set `alarm` and the end of its wait."""
        return True

    def ready_at(self, unit: int, function: int | None = None) -> float:
        """Return when a unit may get a request of this, or any, function; 0.0 if it may at once."""
        return 0.0

    @abstractmethod
    def start(self, call: Call, now: float) -> bytes:
        """Return the frame of a request, and expect the answer from now on."""

    @abstractmethod
    def take(self, data: bytes, now: float) -> list[Call]:
        """Return the requests that received bytes answer, with their replies."""

    @abstractmethod
    def received_with(self, call: Call, pdu: bytes) -> bytes:
        """Return the received bytes that contained the PDU of an answer."""

    def conclude(self, call: Call, error: Exception | None, now: float) -> None:  # noqa: B027
        """Draw conclusions from how a request ended, on a line."""

    @abstractmethod
    def expire(self, now: float) -> list[Call]:
        """Return the requests whose time is over, with their errors, or whose HOLD is."""

    def end(self, now: float) -> list[Call]:
        """Return the requests that are answered because the other side ends the connection."""
        return []

    @abstractmethod
    def withdraw(self, call: Call, now: float) -> bool:
        """Expect only a late answer to a request; return True if it was in flight."""

    @abstractmethod
    def reset(self, now: float) -> list[Call]:
        """Return the requests in flight, and begin with the next connection."""


def no_answer(timeout: float, data: bytes, *, is_held: bool = False) -> ModbusTimeoutError:
    """Return the error for no answer; `is_held`: an answer was not held long enough (`Line`)."""
    if is_held:
        return ModbusTimeoutError(
            f"within {timeout:g} s it is unknown whether {in_hex(data)} answers this request "
            "or an earlier one",
            received=data,
        )
    if data:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {in_hex(data)}", received=data
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")


def raised(outcomes: Iterable[Any], kinds: tuple[type[BaseException], ...] = ()) -> None:
    """Raise the first failure, in the order of requests, that is not tolerated."""
    for outcome in outcomes:
        if isinstance(outcome, BaseException) and not isinstance(outcome, kinds):
            raise outcome
