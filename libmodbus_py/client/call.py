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
from typing import TYPE_CHECKING, Any, Final

from ..protocol.checks import integer, seconds
from ..protocol.errors import MAX_RECEIVED, ModbusError, ModbusTimeoutError, in_hex
from ..protocol.pdu import MAX_PDU, Request

if TYPE_CHECKING:
    from ..ports.trace import Trace
    from .statistics import Statistics

__all__ = [
    "MAX_IN_FLIGHT",
    "MAX_KEPT",
    "NOT_ASKED",
    "Batch",
    "Call",
    "Matching",
    "Phase",
    "Timeouts",
    "encoded",
    "no_answer",
    "raised",
]

NOT_ASKED: Final = object()
"""The outcome of a request that has none yet, or was never sent."""

MAX_KEPT = MAX_RECEIVED
"""The most received bytes that errors contain; more bytes would not help."""

# The buffers of two sockets hold this many requests and answers of full length. With more, each
# side might wait for the other one to read before it goes on.
MAX_IN_FLIGHT = 256


class Timeouts:
    """
    The timeout of a request, and its retries.

    Attributes:
        timeout: the seconds that one request may take.
        retries: how often it is sent again if there was no answer or a damaged one, or if the
            connection was lost.
        busy_retries: how often it is sent again if the device refused it because it is busy.
    """

    __slots__ = ("busy_retries", "retries", "timeout")

    def __init__(self, timeout: float, retries: int, busy_retries: int) -> None:
        self.timeout: float = timeout
        self.retries: int = retries
        self.busy_retries: int = busy_retries

    def but(self, timeout: float | None, retries: int | None) -> Timeouts:
        """Return this object if both are None, else a copy with those that are not."""
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


class Call:
    """
    One request to one unit. Without a request it only waits for the connection.

    Args:
        unit: the unit, 0..255.
        request: the request; None to wait for the connection.
        pdu: what the request encodes to.
        is_broadcast: True if no unit answers.

    Attributes:
        changes: True if it may change the device: nothing is sent beside it, nor before its
            repetition (`Transactions`).
        is_silent: True if it gets no answer.
        is_done: True if it has its outcome, or no caller waits for it any more.
        waits_until: when it fails for lack of silence on the line; infinite while it need not wait.
        outcome: the result, or the exception; `NOT_ASKED` while there is none.
        on_done: called with the call when it has its outcome; not for calls of a batch.
        reply: the PDU of the answer, or the exception in its place; `answerer`: its unit.
        adu: the frame that was sent last, or nothing; `number`: its transaction id.
        earlier: the transaction id of the frame sent before, if that was not answered; or -1.
        sent_at: when the frame was sent; `since`: when its time began, which is sooner if the call
            has waited for the connection, for `used` seconds.
        due: when it is to be sent again.
        order: its number among the frames of the connection.
        lost_at: when it is lost beside others, and is asked again alone; infinite if it is not.
        is_wanted: False if it is not to be sent again.
        is_under_way: False if its batch has gone on without its outcome.
        tries, busy_tries: how often it was sent again.
    """

    # Of the class, because most calls never set them: making a call takes half the time.
    batch: Batch | None = None
    is_silent: bool = False
    is_done: bool = False
    state: Phase = Phase.WAITING
    outcome: Any = NOT_ASKED
    on_done: Callable[[Call], object] | None = None
    reply: bytes | BaseException | None = None
    answerer: int = 0
    adu: bytes = b""
    number: int = 0
    earlier: int = -1
    order: int = 0
    lost_at: float = math.inf
    is_wanted: bool = True
    is_under_way: bool = True
    used: float = 0.0
    waits_until: float = math.inf
    tries: int = 0
    busy_tries: int = 0
    due: float = 0.0
    sent_at: float = 0.0
    since: float = 0.0

    def __init__(
        self,
        unit: int,
        request: Request[Any] | None,
        pdu: bytes,
        timeouts: Timeouts,
        is_broadcast: bool = False,
    ) -> None:
        self.unit: int = unit
        self.request: Request[Any] | None = request
        self.pdu: bytes = pdu
        self.timeouts: Timeouts = timeouts
        if request is None:
            self.changes: bool = False
        else:
            self.changes = request.changes
            if is_broadcast or not request.expects_response:
                self.is_silent = True

    @property
    def function(self) -> int:
        return self.pdu[0]

    @property
    def deadline(self) -> float:
        """When its time is over; computed each time, because the timeout may be changed."""
        return self.since + self.timeouts.timeout

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

    def fail(self, error: BaseException) -> None:
        """Set an error as the outcome, unless there is one."""
        self.settle(error)

    def forget(self) -> None:
        """Note that no caller waits for the outcome any more."""
        self.is_done = True


