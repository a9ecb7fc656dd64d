"""
A line of a gateway: requests as it forwards them, joined reads, cached responses, and units that
rest.

1. A read is answered with a cached response that is not older than its route allows, and was asked
   after the last write to the unit.
2. Equal reads that wait are sent once (`merge`). No read joins one that was sent, or one that was
   given before a write to the unit.
3. A unit or function without an answer is paused (`SilentUnits`); requests that wait for it are
   refused.
"""

from __future__ import annotations

import math
import time
from collections.abc import Hashable
from functools import lru_cache, partial
from typing import Any, Protocol

from ...client.asynchronous import AsyncClient
from ...client.reconnecting import State
from ...client.sender import Sender
from ...device.authorization import LimitedLog
from ...ports.endpoint import Endpoint
from ...ports.port import Outage
from ...protocol import errors, pdu
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.logs import HarmlessLogger
from ..line import FairQueue, LineRequest, SharedLine
from .routes import GatewayOptions
from .silent_units import SilentUnits, UnitState
from .statistics import LineStatistics, UnitStatistics

logger: HarmlessLogger = HarmlessLogger(__name__)

NO_ANSWER = errors.GatewayTargetFailedToRespond.code
BUSY = errors.ServerDeviceBusy.code

MAX_PAUSE_S = 2.0  # the longest pause between two attempts to open a port, unless its URL sets it
MOST_WAITING = 4096  # the most requests that wait, of all clients
MOST_CACHED = 4096  # the most responses that are kept; the oldest one is dropped for one more

REMEMBERED = 512
"""Requests that are decoded once, because pollers send the same ones again and again."""

READS = (pdu.ReadCoils, pdu.ReadDiscreteInputs, pdu.ReadHoldingRegisters, pdu.ReadInputRegisters)
"""Requests that change nothing, and may be answered from the cache."""


# --- requests as a gateway forwards them -------------------------------------------------------


class RequestBytes(pdu.Request[bytes]):
    """
    Any request PDU, unchanged, and the request that it is, if it can be decoded; its result is the
    response PDU, which must fit a known function, or else begin with the code of the function.
    """

    # fmt: off
    __slots__ = (
        "changes", "expects_response", "function", "is_read", "may_be_broadcast", "pdu",
        "pdu_request", "repeatable",
    )
    # fmt: on

    def __init__(self, data: bytes, request: pdu.Request[Any] | None) -> None:
        self.pdu: bytes = data
        self.pdu_request: pdu.Request[Any] | None = request
        self.function: int = data[0]  # type: ignore[misc]  # here it is data, not the class's own
        self.is_read: bool = isinstance(request, READS)
        is_write = request is not None and request.may_be_broadcast
        self.may_be_broadcast: bool = is_write  # type: ignore[misc]
        self.repeatable: bool = request is not None and request.repeatable  # type: ignore[misc]
        self.changes: bool = request is None or request.changes
        self.expects_response: bool = request is None or request.expects_response

    def encode(self) -> bytes:
        return self.pdu

    def decode_response(self, pdu: bytes) -> bytes:
        if self.pdu_request is not None:
            self.pdu_request.decode_response(pdu)
            if self.may_be_broadcast:  # a write, whose echo may have bytes behind it
                return pdu[: type(self.pdu_request).response_length(pdu) or None]
        elif not pdu or pdu[0] != self.function:
            raise self._refusal(pdu)
        return pdu

    def __str__(self) -> str:
        if self.pdu_request is not None:
            return str(self.pdu_request)
        return f"a request of {len(self.pdu)} bytes"


@lru_cache(REMEMBERED)
def request_of(data: bytes) -> RequestBytes:
    """
    Return a request PDU as a request that can be forwarded; raise an error if its end could not
    be found on a serial line. The device checks the rest, and may have functions of its own.
    """
    if not 1 <= data[0] <= 0x7F:
        raise errors.IllegalFunction(f"no function {data[0]}", function=data[0])
    if pdu.request_length(data) not in (len(data), 0):
        raise errors.IllegalDataValue(f"a request of {len(data)} bytes", function=data[0])
    try:
        return RequestBytes(data, pdu.decode_request(data))
    except ExceptionResponse:
        return RequestBytes(data, None)


