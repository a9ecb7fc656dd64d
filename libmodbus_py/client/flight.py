"""
Requests in flight, and which answer belongs to which. No socket, no event loop.

`Numbered` is for framings with transaction ids: many requests at once, answers in
any order. Its sister `alternating.Alternating` is for those without.

Both take the time as an argument, in seconds of any steady clock.
"""

from __future__ import annotations

import copy
from asyncio import Future
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from ..protocol.errors import FrameError, InvalidResponse, ModbusError, ModbusTimeoutError
from ..protocol.framing import Frame, Framer, UdpFramer
from ..protocol.pdu import Request

__all__ = ["NOT_ASKED", "Answer", "Asked", "Batch", "Flight", "Numbered", "Statistics"]

NOT_ASKED: Final = object()
"""The outcome of a request that has not been settled, or was never sent."""

# So many late answers are waited for; there must be ids left for requests.
MAX_ABANDONED = 0x8000


@dataclass(slots=True)
class Statistics:
    """
    What happened on a connection since the client was made; read only.

    Attributes:
        requests: sent.
        responses: answers that fit, refusals included.
        exceptions: refusals among them.
        timeouts: requests that got no answer in time.
        late_answers: answers to requests that had been given up; dropped.
        invalid: bytes that were no frame, and frames that were no answer.
        connects: connections made.
        failed_connects: attempts that failed.
        lost: connections that ended by themselves, and those given up as dead.
        last_success: when the last answer that fits came (time.monotonic), or None.
    """

    requests: int = 0
    responses: int = 0
    exceptions: int = 0
    timeouts: int = 0
    late_answers: int = 0
    invalid: int = 0
    connects: int = 0
    failed_connects: int = 0
    lost: int = 0
    last_success: float | None = None


class Batch:
    """
    Requests of one caller to one unit, which start in their order; often a single one.

    Attributes:
        silent: which of them nobody answers, by their index.
        limit: how many may be in flight.
        go_on: whether the others are asked after one failed.
        outcomes: the result of each or its exception.
        started: how many were sent.
        in_flight: how many of these are waited for.
        queued: whether it stands in the queue for its next request.
        since: since when it waits for a connection.
        done: set when nothing is left to come.
    """

    # fmt: off
    __slots__ = (
        "_total", "_unsettled", "done", "go_on", "in_flight", "limit", "outcomes", "pdus", "queued",
        "requests", "silent", "since", "started", "unit",
    )
    # fmt: on
    done: Future[None]

    def __init__(
        self,
        unit: int,
        requests: Sequence[Request[Any]],
        pdus: Sequence[bytes],
        silent: frozenset[int] = frozenset(),
        *,
        limit: int = 1,
        go_on: bool = False,
    ) -> None:
        self.unit = unit
        self.requests = requests
        self.pdus = pdus
        self.silent = silent
        self.limit = limit
        self.go_on = go_on
        self.outcomes: list[Any] = [NOT_ASKED] * len(pdus)
        self.started = 0
        self.in_flight = 0
        self.queued = False
        self.since = 0.0
        self._total = self._unsettled = len(pdus)

    @property
    def has_next(self) -> bool:
        return self.started < self._total

    @property
    def is_settled(self) -> bool:
        return not self._unsettled

    def settle(self, index: int, outcome: Any) -> None:
        self.outcomes[index] = outcome
        self._unsettled -= 1
        if isinstance(outcome, Exception) and not (self.go_on and isinstance(outcome, ModbusError)):
            self.stop()
        if not self._unsettled and not self.done.done():
            self.done.set_result(None)

    def stop(self) -> None:
        """Start no more of them."""
        self._unsettled -= self._total - self.started
        self.started = self._total


class Asked:
    """
    One request that was sent.

    Attributes:
        index: of the request in its batch.
        adu: what went out.
        since: when.
    """

    __slots__ = ("adu", "batch", "index", "since")

    def __init__(self, batch: Batch, index: int, adu: bytes, since: float) -> None:
        self.batch = batch
        self.index = index
        self.adu = adu
        self.since = since


# What became of a request: the PDU that answers it, or why there is none. A plain tuple:
# a class of its own would take as long as all else that is done with it.
Answer = tuple[Asked, bytes | ModbusError]


class Flight(Protocol):
    """
    What the two have in common.

    Attributes:
        limit: how many requests may be in flight.
        timeout: seconds to wait for each answer.
        has_broadcast: whether unit 0 addresses every unit.
        ready_at: no request may start before this time.
        quiet: seconds without a byte after which `fall_silent` should be called, or None.
    """

    limit: int
    timeout: float
    has_broadcast: bool
    ready_at: float

    @property
    def quiet(self) -> float | None: ...

    @property
    def room(self) -> int:
        """How many requests may start now."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing is waited for."""

    @property
    def in_step(self) -> bool:
        """False once the stream cannot be understood any more and must be closed."""

    @property
    def is_torn(self) -> bool:
        """Whether the stream stops inside a frame, which an answer would be taken into."""

    def start(self, batch: Batch, now: float) -> Asked:
        """Begin the next request of a batch; the caller sends its `adu`."""

    def take(self, data: bytes, now: float) -> list[Answer]:
        """Take received bytes, give what they settle."""

    def fall_silent(self) -> list[Answer]:
        """The same for silence."""

    def overdue(self, now: float) -> list[Answer]:
        """Give up what has been waited for too long."""

    def next_due(self) -> float | None:
        """When `overdue` will have something to give."""

    def received(self, asked: Asked, pdu: bytes) -> bytes:
        """Give the bytes in which a PDU came."""

    def end_silent(self, asked: Asked) -> bool:
        """Free the slot of a request that nobody answers, if it still has it."""

    def hopeless(self, now: float) -> FrameError | None:
        """Why not to go on waiting for `ready_at`."""

    def doubt(self, now: float) -> None:
        """An answer turned out to be none."""

    def abandon(self, batch: Batch, now: float) -> None:
        """Nobody wants the answers of a batch any more."""

    def restart(self, now: float) -> list[Asked]:
        """Give what was in flight, and begin anew on another connection."""


