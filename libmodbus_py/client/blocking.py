"""
The blocking client.
"""

from __future__ import annotations

from typing import Self, Unpack

from ..protocol.mistakes import named_arguments
from .blocking_driver import make_driver
from .options import Options, listed_options
from .values_blocking import BlockingValues

__all__ = ["Client"]


@named_arguments
class Client(BlockingValues):
    """
    A blocking client of one unit; its counterpart for asyncio is `AsyncClient`.

    It connects when it is entered (``with``) or first used, connects again with the next request
    after the connection was lost or is considered dead, and closes on exit. It may be used from
    any thread: requests are sent one at a time, and the others wait. After a fork, the child
    opens its own connection, and the parent is not affected. Ctrl-C takes effect at once.

    Addresses are 0-based, 0..65535; times are in seconds.

    Besides the exceptions that its method names, every request can raise:

    * TypeError, ValueError: an argument is wrong; the message names it and its range, and nothing
      was sent.
    * ExceptionResponse: the server refused the request; the subclass tells why.
    * ModbusTimeoutError: no complete response arrived within `timeout`.
    * ModbusConnectionError: the connection could not be established or was lost, with errno.
    * FrameError, InvalidResponse: what arrived is not a valid response.
    * RuntimeError: a signal handler or callback has sent a request while this thread was
      waiting for another one.

    On a serial line ("rtu", "ascii"), libmodbus opens and configures the port, which is locked
    while it is open, so that no two programs use it at once. After a request without a valid
    response, its unit gets none of the same function before it was silent, at most one `timeout`
    later, because a late response could be mistaken for that to the new request; so `timeout`
    should be longer than the slowest unit takes. Requests to other units do not wait.

    Over TLS ("tls"), both sides authenticate each other by certificates. A certificate that is
    refused raises a ModbusConnectionError (errno EKEYREJECTED) whose message tells which one, and
    why. With TLS 1.3, a server reports that it refuses the client's only when the first request
    is sent.

    Over UDP ("udp"), the network may lose or duplicate datagrams. Datagrams from other hosts are
    ignored, and so are damaged ones; with RTU frames ("rtu+udp"), however, a damaged response
    ends the request, as it does on a serial line.

    Every response is checked in full: transaction id, unit, function, length, byte count and
    echo.

    Args:
        url: such as "tcp://192.0.2.10?unit=17" or "rtu:///dev/ttyUSB0?baudrate=9600"
            (`libmodbus_py.ports.endpoint`).
        options: `unit`, `timeout` and others, which take precedence over those of the URL;
            ``__init__`` lists all with their defaults. Those of a serial port, such as
            `baudrate`, are for URLs of serial ports.

    Raises:
        TypeError, ValueError: the URL or an option is wrong.
    """

    def __init__(self, url: str, **options: Unpack[Options]) -> None:
        super().__init__(url, options, Options, make_driver)

    __init__.__doc__ = listed_options(Options)

    def close(self) -> None:
        """
        Close the client for good. May be called repeatedly, from any thread or signal handler.

        Requests that wait for a response or a connection fail at once.
        """
        self._driver.close()

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
