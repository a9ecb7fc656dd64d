"""
A line of a gateway: one client, and the requests that wait for it.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Hashable
from functools import partial
from typing import Any, Protocol

from ...client.asynchronous import AsyncClient, Submitted
from ...client.reconnecting import State
from ...ports.endpoint import Endpoint
from ...ports.port import Outage
from ...ports.waiting_async import Alarm
from ...protocol.errors import (
    ExceptionResponse,
    FrameError,
    GatewayTargetFailedToRespond,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    ServerDeviceFailure,
)
from ...protocol.logs import HarmlessLogger
from ..waiting_room import FairByHost, Precedence, WaitingRoom
from .cache import Cache
from .options import GatewayOptions
from .raw_request import RequestBytes
from .silent_units import SilentUnits, UnitState
from .statistics import LineStatistics, UnitStatistics

__all__ = ["Forwarded", "GatewayLine", "Requester"]

logger: HarmlessLogger = HarmlessLogger(__name__)

NO_ANSWER = GatewayTargetFailedToRespond.code
BUSY = ServerDeviceBusy.code

# The longest pause between two attempts to open a port, in seconds, unless its URL sets it.
MAX_PAUSE = 2.0

# How many timeouts a unit rests at first: its late answer may come within that time.
FIRST_REST = 2

# The most requests that wait, of all clients.
MOST_WAITING = 4096


class Requester(Hashable, Protocol):
    """Waits for a response."""

    @property
    def host(self) -> Hashable: ...

    def told(self, forwarded: Forwarded, response: bytes | None) -> None:
        """Take the response PDU; None for a broadcast, which gets none."""
        ...


class Forwarded:
    """
    A request that a gateway forwards.

    Args:
        asker: takes the response; None after the client is gone or was answered.
        number: the transaction id of its client.
        from_unit: the unit that the client asked.
        unit: its number on the line.
        age: how old a cached response may be, in seconds; 0 for none.

    Attributes:
        waits_since: when it began to wait.
        asked_at: when it was sent.
        misses: how many times in a row its unit gave no answer, if this is a trial.
        counters: those of its unit, once it was sent.
        others: equal requests that get the same response.
        first: the equal request that is sent in place of this one; None for this one itself.
    """

    # fmt: off
    __slots__ = (
        "age", "asked_at", "asker", "client", "counters", "first", "from_unit", "host", "is_trial",
        "misses", "number", "others", "request", "state", "submitted", "unit", "waits_since",
    )
    # fmt: on

    def __init__(
        self,
        asker: Requester,
        number: int,
        from_unit: int,
        unit: int,
        request: RequestBytes,
        since: float,
        age: float = 0.0,
    ) -> None:
        self.asker: Requester | None = asker
        self.host: Hashable = asker.host
        self.client: Hashable = asker
        self.number: int = number
        self.from_unit: int = from_unit
        self.unit: int = unit
        self.request: RequestBytes = request
        self.waits_since: float = since
        self.age: float = age
        self.others: list[Forwarded] = []
        self.first: Forwarded | None = None
        self.is_trial: bool = False
        self.misses: int = 0
        self.asked_at: float = 0.0
        self.state: int = 0
        self.submitted: Submitted | None = None
        self.counters: UnitStatistics

    @property
    def is_wanted(self) -> bool:
        """True if a client waits for the response."""
        return any(each.asker is not None for each in (self, *self.others))

    @property
    def is_sent(self) -> bool:
        """False while it, or the equal request in its place, waits to be sent."""
        submitted = (self.first or self).submitted
        return submitted is not None and submitted.is_sent

    def tell(self, response: bytes | None) -> int:
        """Pass the response to all that wait for it; return how many do not wait any more."""
        told = 0
        for each in (self, *self.others) if self.others else (self,):
            asker, each.asker = each.asker, None
            each.first = None  # breaks a reference cycle
            if asker is None:
                told += 1
            else:
                asker.told(each, response)
        return told


class GatewayLine:
    """
    Sends the requests of clients over one connection.

    Args:
        endpoint: of the connection, with the options of its client.
        options: how requests wait.

    Raises:
        TypeError, ValueError: an option that such a client cannot have.
    """

    def __init__(self, endpoint: Endpoint, options: GatewayOptions) -> None:
        pause = endpoint.client_options.get("max_pause", MAX_PAUSE)
        client = AsyncClient(endpoint.url, max_pause=pause, on_state=self._note_state)
        self._client = client
        self._longest_wait = options.longest_wait
        self._loop = asyncio.get_running_loop()
        self.url: str = str(endpoint)
        self.key: str = endpoint.url
        self.host: str = endpoint.host
        self.has_broadcast: bool = not self._client.has_ids
        self.statistics: LineStatistics = LineStatistics(self.url, self._client.statistics)
        queues = [FairByHost[Forwarded](options.queue, MOST_WAITING) for _ in range(2)]
        self._room: WaitingRoom[Forwarded] = WaitingRoom(
            lambda: client.room,
            Precedence(queues, _reads_last) if options.writes_first else queues[0],
            timeout=lambda each: self._client.timeout,
            ready_at=self._ready_at if self.has_broadcast else None,
        )
        self._silent = SilentUnits(FIRST_REST * self._client.timeout)
        self._cache = Cache()
        # Reads that others may join while they wait.
        self._joinable: dict[tuple[int, bytes], Forwarded] = {}
        self._done: list[Forwarded] = []
        self._alarm = Alarm(self._go_on)
        self._outage = Outage(logger, self.url)
        self._open_since = 0.0
        self.is_closed: bool = False

    # --- requests -----------------------------------------------------------------------------

    def cached(self, unit: int, request: RequestBytes, age: float, now: float) -> bytes | None:
        """Return a cached response that is no older than `age` seconds, or None."""
        answer = self._cache.get(unit, request.pdu, age, now)
        if answer is not None:
            self.statistics.unit(unit).cached += 1
        return answer

    def put(self, each: Forwarded, *, merge: bool = False) -> int:
        """Enqueue a request; return 0, or the code of the exception that answers it at once."""
        unit, now = each.unit, each.waits_since
        is_broadcast = unit == 0 and self.has_broadcast
        if self.is_closed or (is_broadcast and not each.request.is_write):
            return NO_ANSWER
        function = each.request.function
        state = UnitState.GOOD
        if (unit, function) not in self._silent.answering:
            state = self._silent.state(unit, function, now)
        if state is UnitState.RESTING:
            self.statistics.unit(unit).resting += 1
            return NO_ANSWER
        if not each.request.is_read:
            self._note_write(unit)
        if state is UnitState.DUE:
            each.is_trial = True
            each.misses = self._silent.start_trial(unit, function)
            self._room.put(each)
        elif not (merge and self._join(each)):
            if self._room.begin(each, now):
                self._ask(each, now)
                return 0
            if not self._room.put(each):
                self.statistics.full += 1
                return BUSY
            self.statistics.waiting += 1
            if merge and each.request.is_read:
                self._joinable[unit, each.request.pdu] = each
        self._go_on()
        return 0

    def drop(self, each: Forwarded) -> None:
        """Do not send the request of a client that is gone, unless others wait for it."""
        each.asker = None
        each = each.first or each
        if each.is_wanted:
            return
        if each.submitted is not None:
            if not each.submitted.send_no_more():
                return
            self._end(each)
            self._go_on_soon()
        elif not self._room.remove(each):
            return
        elif not each.is_trial:
            self._leave(each)
        if each.is_trial:
            self._silent.cancel_trial(each.unit, each.request.function, self._loop.time())

    async def close(self) -> None:
        """Close the connection for good, and refuse all requests that wait."""
        self.is_closed = True
        for each in self._room.clear():
            if not each.is_trial:
                self._leave(each)
            self._refuse(each, NO_ANSWER)
        self._alarm.cancel()
        await self._client.close()
        self._finish()

    def _join(self, each: Forwarded) -> bool:
        first = self._joinable.get((each.unit, each.request.pdu))
        if first is None:
            return False
        first.others.append(each)
        each.first = first
        self.statistics.unit(each.unit).merged += 1
        return True

    def _leave(self, each: Forwarded) -> None:
        """Note that a request does not wait any more."""
        self.statistics.waiting -= 1
        if self._joinable:
            self._joinable.pop((each.unit, each.request.pdu), None)

    def _note_write(self, unit: int) -> None:
        """Forget what was read before a write, and have no later read join an earlier one."""
        self._cache.forget(unit)
        for key in [key for key in self._joinable if unit in (0, key[0])]:
            del self._joinable[key]

    # --- sending ----------------------------------------------------------------------------

    def _go_on(self) -> None:
        now = self._loop.time()
        while (each := self._room.pick(now)) is not None:
            if not each.is_trial:
                self._leave(each)
            if each.is_trial or now - each.waits_since <= self._longest_wait:
                self._room.start(each)
                self._ask(each, now)
            else:
                self.statistics.full += 1
                self._refuse(each, BUSY)
        if self._room.trying and (trial := self._room.overstayed(now)) is not None:
            self._make_way(trial, now)
        if self._room.alarm < self._alarm.at:
            self._alarm.set(self._room.alarm, self._loop)

    def _ask(self, each: Forwarded, now: float) -> None:
        each.asked_at = now
        if each.age:
            each.state = self._cache.state(each.unit)
        self.statistics.in_flight += 1
        counters = self.statistics.units.get(each.unit)
        each.counters = self.statistics.unit(each.unit) if counters is None else counters
        each.counters.requests += 1
        each.submitted = self._client.submit(
            each.unit, each.request, partial(self._note_done, each)
        )

    def _note_done(self, each: Forwarded) -> None:
        self._go_on_soon()
        self._done.append(each)

    def _go_on_soon(self) -> None:
        if not self._done:
            self._loop.call_soon(self._finish)

    def _make_way(self, each: Forwarded, now: float) -> None:
        """End a trial of a silent unit, because other requests waited for long enough."""
        assert each.submitted is not None
        if each.submitted.is_answered or each in self._done:
            return
        each.submitted.withdraw()
        self._end(each)
        self._note_silence(each, now)
        self.statistics.unit(each.unit).given_up += 1
        self._refuse(each, NO_ANSWER)
        self._go_on()

    # --- responses ----------------------------------------------------------------------------

    def _finish(self) -> None:
        done, self._done = self._done, []
        now = self._loop.time()
        for each in done:
            assert each.submitted is not None
            outcome: Any = each.submitted.outcome
            is_answer = isinstance(outcome, bytes | ExceptionResponse)
            self._end(each, now - each.asked_at if is_answer else None)
            self._conclude(each, outcome, now)
        if not self.is_closed:
            self._go_on()

    def _end(self, each: Forwarded, took: float | None = None) -> None:
        self._room.end(each, took)
        self.statistics.in_flight -= 1

    def _conclude(self, each: Forwarded, outcome: Any, now: float) -> None:
        if not each.request.is_read:
            self._note_write(each.unit)
        if isinstance(outcome, bytes | ExceptionResponse):
            self._note_answer(each, each.counters, now)
        if isinstance(outcome, bytes):
            if each.age:
                self._cache.keep(each.unit, each.request.pdu, outcome, each.asked_at, each.state)
            self.statistics.unwanted += each.tell(outcome)
        elif outcome is None:  # a broadcast
            if each.is_trial:
                self._silent.cancel_trial(each.unit, each.request.function, now)
            each.tell(None)
        elif isinstance(outcome, ExceptionResponse):
            each.counters.exceptions += 1
            self._refuse(each, outcome.code)
        else:
            self._note_failure(each, outcome, each.counters, now)
            is_ours = not isinstance(outcome, ModbusError)
            self._refuse(each, ServerDeviceFailure.code if is_ours else NO_ANSWER)

    def _note_answer(self, each: Forwarded, unit: UnitStatistics, now: float) -> None:
        unit.answers += 1
        unit.seconds += now - each.asked_at
        asked = each.unit, each.request.function
        if asked not in self._silent.answering and self._silent.note_answer(*asked):
            what = "" if unit.is_silent else f" function {each.request.function}"
            unit.is_silent = False
            logger.info("%s: unit %d answers%s again", self.url, each.unit, what)

    def _note_failure(
        self, each: Forwarded, error: BaseException, unit: UnitStatistics, now: float
    ) -> None:
        if isinstance(error, ModbusTimeoutError):
            unit.timeouts += 1
            if each.is_trial or self._had_time(each, now):
                self._note_silence(each, now)
            return
        if isinstance(error, FrameError | InvalidResponse):
            unit.invalid += 1
        elif isinstance(error, ModbusConnectionError):
            unit.lost += 1
        else:
            logger.error("%s: %s failed", self.url, each.request, exc_info=error)
        if each.is_trial:
            self._note_silence(each, now)

    def _ready_at(self, each: Forwarded) -> float:
        return self._client.ready_at(each.unit, each.request.function)

    def _had_time(self, each: Forwarded, now: float) -> bool:
        """Return False if a request waited for the connection for most of its timeout."""
        return now - max(each.asked_at, self._open_since) >= self._client.timeout / 2

    def _note_silence(self, silent: Forwarded, now: float) -> None:
        """Let what gave no answer rest, and refuse the requests that wait for it."""
        unit, function = silent.unit, silent.request.function
        if unit == 0 and self.has_broadcast:
            return
        is_new = self._silent.note_silence(unit, function, now)
        is_whole = self._silent.rests(unit)
        if is_new:
            what = "" if is_whole else f" function {function}"
            logger.info("%s: unit %d does not answer%s", self.url, unit, what)
        self.statistics.unit(unit).is_silent = is_whole
        for each in self._room.others:
            if each.unit == unit and (is_whole or each.request.function == function):
                self._room.remove(each)
                self._leave(each)
                self.statistics.unit(unit).resting += 1
                self._refuse(each, NO_ANSWER)

    def _refuse(self, each: Forwarded, code: int) -> None:
        self.statistics.unwanted += each.tell(bytes([each.request.function | 0x80, code]))

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        if error is not None:
            self._tell_state(str(error))
            self._outage.begin(error)
        elif state is State.CONNECTED:
            self._tell_state("")
            self._open_since = self._loop.time()
            self._outage.end()

    def _tell_state(self, trouble: str) -> None:
        if bool(trouble) != bool(self.statistics.trouble) or not self.statistics.since:
            self.statistics.since = time.time()
        self.statistics.trouble = trouble


def _reads_last(each: Forwarded) -> int:
    return int(each.request.is_read)
