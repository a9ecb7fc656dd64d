"""
A handle to one unit on a connection, blocking or not.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Generic, Protocol, Self, TypeVar

from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import InvalidResponse, ModbusError
from .batch import MAX_IN_FLIGHT, Batch, Patience, Statistics
from .options import Parts, Settings
from .reconnecting import State

__all__ = ["Handle"]


class Driver(Protocol):
    """What handles need of theirs."""

    def change_timeout(self) -> None: ...


Driving = TypeVar("Driving", bound=Driver)


class Handle(Generic[Driving]):
    """
    What both clients are: a unit, its patience, and the connection that it shares.

    Attributes:
        unit: who is asked.
    """

    unit: int

    def __init__(
        self, parts: Parts, settings: Settings, driver: Driving, patience: Patience | None = None
    ) -> None:
        self.unit = settings.unit
        self._patience = patience or settings.patience
        self._endpoint = parts.endpoint
        self._connection = parts.connection
        self._statistics = parts.statistics
        self._has_broadcast = parts.endpoint.framing in ("rtu", "ascii")
        self._driver = driver

    def for_unit(
        self, unit: int, *, timeout: float | None = None, retries: int | None = None
    ) -> Self:
        """
        Give a handle to another unit, 0..255, on the same connection.

        Unit 0 is a broadcast on serial lines: writes only, which return after
        the turnaround. Closing either handle closes the connection of both.

        Args:
            timeout: seconds, 0.001..86400; None to share this handle's.
            retries: 0..100; None to share this handle's.
        """
        handle = copy.copy(self)
        handle.unit = integer("unit", unit, 0, 255)
        handle._patience = self._patience_for(timeout, retries)
        return handle

    @property
    def url(self) -> str:
        """Where it leads."""
        return str(self._endpoint)

    @property
    def timeout(self) -> float:
        """Seconds that one request may take, connecting included; settable."""
        return self._patience.timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._patience.timeout = seconds("timeout", value)
        self._driver.change_timeout()

    @property
    def state(self) -> State:
        """Where the connection stands."""
        return self._connection.state

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self.state is State.CLOSED

    @property
    def statistics(self) -> Statistics:
        """What happened on the connection; live."""
        return self._statistics

    @property
    def late_answers(self) -> int:
        """How many answers came after their request had been given up, and were dropped."""
        return self._statistics.late_answers

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {self._endpoint}, unit {self.unit}, {self.state.value}>"

    # --- for the clients ----------------------------------------------------------------

    @property
    def _is_broadcast(self) -> bool:
        return self.unit == 0 and self._has_broadcast

    def _patience_for(self, timeout: float | None, retries: int | None) -> Patience:
        patience = self._patience
        if timeout is not None:
            patience = replace(patience, timeout=seconds("timeout", timeout))
        if retries is not None:
            patience = replace(patience, retries=integer("retries", retries, 0, 100))
        return patience

    def _batch(
        self, requests: Iterable[pdu.Request[Any]], max_in_flight: int, go_on: bool
    ) -> Batch:
        """Check and encode all before the first is sent."""
        limit = integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        if not isinstance(requests, Iterable):
            raise TypeError(f"requests must be a list, not {type(requests).__name__}")
        return Batch(
            self.unit,
            list(requests),
            self._patience,
            name="requests[{}]",
            is_broadcast=self._is_broadcast,
            limit=limit,
            go_on=bool(go_on),
        )

    def _tolerated(self, return_exceptions: bool) -> tuple[type[ModbusError], ...]:
        return (ModbusError,) if return_exceptions else ()

    def _named(self, error: InvalidResponse) -> InvalidResponse:
        """Tell an error of a procedure who was asked."""
        error.unit, error.endpoint = self.unit, self.url
        return error