class Requester(Hashable, Protocol):
    """Waits for a response PDU; a broadcast gets None."""

    @property
    def host(self) -> Hashable: ...

    def take_response(self, job: ForwardedRequest, response: bytes | None) -> None: ...


class ForwardedRequest(LineRequest):
    """The request of a client, whose transaction id is `number`, to a unit of a line."""

    __slots__ = ("age", "counters", "first", "from_unit", "number", "others", "requester")

    request: RequestBytes

    def __init__(
        self,
        requester: Requester,
        number: int,
        from_unit: int,
        unit: int,
        request: RequestBytes,
        since: float,
        age: float = 0.0,
    ) -> None:
        super().__init__(unit, request, host=requester.host, client=requester)
        self.waits_since = since
        self.requester: Requester | None = requester  # None once it is gone or was answered
        self.number: int = number
        self.from_unit: int = from_unit  # as the client numbers it
        self.age: float = age  # of a cached response, in seconds; 0 for none
        self.others: list[ForwardedRequest] = []  # equal requests that get the same response
        self.first: ForwardedRequest | None = (
            None  # the equal request that is sent in place of this one
        )
        self.counters: UnitStatistics  # once it was sent

    @property
    def is_wanted(self) -> bool:
        """True if a client waits for the response."""
        return any(job.requester is not None for job in (self, *self.others))

    @property
    def is_sent(self) -> bool:
        """False while it, or the equal request in its place, waits to be sent."""
        submitted = (self.first or self).submitted
        return submitted is not None and submitted.is_sent

    def answer(self, response: bytes | None) -> int:
        """Pass the response to all requesters; return how many have left."""
        departures = 0
        for job in (self, *self.others):
            requester, job.requester = job.requester, None
            job.first = None  # breaks a reference cycle
            if requester is None:
                departures += 1
            else:
                requester.take_response(job, response)
        return departures


class Cache:
    """Responses to reads, by unit and request; none that may be older than a write to its unit."""

    def __init__(self) -> None:
        self._answers: dict[tuple[int, bytes], tuple[float, bytes]] = {}
        # Unit -> the time of the last write; 0 for a write to all units.
        self._write_times: dict[int, float] = {}

    def get(self, unit: int, request: bytes, age: float, now: float) -> bytes | None:
        """Return a response that is at most `age` seconds old, or None."""
        entry = self._answers.get((unit, request))
        return entry[1] if entry is not None and now - entry[0] <= age else None

    def keep(self, unit: int, request: bytes, answer: bytes, asked_at: float) -> None:
        """Keep the response to a request that was sent at a time; it is no older."""
        if asked_at <= max(self._write_times.get(number, -math.inf) for number in (0, unit)):
            return
        key = unit, request
        self._answers.pop(key, None)
        self._answers[key] = asked_at, answer
        if len(self._answers) > MOST_CACHED:
            del self._answers[next(iter(self._answers))]

    def forget(self, unit: int, now: float) -> None:
        """Drop the responses of a unit that may be written to; those of all units for unit 0."""
        self._write_times[unit] = now
        for key in [key for key in self._answers if unit in (0, key[0])]:
            del self._answers[key]