class Batch:
    """
    Requests of one caller to one unit, which are sent in their order.

    It is over as soon as its first failure and all requests before that have an outcome; with
    `go_on`, when every request has one.

    Args:
        name: the name of a request in messages; braces stand for its index.
        is_broadcast: True if the requests get no answer.
        limit: how many of them may be in flight.
        go_on: True to send the other requests after one has failed.

    Attributes:
        calls: the requests, in their order.
        waiting: the calls that are still to be submitted, the next one last.
        under_way: how many were submitted and are not over.
        on_done: called once with the batch when it is over.

    Raises:
        TypeError, ValueError: a request cannot be sent; the message contains its name.
    """

    __slots__ = ("_go_on", "_open", "calls", "is_done", "limit", "on_done", "under_way", "waiting")

    def __init__(
        self,
        unit: int,
        requests: list[Request[Any]],
        timeouts: Timeouts,
        *,
        name: str = "request",
        is_broadcast: bool = False,
        limit: int = 1,
        go_on: bool = False,
    ) -> None:
        pdus = [encoded(each, name, index, is_broadcast) for index, each in enumerate(requests)]
        self.calls: list[Call] = [
            Call(unit, request, pdu, timeouts, is_broadcast)
            for request, pdu in zip(requests, pdus, strict=True)
        ]
        for call in self.calls:
            call.batch = self
        self.waiting: list[Call] = self.calls[::-1]
        # Without an answer, it is unknown whether a request was carried out before the next one.
        self.limit: int = 1 if any(each.is_silent for each in self.calls) else limit
        self._go_on = go_on
        self._open = len(self.calls)
        self.under_way: int = 0
        self.is_done: bool = not self.calls
        self.on_done: Callable[[Batch], object] | None = None

    @property
    def outcomes(self) -> list[Any]:
        """The outcomes of the requests, in their order."""
        return [each.outcome for each in self.calls]

    def next(self) -> Call | None:
        """Remove and return the next call to submit; None if there is none now."""
        if not self.waiting or self.under_way >= self.limit:
            return None
        self.under_way += 1
        return self.waiting.pop()

    def count(self, call: Call) -> None:
        """Note that a call has its outcome."""
        self._open -= 1
        outcome = call.outcome
        if isinstance(outcome, BaseException) and not (
            self._go_on and isinstance(outcome, ModbusError)
        ):
            self._cut(call)
        if not self._open and not self.is_done:
            self.is_done = True
            if self.on_done is not None:
                self.on_done(self)

    def _cut(self, failed: Call) -> None:
        """Forget the calls behind one that failed."""
        for call in self.calls[self.calls.index(failed) + 1 :]:
            if not call.is_done:
                self._open -= 1
                call.forget()
        self.waiting.clear()

    def forget(self) -> None:
        """Note that no caller waits for the outcomes any more."""
        self.is_done = True
        self.waiting.clear()
        for call in self.calls:
            call.forget()

    def fail(self, error: BaseException) -> None:
        """End the batch, with this error as the outcome of all requests that have none yet."""
        for call in self.calls:
            if not call.is_done:
                call.settle(error)


