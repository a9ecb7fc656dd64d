"""
The asyncio client.
"""

from __future__ import annotations

from typing import Self, Unpack

from ..protocol.mistakes import named_arguments
from .asyncio_driver import AsyncioDriver
from .options import AsyncOptions, listed_options
from .values_async import AsyncValues

__all__ = ["MAX_PAUSE", "AsyncClient"]

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
    TCP or UDP, requests are sent one at a time. After a failure there, a unit gets none of the same
    function before it was silent, at most one `timeout` later, because a late response could be
    mistaken for that to the new request. Requests are sent in the order in which they were made.

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


class _Last:
    """Exists as long as any handle; warns about a connection left open, and closes it."""

    def __init__(self, driver: AsyncioDriver) -> None:
        self._driver = driver

    def __del__(self) -> None:
        self._driver.forget()
