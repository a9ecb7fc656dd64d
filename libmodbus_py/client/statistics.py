"""
Counters of a connection.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from dataclasses import dataclass, field

from ..protocol.errors import ExceptionResponse, ModbusConnectionError, ModbusTimeoutError

__all__ = ["RESULTS", "TIME_BOUNDS", "Statistics", "result_of"]

TIME_BOUNDS: tuple[float, ...] = (
    *(0.000_1, 0.000_25, 0.000_5, 0.001, 0.002_5, 0.005, 0.01, 0.025, 0.05, 0.1),
    *(0.25, 0.5, 1.0, 2.5, 5.0, 10.0),
)
"""Answers are counted by how many seconds they took at most; the last count is of the rest."""

RESULTS = ("ok", "exception", "timeout", "invalid", "lost", "cancelled", "silent", "unsent")
"""The results of requests; see `Statistics`."""


@dataclass(slots=True, weakref_slot=True)
class Statistics:
    """
    Counters of a connection since the client was made; read only.

    Attributes:
        requests: requests that were sent, repetitions included.
        responses: valid responses, exception responses included.
        exceptions: exception responses.
        timeouts: requests that got no response in time.
        retries: requests that were sent again.
        echoes: 1 if the connection was found to return what is sent on it (local echo).
        late_answers: responses to requests that had been given up; they were dropped.
        invalid: runs of bytes that were no frame, and frames that were no valid response.
        connects: connections that were established.
        failed_connects: attempts to connect that failed.
        lost: connections that ended by themselves, were given up as dead, or were abandoned
            because of Ctrl-C or a fork.
        last_success: the time of the last valid response (time.monotonic), or None.
        results: ``{(function, result): number}`` of completed requests; each repetition counts.
            Results are "ok"; "exception", the server refused; "timeout"; "invalid", the response
            was not valid; "lost", the connection was lost; "cancelled", the caller gave up;
            "silent", the request gets no response; and "unsent", there was no connection.
        answer_times: a histogram of the response times: the number of `responses` that took up
            to the first of `client.statistics.TIME_BOUNDS` seconds, of those that took longer, up
            to the second, and so on; the last item counts those above all bounds.
        answer_seconds: the sum of all response times, from sending to the response, in seconds.
    """

    requests: int = 0
    exceptions: int = 0
    timeouts: int = 0
    retries: int = 0
    echoes: int = 0
    late_answers: int = 0
    invalid: int = 0
    connects: int = 0
    failed_connects: int = 0
    lost: int = 0
    last_success: float | None = None
    answer_times: list[int] = field(
        default_factory=lambda: [0] * (len(TIME_BOUNDS) + 1), repr=False
    )
    answer_seconds: float = field(default=0.0, repr=False)
    # The good results by function, by far the most; and the other results.
    _good: list[int] = field(default_factory=lambda: [0] * 256, repr=False)
    _others: defaultdict[tuple[int, str], int] = field(
        default_factory=lambda: defaultdict(int), repr=False
    )

    @property
    def responses(self) -> int:
        return sum(self.answer_times)

    @property
    def results(self) -> defaultdict[tuple[int, str], int]:
        """The number of completed requests by function and result, each time counted anew."""
        results = self._others.copy()
        results |= {(function, "ok"): count for function, count in enumerate(self._good) if count}
        return results

    def note(self, function: int, result: str) -> None:
        """Count the result of a request, other than "ok"."""
        self._others[function, result] += 1

    def note_answer(
        self, function: int, seconds: float, now: float, other: str | None = None
    ) -> None:
        """Count a response that came now, after so many seconds; `other` is its result but "ok"."""
        self.last_success = now
        if other is None:
            self._good[function] += 1
        else:
            self._others[function, other] += 1
        self.answer_times[bisect_left(TIME_BOUNDS, seconds)] += 1
        self.answer_seconds += seconds


def result_of(error: Exception) -> str:
    """Return the result of a request that failed."""
    for kind, result in _FAILURES:
        if isinstance(error, kind):
            return result
    return "invalid"


_FAILURES: tuple[tuple[type[Exception], str], ...] = (
    (ExceptionResponse, "exception"),
    (ModbusTimeoutError, "timeout"),
    (ModbusConnectionError, "lost"),
)