class Matching(ABC):
    """
    Decides which answer belongs to which request of a connection: `Ids` by transaction ids, `Line`
    on lines without them, where one request is in flight at a time.

    Attributes:
        has_ids: True if frames have transaction ids.
        pending: requests in flight, by their ids, in the order in which they were sent.
        alarm: the time at which `expire` must be called; may be too early, but never too late.
        unanswered: the number of requests without an answer since the last answer arrived.
        unasked: the number of bytes received since the last request was sent, while no answer was
            awaited.
        rest: the beginning of a frame whose end was not received yet.
        is_in_step: False once the stream of bytes cannot be understood any more.
        is_traced: True if the trace is told of all frames.
    """

    has_ids = False

    def __init__(self, statistics: Statistics, trace: Trace) -> None:
        self.pending: dict[int, Call] = {}
        self.alarm: float = math.inf
        self.unanswered: int = 0
        self.unasked: int = 0
        self.rest: bytes | bytearray = b""
        self.is_in_step: bool = True
        self.is_traced: bool = trace.is_on()
        self._statistics = statistics
        self._trace = trace

    def _begin_again(self, rest: bytes | bytearray) -> None:
        """Forget the requests of an earlier connection; `rest` as the attribute."""
        self.pending = {}
        self.unanswered = self.unasked = 0
        self.is_in_step = True
        self.rest = rest

    def wake(self, at: float) -> None:
        """Set the alarm, unless there is an earlier one."""
        if at < self.alarm:
            self.alarm = at

    def may_start(self, call: Call, now: float) -> bool:
        """Return True if a request may be sent now; else set `alarm` and the end of its wait."""
        return True

    def ready_at(self, unit: int, function: int | None = None) -> float:
        """Return when a unit may get a request of this, or any, function; 0.0 if it may at once."""
        return 0.0

    @abstractmethod
    def start(self, call: Call, now: float) -> None:
        """Encode the frame of a request, and expect the answer from now on."""

    @abstractmethod
    def take_back(self) -> Call:
        """Return the only request in flight, which was not sent after all."""

    @abstractmethod
    def take(self, data: bytes, now: float) -> list[Call]:
        """Return the requests that received bytes answer, with their replies."""

    @abstractmethod
    def received_with(self, call: Call, pdu: bytes) -> bytes:
        """Return the received bytes that contained the PDU of an answer."""

    @abstractmethod
    def conclude(self, call: Call, error: Exception | None, now: float) -> None:
        """Draw conclusions from how a request ended."""

    @abstractmethod
    def expire(self, now: float) -> list[Call]:
        """Return the requests whose time is over, with their errors, or whose HOLD is."""

    @abstractmethod
    def withdraw(self, call: Call, now: float) -> bool:
        """Expect only a late answer to a request; return True if it was in flight."""

    @abstractmethod
    def reset(self, now: float) -> list[Call]:
        """Return the requests in flight, and begin with the next connection."""

    def is_missing(self, number: int) -> bool:
        """Return True if the answer to a request that was given up has not come yet."""
        return False


def no_answer(timeout: float, received: bytes, *, is_held: bool = False) -> ModbusTimeoutError:
    """
    Return the error for a request that got no answer, with the bytes received instead.

    Args:
        is_held: True if an answer came, but too late to see whether another one follows (`Line`).
    """
    if is_held:
        return ModbusTimeoutError(
            f"within {timeout:g} s it is unknown whether {in_hex(received)} answers this request "
            "or an earlier one",
            received=received,
        )
    if received:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {in_hex(received)}", received=received
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")


def encoded(request: object, name: str, index: int, is_broadcast: bool) -> bytes:
    """
    Check and encode a request.

    Raises:
        TypeError, ValueError: the request cannot be sent.
    """
    if not isinstance(request, Request):
        given = type(request).__name__
        raise TypeError(f"{name.format(index)} must be a request object of pdu, not {given}")
    if is_broadcast and not request.may_be_broadcast:
        raise ValueError(
            f"{name.format(index)}: unit 0 is a broadcast, which no unit answers, "
            f"and {request} is not a write"
        )
    pdu = request.encode()
    if not isinstance(pdu, bytes):
        raise TypeError(f"{name.format(index)} must encode to bytes, not {type(pdu).__name__}")
    if not 1 <= len(pdu) <= MAX_PDU:
        raise ValueError(f"{name.format(index)} must encode to 1..{MAX_PDU} bytes, not {len(pdu)}")
    return pdu


def raised(outcomes: Iterable[Any], tolerated: tuple[type[BaseException], ...] = ()) -> None:
    """Raise the first failure, in the order of requests, that is not tolerated."""
    for outcome in outcomes:
        if isinstance(outcome, BaseException) and not isinstance(outcome, tolerated):
            raise outcome