def no_answer(timeout: float, received: bytes) -> ModbusTimeoutError:
    if received:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {received.hex(' ')}", received=received
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")


class Numbered:
    """
    Many requests at once, told apart by their transaction ids.

    An id is used again after all others were, and not while its late answer may come.

    Args:
        make_framer: makes the framer of a new connection.
    """

    has_broadcast = False
    quiet: float | None = None
    ready_at = 0.0

    def __init__(
        self,
        make_framer: Callable[[], Framer],
        limit: int,
        timeout: float,
        statistics: Statistics,
    ) -> None:
        self.limit = limit
        self.timeout = timeout
        self._make_framer = make_framer
        self._statistics = statistics
        self._last = 0
        self._asked: dict[int, Asked] = {}
        self._silent: set[Asked] = set()
        self._rest = b""
        self.restart(0.0)

    @property
    def room(self) -> int:
        return self.limit - len(self._asked) - len(self._silent)

    @property
    def is_empty(self) -> bool:
        return not self._asked

    @property
    def in_step(self) -> bool:
        return self._framer.in_step

    @property
    def is_torn(self) -> bool:
        return self._framer.pending > 0

    def start(self, batch: Batch, now: float) -> Asked:
        number = self._last + 1 & 0xFFFF
        while number in self._asked or number in self._abandoned:
            number = number + 1 & 0xFFFF
        self._last = number
        index = batch.started
        adu = self._framer.encode(Frame(batch.unit, batch.pdus[index], number))
        asked = Asked(batch, index, adu, now)
        if index in batch.silent:
            self._silent.add(asked)
        else:
            self._asked[number] = asked
        return asked

    def take(self, data: bytes, now: float) -> list[Answer]:
        answers: list[Answer] = []
        for each in self._framer.scan(data):
            if isinstance(each, FrameError):
                answers += self._blame(each)
                continue
            unit, pdu, number = each
            asked = self._asked.pop(number, None)
            if asked is None:
                self._abandoned.pop(number, None)
                self._statistics.late_answers += 1
            elif asked.batch.unit == unit:
                answers.append((asked, pdu))
            else:
                received = self._framer.encode(each)
                answers.append(self._invalid(asked, f"unit {unit} answered", received))
        pending = self._framer.pending
        self._rest = (self._rest + data)[-pending:] if pending else b""
        return answers

    def _invalid(self, asked: Asked, reason: str, received: bytes) -> Answer:
        self._statistics.invalid += 1
        return asked, InvalidResponse(reason, received=received)

    def _blame(self, error: FrameError) -> list[Answer]:
        """Find whose answer it should have been: all, when nothing can be understood any more."""
        self._statistics.invalid += 1
        if not self._framer.in_step:
            asked, self._asked = list(self._asked.values()), {}
            return [(each, copy.copy(error)) for each in asked]
        if isinstance(self._framer, UdpFramer):
            return []  # the next datagram may be the right one
        one = self._asked.pop(int.from_bytes(error.received[:2], "big"), None)
        return [(one, error)] if one else []

    def fall_silent(self) -> list[Answer]:
        return []

    def overdue(self, now: float) -> list[Answer]:
        late = [
            (number, asked)
            for number, asked in self._asked.items()
            if asked.since + self.timeout <= now
        ]
        answers: list[Answer] = []
        for number, asked in late:
            self._give_up(number)
            begun = self._rest.startswith(asked.adu[:2])
            answers.append((asked, no_answer(self.timeout, self._rest if begun else b"")))
        return answers

    def _give_up(self, number: int) -> None:
        del self._asked[number]
        self._abandoned[number] = None
        if len(self._abandoned) > MAX_ABANDONED:
            del self._abandoned[next(iter(self._abandoned))]

    def next_due(self) -> float | None:
        first = min((asked.since for asked in self._asked.values()), default=None)
        return None if first is None else first + self.timeout

    def received(self, asked: Asked, pdu: bytes) -> bytes:
        number = int.from_bytes(asked.adu[:2], "big")
        return self._framer.encode(Frame(asked.batch.unit, pdu, number))

    def end_silent(self, asked: Asked) -> bool:
        had_it = asked in self._silent
        self._silent.discard(asked)
        return had_it

    def hopeless(self, now: float) -> FrameError | None:
        return None

    def doubt(self, now: float) -> None:
        """The next answer is told by its id."""

    def abandon(self, batch: Batch, now: float) -> None:
        for number in [n for n, asked in self._asked.items() if asked.batch is batch]:
            self._give_up(number)

    def restart(self, now: float) -> list[Asked]:
        asked = [*self._asked.values(), *self._silent]
        self._framer = self._make_framer()
        self._asked = {}
        self._silent.clear()
        self._abandoned: dict[int, None] = {}
        self._rest = b""
        return asked
