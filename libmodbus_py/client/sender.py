"""
Sending without a task for each request, for gateways and fleets, which forward thousands.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..protocol.checks import integer
from .call import Call, Phase

if TYPE_CHECKING:
    from ..protocol import pdu
    from .asynchronous import AsyncClient
    from .asyncio_driver import AsyncioDriver

__all__ = ["Sender", "SubmittedRequest"]


class Sender:
    """
    Sends requests to any unit over the connection of a client, with the client's timeouts.

    `has_broadcast` is True if unit 0 stands for all units.
    """

    def __init__(self, client: AsyncClient) -> None:
        self.client: AsyncClient = client
        self._connection = client._connection
        self._driver = client._driver
        self.has_broadcast: bool = client._has_broadcast

    def submit(
        self, unit: int, request: pdu.Request[Any], on_done: Callable[[], object]
    ) -> SubmittedRequest:
        """
        Send a request without waiting for its response.

        Args:
            unit: the unit of the request, 0..255.
            request: any request object of `libmodbus_py.pdu`.
            on_done: called once when the outcome is known, possibly before this method returns.
                It must not block. Exceptions that it raises are logged.

        Returns:
            The submitted request; its `outcome` is set before `on_done` is called.

        Raises:
            TypeError, ValueError: the request cannot be sent.
            RuntimeError: the client belongs to another event loop.
        """
        if type(unit) is not int or not 0 <= unit <= 255:
            unit = integer("unit", unit, 0, 255)
        call = Call(unit, request, self.client._timeouts, unit == 0 and self.has_broadcast)
        self._driver.ask(call, on_done)
        return SubmittedRequest(call, self._driver)

    @property
    def has_ids(self) -> bool:
        """True if frames carry transaction ids, so that any unit may be asked at any time."""
        return self._connection.matching.has_ids

    @property
    def room(self) -> int:
        """
        The most requests that should be pending now: `max_in_flight`, or 0 while a write has no
        outcome yet. Requests that are submitted meanwhile are sent after it, even if its outcome
        shows that their unit does not answer.
        """
        return self._connection.room

    def ready_at(self, unit: int, function: int | None = None) -> float:
        """
        Return when a unit may get a request, in the time of the event loop; 0.0 if at once.

        On a serial line, a unit gets no request of the same function for twice its slowest
        response after a failure, or for one `timeout` if it has never responded, because its late
        response could not be told from the next one. A request that is submitted earlier waits for
        that time, one `timeout` at the most, and so do those to the same unit behind it.

        Args:
            unit: the unit, 0..255.
            function: the function code, 1..127; None for all functions of the unit.
        """
        return self._connection.matching.ready_at(unit, function)


class SubmittedRequest:
    """A request that was submitted."""

    __slots__ = ("_call", "_driver")

    def __init__(self, call: Call, driver: AsyncioDriver) -> None:
        self._call = call
        self._driver = driver

    @property
    def outcome(self) -> Any:
        """Return the result, or the exception that `AsyncClient.execute` would raise."""
        return self._call.outcome

    def withdraw(self) -> None:
        """Drop the request: `on_done` is not called, and a late response is ignored."""
        self._driver.withdraw(self._call)

    @property
    def is_sent(self) -> bool:
        """False while the request waits to be sent, for the first time or again."""
        return self._call.state is not Phase.WAITING

    @property
    def is_answered(self) -> bool:
        """True if a response was received, even if it may belong to another request."""
        return self._call.state is Phase.ANSWERED

    def send_no_more(self) -> bool:
        """
        Withdraw the request if it waits to be sent; else do not send it again.

        Returns:
            True if it was withdrawn.
        """
        self._call.send_no_more()
        if self.is_sent:
            return False
        self.withdraw()
        return True
