"""
The asyncio client.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self, Unpack

from ..protocol.checks import integer
from ..protocol.mistakes import named_arguments
from .asyncio_driver import AsyncioDriver
from .call import Call, Phase
from .options import AsyncOptions, listed_options
from .values_async import AsyncValues

if TYPE_CHECKING:
    from ..protocol import pdu

__all__ = ["MAX_PAUSE", "AsyncClient", "Sender", "Submitted"]

# Seconds: a device that was switched on again is back after half a minute at most.
MAX_PAUSE = 30.0


@named_arguments
class AsyncClient(AsyncValues):
    """
    A client of one unit for asyncio, whose methods are coroutines.

    It connects when it is entered (``async with``) or first used, connects again with the next
    request after the connection was lost or is considered dead, and closes on exit. All requests
    that wait for a connection share one attempt to connect, and fail together if it fails. The
    pause before the next attempt is 0.1 s, then 0.2 s, and so on up to `max_pause`, each
    shortened by a random amount; pauses begin at 0.1 s again after a response. A request that
    cannot wait that long fails at once.

    With the framings "tcp" and "udp", up to `max_in_flight` reads are pending at the same time,
    and may be answered in any order; a write is alone. On serial lines, and on serial lines behind
    TCP or UDP, requests are sent one at a time. After a failure there, the line must be silent for
    `timeout` before the same unit gets another request, because a late response could be mistaken
    for the response to that request. Requests are sent in the order in which they were made.

    A request may be cancelled at any time, for example by ``asyncio.timeout``. Its response is
    dropped when it arrives, and other requests are not affected.

    A client belongs to the event loop that first uses it, and to one thread. A client that was
    not closed issues a ResourceWarning and closes when it is garbage collected.

    Besides the exceptions that its method names, every request can raise:

    * TypeError, ValueError: an argument is wrong; the message names it and its range, and nothing
      was sent.
    * ExceptionResponse: the server refused the request; the subclass tells why.
    * ModbusTimeoutError: no complete response arrived within `timeout`.
    * ModbusConnectionError: the connection could not be established or was lost, with errno.
    * FrameError, InvalidResponse: what arrived is not a valid response.
    * RuntimeError: the client belongs to another event loop.

    Args:
        url: a URL such as "tcp://192.0.2.10?unit=17" or "rtu:///dev/ttyUSB0?baudrate=9600"
            (`libmodbus_py.ports.endpoint`).
        options: `unit`, `timeout` and others, which take precedence over those of the URL;
            ``__init__`` lists all with their defaults.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(self, url: str, **options: Unpack[AsyncOptions]) -> None:
        super().__init__(url, options, AsyncOptions, AsyncioDriver, max_pause=MAX_PAUSE)
        self._last = _Last(self._driver)

    __init__.__doc__ = listed_options(AsyncOptions, max_pause=MAX_PAUSE)

    async def close(self) -> None:
        """
        Close the client for good; pending requests fail at once. May be called repeatedly.

        Raises:
            RuntimeError: the client belongs to another event loop.
        """
        await self._driver.close()

    async def __aenter__(self) -> Self:
        try:
            await self.connect()
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


class Sender:
    """
    Sends requests to any unit over the connection of a client, with the client's timeouts.

    It needs no task for each request: gateways and fleets forward thousands.
    """

    def __init__(self, client: AsyncClient) -> None:
        self.client: AsyncClient = client
        self._connection = client._connection
        self._driver = client._driver
        self._has_broadcast = client._has_broadcast

    def submit(
        self, unit: int, request: pdu.Request[Any], on_done: Callable[[], object]
    ) -> Submitted:
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
        call = Call(unit, request, self.client._timeouts, unit == 0 and self._has_broadcast)
        self._driver.ask(call, on_done)
        return Submitted(call, self._driver)

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

        On a serial line, a unit gets no request of the same function for one `timeout` after a
        failure, because its late response could not be told from the next one. A request that is
        submitted earlier waits for that time, and so do those to the same unit behind it.

        Args:
            unit: the unit, 0..255.
            function: the function code, 1..127; None for all functions of the unit.
        """
        return self._connection.matching.ready_at(unit, function)


class Submitted:
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
        """True if a response was received, even if it may still turn out to be another one's."""
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


class _Last:
    """Exists as long as any handle; warns about a connection left open, and closes it."""

    def __init__(self, driver: AsyncioDriver) -> None:
        self._driver = driver

    def __del__(self) -> None:
        self._driver.forget()