class GatewayLine(SharedLine[ForwardedRequest]):
    """Sends the requests of clients over one connection."""

    def __init__(self, endpoint: Endpoint, options: GatewayOptions) -> None:
        pause = endpoint.client_options.get("max_pause", MAX_PAUSE_S)
        super().__init__(
            Sender(AsyncClient(endpoint.url, max_pause=pause, on_state=self._note_state)),
            partial(FairQueue, options.queue, MOST_WAITING),
            longest_wait=options.longest_wait,
        )
        self.url: str = str(endpoint)
        self.endpoint: Endpoint = endpoint
        self.statistics: LineStatistics = LineStatistics(self.url, self.client.statistics)
        self._has_broadcast = self.sender.has_broadcast
        self._writes_first = options.writes_first
        self._silent = SilentUnits(self.client.timeout)
        self._cache = Cache()
        # Reads that others may join while they wait.
        self._joinable: dict[tuple[int, bytes], ForwardedRequest] = {}
        self._outage = Outage(logger, self.url)
        self._log = LimitedLog(logger)
        self._open_since = 0.0

    # --- requests -----------------------------------------------------------------------------

    def cached_response(
        self, unit: int, request: RequestBytes, age: float, now: float
    ) -> bytes | None:
        """Return a cached response that is no older than `age` seconds, or None."""
        answer = self._cache.get(unit, request.pdu, age, now)
        if answer is not None:
            self.statistics.unit(unit).cached += 1
        return answer

    def put(self, job: ForwardedRequest, *, merge: bool = False) -> int:
        """Enqueue a request; return 0, or the code of the exception that answers it at once."""
        unit, request, now = job.unit, job.request, job.waits_since
        if self.is_closed or (self._is_broadcast(job) and not request.may_be_broadcast):
            return NO_ANSWER
        state = self._silent.state(unit, request.function, now)
        if state is UnitState.PAUSED:
            self.statistics.unit(unit).refused += 1
            return NO_ANSWER
        if not request.is_read:
            self._note_write(unit, now)
        if state is UnitState.DUE:
            job.is_trial = True
            job.misses = self._silent.start_trial(unit, request.function)
        elif merge and self._join(job):
            return 0
        job.is_urgent = self._writes_first and not (request.is_read or job.is_trial)
        is_queued = self.ask(job, now)
        if not is_queued:
            self._forget_joinable(job)
            self.statistics.full += 1
        self._count()
        return 0 if is_queued else BUSY

    def leave(self, job: ForwardedRequest) -> None:
        """Do not send the request of a client that is gone, unless others wait for it."""
        job.requester = None
        job = job.first or job
        if not job.is_wanted and self.drop(job):
            self._forget_joinable(job)
            self._count()
            if job.is_trial:
                self._silent.cancel_trial(job.unit, job.request.function, self._loop.time())

    async def close(self) -> None:
        """Close the connection for good, and refuse all requests that wait."""
        for job in self.stop():
            self._refuse(job, NO_ANSWER)
        await super().close()

    def go_on(self, now: float | None = None) -> None:
        super().go_on(now)
        self._count()

    def _count(self) -> None:
        self.statistics.waiting, self.statistics.in_flight = self.waiting, len(self.in_flight)

    def _is_broadcast(self, job: ForwardedRequest) -> bool:
        return job.unit == 0 and self._has_broadcast

    def _join(self, job: ForwardedRequest) -> bool:
        """Join an equal read that waits, if there is one; else later ones may join this one."""
        first = self._joinable.setdefault((job.unit, job.request.pdu), job)
        if first is job:
            return False
        first.others.append(job)
        job.first = first
        first.waits_since = job.waits_since  # it must not be refused before the last is
        self.statistics.unit(job.unit).merged += 1
        return True

    def _forget_joinable(self, job: ForwardedRequest) -> None:
        """Let no later read join a request that does not wait any more."""
        if self._joinable.get((job.unit, job.request.pdu)) is job:
            del self._joinable[job.unit, job.request.pdu]

    def _note_write(self, unit: int, now: float) -> None:
        """Forget what was read before a write, and have no later read join an earlier one."""
        self._cache.forget(unit, now)
        for key in [key for key in self._joinable if unit in (0, key[0])]:
            del self._joinable[key]

    def _send(self, job: ForwardedRequest, now: float) -> None:
        self._forget_joinable(job)
        job.counters = self.statistics.unit(job.unit)
        job.counters.requests += 1
        super()._send(job, now)

    # --- responses ----------------------------------------------------------------------------

    def conclude(self, job: ForwardedRequest, outcome: Any, now: float) -> None:
        function = job.request.function
        if not job.request.is_read:
            self._note_write(job.unit, now)
        if outcome is None:  # a broadcast
            if job.is_trial:
                self._silent.cancel_trial(job.unit, function, now)
            self._answer(job, None)
        elif isinstance(outcome, bytes):
            self._note_answer(job, now)
            if job.age:
                self._cache.keep(job.unit, job.request.pdu, outcome, job.asked_at)
            self._answer(job, outcome)
        elif isinstance(outcome, ExceptionResponse):
            self._note_answer(job, now)
            job.counters.exceptions += 1
            self._refuse(job, outcome.code)
        else:
            if self._count_failure(job, outcome, now) or job.is_trial:
                self._note_silence(job, now, f": {outcome.args[0]}" if outcome.args else "")
            is_ours = not isinstance(outcome, ModbusError)
            self._refuse(job, errors.ServerDeviceFailure.code if is_ours else NO_ANSWER)

    def give_up(self, job: ForwardedRequest, now: float) -> None:
        job.counters.given_up += 1
        self._note_silence(job, now)
        self._refuse(job, NO_ANSWER)

    def expire(self, job: ForwardedRequest, now: float) -> None:
        self.statistics.full += 1
        self._refuse(job, BUSY)

    def _note_answer(self, job: ForwardedRequest, now: float) -> None:
        unit = job.counters
        unit.answers += 1
        unit.seconds += now - job.asked_at
        if self._silent.note_answer(job.unit, job.request.function):
            what = "" if unit.is_silent else f" function {job.request.function}"
            unit.is_silent = False
            logger.info("%s: unit %d answers%s again", self.url, job.unit, what)

    def _count_failure(self, job: ForwardedRequest, error: BaseException, now: float) -> bool:
        """Count a failure; return True if the unit was silent for most of its timeout."""
        if isinstance(error, errors.ModbusTimeoutError):
            job.counters.timeouts += 1
            # The connection may have taken the first part of it.
            return now - max(job.asked_at, self._open_since) >= self.client.timeout / 2
        if isinstance(error, errors.FrameError | errors.InvalidResponse):
            job.counters.invalid += 1
            self._log.warning("%s: unit %d: %s", self.url, job.unit, error.args[0])
        elif isinstance(error, errors.ModbusConnectionError):
            job.counters.lost += 1
        else:
            logger.error("%s: %s failed", self.url, job.request, exc_info=error)
        return False

    def _note_silence(self, silent: ForwardedRequest, now: float, reason: str = "") -> None:
        """Pause the unit or function that gave no answer, and refuse what waits for it."""
        unit, function = silent.unit, silent.request.function
        if self._is_broadcast(silent):
            return
        is_new = self._silent.note_silence(unit, function, now)
        is_whole = self._silent.is_paused(unit)
        if is_new:
            what = "" if is_whole else f" function {function}"
            logger.info("%s: unit %d does not answer%s%s", self.url, unit, what, reason)
        self.statistics.unit(unit).is_silent = is_whole
        for job in [*self.others(), *self.in_flight]:
            is_same = job.unit == unit and (is_whole or job.request.function == function)
            if is_same and not (job.is_trial or job.is_sent):
                self.withdraw(job)
                self.statistics.unit(unit).refused += 1
                self._refuse(job, NO_ANSWER)

    def _refuse(self, job: ForwardedRequest, code: int) -> None:
        self._forget_joinable(job)
        self._answer(job, bytes([job.request.function | 0x80, code]))

    def _answer(self, job: ForwardedRequest, response: bytes | None) -> None:
        self.statistics.unwanted += job.answer(response)

    # --- the connection -----------------------------------------------------------------------

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        if error is not None:
            self._outage.begin(error)
        elif state is State.CONNECTED:
            self._open_since = self._loop.time()
            self._outage.end()
        else:
            return
        if (error is None) is bool(self.statistics.trouble) or not self.statistics.since:
            self.statistics.since = time.time()
        self.statistics.trouble = "" if error is None else str(error)
