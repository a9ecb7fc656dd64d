"""
Decides which answer belongs to which request; each kind of framing has a subclass.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from ..ports.endpoint import Endpoint
from ..ports.trace import Trace
from ..protocol.errors import MAX_RECEIVED, ModbusError, ModbusTimeoutError, in_hex
from ..protocol.framing import Framer, Framing
from .batch import Batch, Pending, Reply
from .statistics import Statistics

__all__ = ["Matching", "Replies", "no_answer"]

Replies = list[tuple[Pending, Reply]]

# The most received bytes that errors contain; more bytes would not help.
MAX_KEPT = MAX_RECEIVED


class Matching(ABC):
    """
    Matches the bytes of one connection to the requests that were sent over it.

    Args:
        endpoint: the endpoint of the connection.
        statistics: counts late and invalid answers, and timeouts.
        trace: the trace of the connection.

    Attributes:
        is_clean: True if no request is in flight, and no late answer may still arrive.
        has_ids: True if frames carry transaction ids: then any request may be sent at any time.
        alarm: the time at which `expire` must be called; may be too early, but never too late.
        unanswered: the number of requests without an answer since the last answer arrived.
        answered_at: the time at which the last answer arrived; 0 where frames have no ids.
        unasked: the number of bytes received since the last request was sent, while no answer was
            pending.
        rest: the beginning of a frame whose end was not received yet, where frames have ids.
        is_in_step: False once the stream of bytes cannot be understood any more.
    """

    has_ids: ClassVar[bool]

    def __init__(self, endpoint: Endpoint, statistics: Statistics, trace: Trace) -> None:
        self.is_clean: bool = self.has_ids
        self.alarm: float = math.inf
        self.unanswered: int = 0
        self.answered_at: float = 0.0
        self.unasked: int = 0
        self.rest: bytes = b""
        self.is_in_step: bool = True
        self._framing: Framing = endpoint.framing
        self._statistics = statistics
        self._trace = trace
        self._framer = self._make_framer()

    def next_number(self) -> int:
        """Return the transaction id of the next request; 0 on lines, which have none."""
        return 0

    def accepts(self, unit: int, request: bytes, pdu: bytes, since: float, now: float) -> bool:
        """
        Return True unless an answer may belong to an earlier request.

        Args:
            since: the time at which the request was sent.
            now: the time at which the answer was received.
        """
        return True

    def ready_at(self, unit: int) -> float:
        """Return when a unit that owes an answer may get a request; 0.0 if it owes none."""
        return 0.0

    def owes(self, pending: Pending) -> bool:
        """Return True if a request that was given up has got no answer, not even a late one."""
        return True

    def may_start(self, batch: Batch, now: float) -> bool:
        """
        Return True if a request of this batch may be sent now; else set `alarm`.

        Raises:
            FrameError: the line has not fallen silent in time.
        """
        return True

    @abstractmethod
    def start(self, batch: Batch, index: int, now: float, adu: bytes | None = None) -> Pending:
        """
        Expect the answer to a request from now on.

        Args:
            batch, index: the batch of the request, and the index of the request in it.
            adu: the frame of the request, if it was already sent; None to encode it.
        """

    @abstractmethod
    def take(self, data: bytes, now: float) -> Replies:
        """Return the requests that received bytes answer, with their replies."""

    @abstractmethod
    def expire(self, now: float) -> Replies:
        """Return the requests that are complete because of a silence, and those timed out."""

    @abstractmethod
    def withdraw(self, batch: Batch, now: float) -> list[Pending]:
        """Return the pending requests of a batch; their answers will be dropped."""

    @abstractmethod
    def received_with(self, pending: Pending, pdu: bytes) -> bytes:
        """Return the received bytes that contained the PDU of an answer."""

    def reset(self, now: float) -> list[Pending]:
        """Return all pending requests, and begin with an empty state on the next connection."""
        self.unanswered = self.unasked = 0
        self.is_in_step = True
        self.is_clean = self.has_ids
        self._framer = self._make_framer()
        return []

    def conclude(  # noqa: B027
        self, pending: Pending, error: ModbusError | None, now: float
    ) -> None:
        """Note how a request ended. Only lines without transaction ids draw conclusions."""

    @abstractmethod
    def _make_framer(self) -> Framer: ...

    def _wake(self, at: float) -> None:
        if at < self.alarm:
            self.alarm = at

    def _time_out(self, pending: Pending, error: ModbusError) -> tuple[Pending, Reply]:
        self._statistics.timeouts += 1
        self.unanswered += pending.since >= self.answered_at
        return pending, error


def no_answer(timeout: float, received: bytes) -> ModbusTimeoutError:
    """Return the error for a request that got no answer, with the bytes received instead."""
    if received:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {in_hex(received)}", received=received
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")
