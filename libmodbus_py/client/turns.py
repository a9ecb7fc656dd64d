"""
Who may ask when, on one connection: the queue, the repetitions, the pace.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass

from ..ports.endpoint import Endpoint
from ..ports.trace import Trace
from ..protocol.errors import ModbusConnectionError, ModbusError
from ..protocol.framing import Framer, Framing
from .batch import Batch, Pending, Reply
from .reconnecting import Reconnecting
from .statistics import Statistics

__all__ = ["Pace", "Turns"]

# So many bytes that nobody asked for, and whoever sends them floods.
MAX_UNASKED = 1 << 16


@dataclass(frozen=True, slots=True)
class Pace:
    """
    How fast requests follow each other; seconds.

    Attributes:
        turnaround: that a request takes which nobody answers.
        request_spacing: between the starts of two requests, at least.
        connect_delay: between connecting and the first request.
        timeouts_before_reconnect: in a row, for a connection to count as dead; a serial
            port never does.
    """

    turnaround: float
    request_spacing: float
    connect_delay: float
    timeouts_before_reconnect: int


class Turns(ABC):
    """
    Sends requests as slots become free, in the order of their callers.

    Attributes:
        limit: how many requests may be in flight.
        alarm: when `Conversation.tick` is due; may be too early, never too late.
        broken: why the connection should be closed for a new one, or None.
        is_flooded: whether more came that nobody asked for than can be an accident.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        limit: int,
        pace: Pace,
        statistics: Statistics,
        connection: Reconnecting,
        trace: Trace,
    ) -> None:
        self.limit = limit
        self.alarm: float = math.inf
        self.broken: ModbusConnectionError | None = None
        self.is_flooded: bool = False
        self.connection = connection
        self.statistics = statistics
        self._place = str(endpoint)
        self._scheme = endpoint.scheme
        self._framing: Framing = endpoint.framing
        self._is_socket = endpoint.transport != "serial"
        self._pace = pace
        self._trace = trace
        self._is_traced = False
        self._framer = self._make_framer()
        self._half = (limit + 1) // 2
        self._room = limit
        self._queue: deque[Batch] = deque()
        self._repeats: list[tuple[float, Batch, int]] = []
        self._silent: list[tuple[float, Pending]] = []
        self._found: list[tuple[Pending, Reply]] = []
        self._unanswered = 0
        self._answered_at = 0.0
        self._unasked = 0
        self._next_start = 0.0

    @property
    def is_idle(self) -> bool:
        """Whether nothing is in flight."""
        return self._room == self.limit

    @property
    def is_wanted(self) -> bool:
        """Whether anybody waits for the connection."""
        return bool(self._queue or self._repeats)

    def start(self, now: float) -> list[bytes]:
        """Give what to send now: half of what may be in flight, for the rest may follow answers."""
        if not (self._queue or self._repeats) or self._room <= 0 or self.broken is not None:
            return []
        if not self.connection.is_open or (self._found and self.limit == 1):
            return []  # what came on a line belongs to the request that it answers
        if self._is_spent():
            if self.is_idle:
                self._break("given up for a new connection")
            return []
        if now < self._next_start:
            self._wake(self._next_start)
            return []
        self._is_traced = self._trace.is_on
        adus: list[bytes] = []
        if self._repeats:
            self._start_repeats(adus, now)
        if not (adus and self._pace.request_spacing):
            self._start_queue(adus, now)
        if adus:
            self._note_starts(len(adus), now)
        return adus

    def _is_spent(self) -> bool:
        """Whether no request should go over this connection any more."""
        return self._is_socket and self._unanswered >= self._pace.timeouts_before_reconnect

    def _note_starts(self, count: int, now: float) -> None:
        self.statistics.requests += count
        self._unasked = 0
        self.is_flooded = False
        if self._pace.request_spacing:
            self._next_start = now + self._pace.request_spacing
            self._wake(self._next_start)

    def _start_queue(self, adus: list[bytes], now: float) -> None:
        room = self._window()
        while room > 0 and (batch := self._pick(now)) is not None:
            # The others of the queue have their turn before the next one of this batch.
            most = 1 if self._queue else room
            count = max(0, min(most, batch.limit - batch.in_flight, batch.end - batch.started))
            self._wake(now + batch.timeouts.timeout - batch.used)
            for index in range(batch.started, batch.started + count):
                adus.append(self._start(batch, index, now))
            batch.started += count
            batch.in_flight += count
            room -= count
            self._enqueue(batch)

    def _window(self) -> int:
        """How many may start at once."""
        if self._pace.request_spacing:
            return min(self._room, 1)
        first = self._queue[0].limit if self._queue else 1
        return min(self._room, self._half if first == 1 else (first + 1) // 2)

    def _enqueue(self, batch: Batch) -> None:
        batch.queued = batch.in_flight < batch.limit and batch.started < batch.end
        if batch.queued:
            self._queue.append(batch)

    def _leave_queue(self, batch: Batch) -> None:
        if batch.queued:
            batch.queued = False
            self._queue.remove(batch)

    def _start(self, batch: Batch, index: int, now: float) -> bytes:
        asked = self._begin(batch, index, now)
        batch.used = 0.0
        self._room -= 1
        if batch.silent and batch.silent[index]:
            self._silent.append((now + self._pace.turnaround, asked))
            self._wake(now + self._pace.turnaround)
        if self._is_traced:
            self._trace.tell("sent", asked.adu, batch.unit, batch.pdus[index][0])
        return asked.adu

    def _pick(self, now: float) -> Batch | None:
        """Take a batch with a request that may start out of the queue."""
        while self._queue:
            batch = self._queue.popleft()
            if batch.started < batch.end:
                return batch
            batch.queued = False
        return None

    def _start_repeats(self, adus: list[bytes], now: float) -> None:
        waiting, self._repeats = self._repeats, []
        for repeat in waiting:
            due, batch, index = repeat
            is_full = self._room <= 0 or (adus and self._pace.request_spacing)
            if not batch.matters(index):
                batch.in_flight -= 1
            elif due > now or is_full:
                self._repeats.append(repeat)
                self._wake(due if due > now else self.alarm)
            elif self._may_ask(batch.unit, now):
                self.statistics.retries += 1
                self._wake(now + batch.timeouts.timeout - batch.used)
                adus.append(self._start(batch, index, now))
            elif (error := self._impatience(batch, now)) is not None:
                batch.in_flight -= 1
                self._fail_at(batch, index, error)
                if not batch.queued:
                    self._enqueue(batch)
            else:
                self._repeats.append(repeat)

    def _may_ask(self, unit: int, now: float) -> bool:
        return True

    def _impatience(self, batch: Batch, now: float) -> ModbusError | None:
        """Say that a batch which may not ask yet has waited for too long."""
        return None

    def _wake(self, at: float) -> None:
        if at < self.alarm:
            self.alarm = at

    def _be_still(self) -> None:
        self.alarm = math.inf

    def _note_unasked(self, size: int) -> None:
        self._unasked += size
        self.is_flooded = self._unasked > MAX_UNASKED
        if self.is_flooded and self._is_socket:
            self._break("flooded with what nobody asked for")

    def _break(self, reason: str) -> None:
        """Have the connection closed for a new one."""
        if self.broken is None:
            self.broken = ModbusConnectionError(reason)

    def _begin_anew(self) -> None:
        """On another connection."""
        self.broken = None
        self.is_flooded = False
        self._unanswered = self._unasked = 0

    @abstractmethod
    def _make_framer(self) -> Framer: ...

    @abstractmethod
    def _begin(self, batch: Batch, index: int, now: float) -> Pending:
        """Make the request one that is asked, and its frame."""

    @abstractmethod
    def _fail_at(self, batch: Batch, index: int, error: ModbusError) -> None:
        """Settle a request that was not sent."""
