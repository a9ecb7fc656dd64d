"""The result of listening: a request, its response, and how it ended; and counts of these."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from ...protocol.errors import ExceptionResponse, FrameError, InvalidResponse, ModbusError
from ...protocol.framing import Frame
from ...protocol.pdu import RawRequest, Request, decode_request

Kind = Literal[
    "answered",  # the response fits the request
    "exception",  # the unit answered with an exception
    "invalid",  # the response does not fit the request, or a frame has no valid function code
    "late",  # the response came after the request had been reported as unanswered
    "unanswered",  # no response came before the next request, or for several seconds
    "broadcast",  # a request that no unit answers: one to unit 0, or one that demands silence
    "damaged",  # bytes that are not a frame, instead of a response or without a request
    "unasked",  # a response without a known request, or a second one
]

Part = Literal["request", "response", "damage"]


class TimedFrame(NamedTuple):
    """A request, a response, or damaged bytes, with the times of the first and the last byte."""

    began: float
    ended: float
    part: Part
    frame: Frame | None
    data: bytes = b""


OnHeard = Callable[[TimedFrame], object]


@dataclass(frozen=True, slots=True)
class Transaction:
    """
    A request and its response, or one of them alone.

    Attributes:
        time: the time of its first byte, in seconds since the epoch.
        kind: how it ended: one of `Kind`.
        unit: 0..255; None for damaged bytes alone.
        function: the function code, 1..127, or None.
        request: the request object, which is a `RawRequest` if a server would refuse to decode
            it; None without a request.
        response: the result that the client's method would return; None without a response.
        error: an ExceptionResponse if the server refused the request, an InvalidResponse if the
            response is wrong, a FrameError with the damaged bytes (`received`); otherwise None.
        duration: seconds from the end of the request to the end of the response, or None.
        repeats: how often the same request had been sent before without a response.
    """

    time: float
    kind: Kind
    unit: int | None = None
    function: int | None = None
    request: Request[Any] | None = None
    response: Any = None
    error: ModbusError | None = None
    duration: float | None = None
    repeats: int = 0

    @property
    def is_good(self) -> bool:
        """True if nothing is wrong: answered at the first attempt, or a broadcast."""
        return self.kind in ("answered", "broadcast") and not self.repeats

    def __str__(self) -> str:
        where = "" if self.unit is None else f"unit {self.unit}: "
        question = "" if self.request is None else f"{self.request} "
        again = f" (repeat {self.repeats})" if self.repeats else ""
        return f"{where}{question}-> {self.outcome()}{again}"

    def outcome(self, show: Callable[[Any], str] = repr) -> str:
        """
        Return in words how the transaction ended.

        Args:
            show: returns the text of a response.
        """
        if self.kind == "unanswered":
            return "no answer"
        if self.error is not None:
            text = str(self.error.args[0])
        elif self.kind in ("answered", "late", "unasked"):
            text = "done" if self.response is None else show(self.response)
        else:
            return self.kind
        return text if self.kind in ("answered", "exception") else f"{self.kind}: {text}"


class Ending(NamedTuple):
    """The end of a request; the attributes are those of `Transaction`."""

    kind: Kind
    response: Any = None
    error: ModbusError | None = None


def decoded(pdu: bytes) -> Request[Any] | None:
    """Decode a request as a server does, or as a `RawRequest`; None if a server refuses it."""
    try:
        return decode_request(pdu)
    except ExceptionResponse as refusal:
        is_unknown = refusal.code == 1 and 0 < pdu[0] < 0x80
        return RawRequest.decode(pdu) if is_unknown else None


def ending_of(request: Request[Any], pdu: bytes) -> Ending:
    """Decode the response to a request as a client does."""
    try:
        return Ending("answered", request.decode_response(pdu))
    except ExceptionResponse as refusal:
        return Ending("exception", None, refusal)
    except InvalidResponse as error:
        error.received = pdu
        return Ending("invalid", None, error)


def damage_transaction(began: float, data: bytes) -> Transaction:
    """Return the transaction for bytes that are not a frame and belong to no request."""
    size = len(data)
    why = f"{size} bytes that are not a frame" if size > 1 else "a byte that is not a frame"
    return Transaction(began, "damaged", error=FrameError(why, received=data))


def misuse_transaction(began: float, frame: Frame) -> Transaction:
    """Return the transaction for a frame whose function code is not allowed."""
    code = frame.pdu[0]
    error = InvalidResponse(f"a frame with function code {code:02X}h", received=frame.pdu)
    return Transaction(began, "invalid", frame.unit, error=error)


def unasked_response(began: float, frame: Frame) -> Transaction:
    """Return the transaction for a response that belongs to no request."""
    unit, pdu, _ = frame
    function, response, error = pdu[0] & 0x7F, None, None
    if pdu[0] & 0x80 and len(pdu) == 2:
        error = ExceptionResponse.of(pdu[1], unit=unit, function=function)
    else:
        response = pdu[1:]
    return Transaction(began, "unasked", unit, function, response=response, error=error)


@dataclass
class AnswerTimes:
    """The number of responses of a unit, and their times in seconds; 0 before the first."""

    count: int = 0
    shortest: float = 0.0
    longest: float = 0.0
    total: float = 0.0

    @property
    def mean(self) -> float:
        return self.total / self.count if self.count else 0.0

    def add_time(self, seconds: float) -> None:
        self.shortest = min(self.shortest, seconds) if self.count else seconds
        self.longest = max(self.longest, seconds)
        self.total += seconds
        self.count += 1


@dataclass
class UnitSummary:
    """The traffic of one unit; an error is a kind of transaction or "exception N"."""

    transactions: int = 0
    functions: Counter[int] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    repeats: int = 0
    times: AnswerTimes = field(default_factory=AnswerTimes)

    def add_transaction(self, transaction: Transaction) -> None:
        """Count a transaction of this unit; the request of a late response is counted already."""
        if transaction.kind not in ("late", "unasked"):
            self.transactions += 1
            self.repeats += transaction.repeats > 0
            self.functions[transaction.function or 0] += 1
        if transaction.kind == "exception" and isinstance(transaction.error, ExceptionResponse):
            self.errors[f"exception {transaction.error.code}"] += 1
        elif transaction.kind not in ("answered", "broadcast"):
            self.errors[transaction.kind] += 1
        if transaction.kind in ("answered", "exception") and transaction.duration is not None:
            self.times.add_time(transaction.duration)

    def __str__(self) -> str:
        functions = ", ".join(f"{code} ({count})" for code, count in sorted(self.functions.items()))
        errors = ", ".join(f"{count} {name}" for name, count in self.errors.most_common())
        times = (self.times.shortest, self.times.mean, self.times.longest)
        took = " / ".join(f"{time * 1000:.1f}" for time in times) + " ms (shortest, mean, longest)"
        return (
            f"{self.transactions} transactions, {self.repeats} repeats\n"
            f"  functions     {functions or '-'}\n"
            f"  answer times  {took if self.times.count else '-'}\n"
            f"  errors        {errors or 'none'}"
        )


@dataclass
class Summary:
    """
    The traffic so far.

    Attributes:
        transactions: the number of transactions of all units.
        damaged: the number of runs of bytes that are not a frame and belong to no request.
        units: ``{unit 0..255: summary of the unit}``.
    """

    damaged: int = 0
    units: dict[int, UnitSummary] = field(default_factory=dict)

    @property
    def transactions(self) -> int:
        return sum(unit.transactions for unit in self.units.values())

    def add_transaction(self, transaction: Transaction) -> None:
        """Count one more."""
        if transaction.unit is None:
            self.damaged += 1
        else:
            self.units.setdefault(transaction.unit, UnitSummary()).add_transaction(transaction)

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as a dict that JSON can represent; times are in seconds."""
        return {
            "transactions": self.transactions,
            "damaged": self.damaged,
            "units": {
                str(number): {
                    "transactions": unit.transactions,
                    "functions": {str(code): count for code, count in unit.functions.items()},
                    "errors": dict(unit.errors),
                    "repeats": unit.repeats,
                    "shortest": unit.times.shortest,
                    "mean": unit.times.mean,
                    "longest": unit.times.longest,
                }
                for number, unit in sorted(self.units.items())
            },
        }

    def __str__(self) -> str:
        lines = [f"{self.transactions} transactions, {self.damaged} runs of damaged bytes"]
        lines += [f"unit {number}: {unit}" for number, unit in sorted(self.units.items())]
        return "\n".join(lines)
