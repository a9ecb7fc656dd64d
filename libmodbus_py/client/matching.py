"""
Which answer belongs to which request: what the conversation needs to know of a framing.
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

# The most bytes that errors carry; more of the same says no more.
MAX_KEPT = MAX_RECEIVED


class Matching(ABC):
    """
    Matches the bytes of one connection to the requests that were sent over it.

    Args:
        endpoint: of the connection.
        statistics: where late and invalid answers, and timeouts, are counted.
        trace: of the connection.

    Attributes:
        is_clean: True if nothing of earlier requests may still come, where none is in flight now.
        has_ids: True if frames carry transaction ids: then any request may be sent at any time.
        alarm: when `expire` must be called; may be too early, never too late.
        unanswered: requests without an answer since the last answer came.
        answered_at: when the last answer came; 0 where requests take turns.
        unasked: bytes received since the last request was sent, while no answer was pending.
        rest: the beginning of a frame whose end is still to come, where ids are.
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
        Return True unless an answer may be that to an earlier request.

        Args:
            since: when the request was sent.
            now: when the answer came.
        """
        return True

    def ready_at(self, unit: int) -> float:
        """Return when a unit may be asked that owes an answer; 0.0 if it owes none."""
        return 0.0

    def owes(self, pending: Pending) -> bool:
        """Return True if no answer came to a request that was given up, not even a late one."""
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
            batch, index: the request.
            adu: its frame, if it was already sent; None to encode it.
        """

    @abstractmethod
    def take(self, data: bytes, now: float) -> Replies:
        """Return the requests that received bytes answer, with their replies."""

    @abstractmethod
    def expire(self, now: float) -> Replies:
        """Return the requests that silence has answered, and those whose time is over."""

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
        """Note how a request ended. Transaction ids need no conclusions from that; lines do."""

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
    """Return the error for a request that got no answer, with what was received instead."""
    if received:
        return ModbusTimeoutError(
            f"no complete answer within {timeout:g} s, but {in_hex(received)}", received=received
        )
    return ModbusTimeoutError(f"no answer within {timeout:g} s")
