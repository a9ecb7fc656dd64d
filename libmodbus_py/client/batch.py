"""
The requests of one caller, and their outcomes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from ..protocol.errors import ModbusError
from ..protocol.pdu import MAX_PDU, Request

if TYPE_CHECKING:
    from .timeouts import Timeouts

__all__ = [
    "MAX_IN_FLIGHT",
    "NOT_ASKED",
    "Batch",
    "Pending",
    "Reply",
    "raised",
]

NOT_ASKED: Final = object()
"""The outcome of a request that has not been settled, or was never sent."""

EXPECTS_RESPONSE = attrgetter("expects_response")

# The buffers of two sockets hold this many requests and answers of full length. With more, each
# side might wait for the other one to read before it goes on.
MAX_IN_FLIGHT = 256

# The PDU of the answer to a request; or the error that explains why no answer was received; or an
# exception that the class of the request raised.
Reply = bytes | BaseException


class Pending:
    """
    One request that was sent.

    Attributes:
        batch: the batch of the request.
        index: the index of the request in its batch.
        adu: the frame.
        sent: the time at which it was sent.
        since: the time at which its timeout began: before `sent` if it waited for the connection.
        order: its number among the requests of the connection; set by `Capacity`.
        has_company: True if others were in flight when it was sent; set by `Capacity`.
    """

    __slots__ = ("adu", "batch", "has_company", "index", "order", "sent", "since")

    def __init__(self, batch: Batch, index: int, adu: bytes, sent: float) -> None:
        self.batch: Batch = batch
        self.index: int = index
        self.adu: bytes = adu
        self.sent: float = sent
        self.since: float = sent - batch.used
        self.order: int = 0
        self.has_company: bool = False

    @property
    def function(self) -> int:
        return self.batch.pdus[self.index][0]

    @property
    def deadline(self) -> float:
        """When the timeout ends; computed each time, because it may be changed meanwhile."""
        return self.since + self.batch.timeouts.timeout


class Batch:
    """
    Requests of one caller to one unit, which are sent in their order; often a single request.

    A batch is settled as soon as its first failure and all requests before that have an outcome;
    with `go_on`, when every request has an outcome. A batch without requests only waits for the
    connection.

    Args:
        name: the name of a request in messages; braces stand for its index.
        is_broadcast: True if the requests get no answer.
        pdus: what `encoded` returned for the requests; None to encode them here.

    Attributes:
        silent: True for each request that gets no answer; None if all are answered.
        limit: how many requests may be in flight.
        go_on: True to send the other requests after one has failed.
        outcomes: the result of each request, or its exception.
        started: how many requests were sent.
        end: requests from this index on are ignored.
        repeated: the number of repetitions, by index and by True if the device was busy.
        sent: the frames of requests that are repeated, by index.
        in_flight: how many requests are pending, or will be repeated.
        queued: True while the batch is in the queue.
        since: when the batch began to wait for a connection; `used`: for how long it did.
        refusal: the error that explains why there is no connection, or None.
        on_done: called once with the batch when the batch is settled.

    Raises:
        TypeError, ValueError: a request cannot be sent; the message contains its name.
    """

    # fmt: off
    __slots__ = (
        "_open", "end", "go_on", "in_flight", "is_done", "limit", "on_done", "outcomes", "pdus",
        "queued", "refusal", "repeated", "requests", "sent", "silent", "since", "started",
        "timeouts", "unit", "used",
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
        limit: int = 1,
        go_on: bool = False,
        pdus: list[bytes] | None = None,
    ) -> None:
        self.unit: int = unit
        self.requests: list[Request[Any]] = requests
        self.timeouts: Timeouts = timeouts
        if pdus is None:
            pdus = [
                encoded(request, name, index, is_broadcast)
                for index, request in enumerate(requests)
            ]
        self.pdus: list[bytes] = pdus
        self.silent: list[bool] | None = None
        if is_broadcast:
            self.silent = [True] * len(requests)
        elif not all(expected := [*map(EXPECTS_RESPONSE, requests)]):
            self.silent = [not each for each in expected]
        # Without an answer, it is unknown whether a request was carried out before the next one.
        self.limit: int = 1 if self.silent else limit
        self.go_on: bool = go_on
        self.outcomes: list[Any] = [NOT_ASKED] * len(requests)
        self.started: int = 0
        self.repeated: dict[tuple[int, bool], int] = {}
        self.sent: dict[int, bytes] = {}
        self.in_flight: int = 0
        self.queued: bool = False
        self.since: float = 0.0
        self.used: float = 0.0
        self.refusal: ModbusError | None = None
        self.on_done: Callable[[Batch], object] | None = None
        self.is_done: bool = False
        self.end: int = len(requests)
        self._open = self.end

    @property
    def wait_until(self) -> float:
        """The time until which a batch waits for a connection; computed from its timeout."""
        return self.since + self.timeouts.timeout

    def matters(self, index: int) -> bool:
        """Return True if the outcome of this request can still change the outcome of the batch."""
        return index < self.end

    def settle(self, index: int, outcome: Any) -> None:
        """Set the outcome of a request, unless it is ignored."""
        if index >= self.end or self.is_done:
            return
        self.outcomes[index] = outcome
        self._open -= 1
        if isinstance(outcome, BaseException) and not (
            self.go_on and isinstance(outcome, ModbusError)
        ):
            self._cut(index + 1)
        if not self._open:
            self.finish()

    def _cut(self, end: int) -> None:
        """Ignore the requests from this index on."""
        self._open -= sum(each is NOT_ASKED for each in self.outcomes[end : self.end])
        self.end = end

    def fail(self, error: BaseException) -> None:
        """End the batch, with this error as the outcome of all requests that have none yet."""
        for index in range(self.end):
            if self.outcomes[index] is NOT_ASKED:
                self.outcomes[index] = error
        if not self.pdus and isinstance(error, ModbusError):
            self.refusal = error
        self.finish()

    def finish(self) -> None:
        """End the batch; requests without an outcome do not get one."""
        if not self.is_done:
            self.is_done = True
            self.end = 0
            if self.on_done is not None:
                self.on_done(self)


def encoded(request: object, name: str, index: int, is_broadcast: bool) -> bytes:
    """
    Check and encode a request.

    Raises:
        TypeError, ValueError: the request cannot be sent.
    """
    if not isinstance(request, Request):
        given = type(request).__name__
        raise TypeError(f"{name.format(index)} must be a request object of pdu, not {given}")
    if is_broadcast and not request.is_write:
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
