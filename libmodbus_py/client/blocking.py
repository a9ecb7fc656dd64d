"""
The blocking client: a context for each kind of endpoint.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, Unpack

from ..ports.schemes import DEFAULT_PORT, PARITIES, SECURE_PORT, Scheme, options_of
from ..protocol.mistakes import named_arguments
from .blocking_driver import BlockingDriver
from .call import MAX_IN_FLIGHT
from .values_blocking import BlockingValues

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from ..ports.port import Port
    from ..ports.serial import LineSettings, SerialSettings
    from .connection import Transactions
    from .options import CheckedOptions, ContextOptions

    class RtuOptions(ContextOptions, LineSettings, total=False):
        """The options of contexts on a serial line."""

    class UrlOptions(ContextOptions, SerialSettings, total=False):
        """The options of a context of any kind."""


__all__ = [
    "AsciiContext",
    "Client",
    "Context",
    "RtuContext",
    "TcpContext",
    "TlsContext",
    "UdpContext",
]


class Context(BlockingValues):
    """
    The base of the blocking clients, each of which talks to one unit.

    The subclasses are `TcpContext`, `TlsContext`, `UdpContext`, `RtuContext`, `AsciiContext` and
    `Client`. A context connects when it is entered (``with``) or first used, connects again with
    the next request after the connection was lost or is considered dead, and closes on exit.
    It may be used from any thread: requests are sent one at a time, and the others wait. After a
    fork, the child opens its own connection, and the parent is not affected. Ctrl-C takes effect
    at once.

    Addresses are 0-based, 0..65535; times are in seconds; ``__init__`` lists the options of all
    contexts with their defaults.

    Besides the exceptions that its method names, every request can raise:

    * TypeError, ValueError: an argument is wrong; the message names it and its range, and nothing
      was sent. Constructors raise them, too.
    * ExceptionResponse: the server refused the request; the subclass tells why.
    * ModbusTimeoutError: no complete response arrived within `timeout`.
    * ModbusConnectionError: the connection could not be established or was lost, with errno.
    * FrameError, InvalidResponse: what arrived is not a valid response.
    * RuntimeError: a signal handler or callback has sent a request while this thread was
      waiting for another one.

    If a unit on a serial line has not given a valid response, its next request is not sent before
    the line has been silent for `timeout`, because a late response could be mistaken for the
    response to that request. Requests to other units do not wait.

    Every response is checked in full: transaction id, unit, function, length, byte count and
    echo. With `native`, a request that libmodbus supports is sent, and its response awaited, in
    one call of C without the GIL; on serial lines libmodbus sends it.
    """

    # Scheme -> the class that `from_url` makes.
    _kinds: ClassVar[dict[str, type[Context]]] = {}

    def __init_subclass__(cls, schemes: Iterable[Scheme] = (), **others: Any) -> None:
        super().__init_subclass__(**others)
        Context._kinds.update(dict.fromkeys(schemes, cls))

    def __init__(self, endpoint: Endpoint, options: Mapping[str, Any]) -> None:
        super().__init__(endpoint, options, _make_driver, MAX_IN_FLIGHT, native=True)

    @staticmethod
    def from_url(address: str, **options: Unpack[UrlOptions]) -> Context:
        """
        Return a context for a URL (`libmodbus_py.ports.endpoint`), of the class for its scheme.

        Args:
            address: a URL such as "tcp://192.0.2.10?unit=17" or
                "rtu:///dev/ttyUSB0?baudrate=9600".
            options: the options of that class; they take precedence over those of the URL.

        Raises:
            TypeError, ValueError: the URL or an option is wrong.
        """
        endpoint, others = _parsed(address, options)
        kind = Context._kinds[endpoint.scheme]
        context = kind.__new__(kind)
        Context.__init__(context, endpoint, others)
        return context

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


@named_arguments
class Client(Context):
    """
    A blocking client for any URL; its counterpart for asyncio is `AsyncClient`.

    Args:
        url: such as "tcp://192.0.2.10?unit=17" or "rtu:///dev/ttyUSB0?baudrate=9600"
            (`libmodbus_py.ports.endpoint`).
        options: the options of `TcpContext`, or of `RtuContext` on a serial port; they take
            precedence over those of the URL.

    Raises:
        TypeError, ValueError: the URL or an option is wrong.
    """

    def __init__(self, url: str, **options: Unpack[UrlOptions]) -> None:
        super().__init__(*_parsed(url, options))


class TcpContext(Context, schemes=("tcp", "rtu+tcp", "ascii+tcp", "unix")):
    """
    A client over TCP.

    Args:
        host: a host name, all of whose addresses are tried, or an IPv4 or IPv6 address; it may
            contain the port, as in "192.0.2.1:1502".
        port: 1..65535.
        framing: "tcp" (with the MBAP header); "rtu" or "ascii" for a serial line behind a
            serial device server.
        options: `unit`, `timeout` and others; ``__init__`` lists all with their defaults.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        host: str,
        port: int = DEFAULT_PORT,
        *,
        framing: Literal["tcp", "rtu", "ascii"] = "tcp",
        **options: Unpack[ContextOptions],
    ) -> None:
        if framing not in ("tcp", "rtu", "ascii"):
            raise ValueError(f"framing must be one of tcp, rtu, ascii, not {framing!r}")
        scheme = framing if framing == "tcp" else f"{framing}+tcp"
        super().__init__(_at(scheme, host, port, DEFAULT_PORT), options)


class TlsContext(Context, schemes=("tls",)):
    """
    A client over TLS (Modbus Security). Both sides authenticate each other by certificates.

    A certificate that is refused raises a ModbusConnectionError (errno EKEYREJECTED) whose message
    tells which one, and why. The server's certificate is checked while connecting; with TLS 1.3, a
    server reports that it refuses the client's only when the first request is sent.

    Args:
        host: a host name, all of whose addresses are tried, or an IPv4 or IPv6 address; it may
            contain the port, as in "192.0.2.1:1502".
        port: 1..65535.
        options: `security`, which is required, `unit`, `timeout` and others; ``__init__`` lists
            all with their defaults.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range, or no `security`.
    """

    def __init__(
        self, host: str, port: int = SECURE_PORT, **options: Unpack[ContextOptions]
    ) -> None:
        super().__init__(_at("tls", host, port, SECURE_PORT), options)


class UdpContext(Context, schemes=("udp", "rtu+udp")):
    """
    A client over UDP: each datagram contains one frame of Modbus/TCP.

    The network may lose or duplicate datagrams. A request without a response raises a
    ModbusTimeoutError; with `retries`, requests that may be executed twice are sent again.
    Datagrams from other hosts are ignored, and so are damaged ones; with RTU frames, however, a
    damaged response ends the request, as it does on a serial line.

    Args:
        host: a host name, an IPv4 or an IPv6 address; it may contain the port, as in
            "192.0.2.1:1502".
        port: 1..65535.
        options: `unit`, `timeout` and others; ``__init__`` lists all with their defaults.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self, host: str, port: int = DEFAULT_PORT, **options: Unpack[ContextOptions]
    ) -> None:
        super().__init__(_at("udp", host, port, DEFAULT_PORT), options)


class RtuContext(Context, schemes=("rtu",)):
    """
    A client on a serial line in RTU mode. libmodbus opens and configures the port, and sends.

    Args:
        device: the path of the port, such as "/dev/ttyUSB0"; it is locked while it is open, so
            that no two programs use it at once.
        baudrate: bits per second, 1..4000000.
        options: `unit`, `timeout` and others, which ``__init__`` lists with their defaults; and
            `parity` ("E"), `data_bits` (8), `stop_bits` (1), `rs485`, `rts_delay`, `echo` and
            `silence`, see `ports.serial.SerialPort`. `timeout` should be longer than the slowest
            unit takes, because a late response cannot be told from the next one.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(self, device: str, baudrate: int = 19200, **options: Unpack[RtuOptions]) -> None:
        super().__init__(*_on_line("rtu", device, baudrate, options))


class AsciiContext(Context, schemes=("ascii",)):
    """
    A client on a serial line in ASCII mode, which libmodbus lacks.

    libmodbus opens and configures the port; this package sends and receives. The arguments and
    exceptions are those of `RtuContext`, but the defaults of `data_bits` and `silence` are 7 and
    0, because ASCII frames have start and end characters.
    """

    def __init__(self, device: str, baudrate: int = 19200, **options: Unpack[RtuOptions]) -> None:
        super().__init__(*_on_line("ascii", device, baudrate, options))


def _make_driver(
    endpoint: Endpoint, settings: CheckedOptions, port: Port, connection: Transactions
) -> BlockingDriver:
    # C reads and writes the descriptor itself, and knows no ASCII.
    in_c = endpoint.framing != "ascii" and not endpoint.is_secure
    is_on_libmodbus = endpoint.has_transactions or port.context is not None
    return BlockingDriver(port, connection, native=settings.native and in_c and is_on_libmodbus)


def _parsed(url: str, options: UrlOptions) -> tuple[Endpoint, Mapping[str, Any]]:
    from ..ports.endpoint import parse

    endpoint = parse(url)
    return (endpoint, options) if endpoint.has_transactions else _split(endpoint, options)


def _split(endpoint: Endpoint, options: Mapping[str, Any]) -> tuple[Endpoint, dict[str, Any]]:
    """Return an endpoint with the options that are of its line, and the options of the client."""
    from dataclasses import replace

    settings = dict(endpoint.options)
    others: dict[str, Any] = {}
    of_line = options_of(endpoint.scheme)
    for name, value in options.items():
        (settings if name in of_line else others)[name] = value
    if isinstance(parity := settings.get("parity"), str):
        settings["parity"] = PARITIES.get(parity.lower(), parity)
    return replace(endpoint, options=settings), others


def _at(scheme: Any, host: str, port: int, usual: int) -> Endpoint:
    """
    Return an endpoint of a network; a host such as 192.0.2.1:1502 or [::1]:1502 contains its port.

    Raises:
        ValueError: the host is a URL, or two ports are given.
    """
    from ..ports.endpoint import Endpoint

    if isinstance(host, str) and (":" in host or "/" in host):
        if "/" in host:
            raise ValueError(f"host must be a name or an address, not {host!r}; Client takes URLs")
        from ..ports.hosts import split_host_and_port

        plain, given = split_host_and_port(host)
        if given is not None and port not in (usual, given):
            raise ValueError(f"host {host!r} contains another port than {port}")
        host, port = plain, port if given is None else given
    return Endpoint(scheme, host=host, port=port)


def _on_line(
    scheme: Literal["rtu", "ascii"], device: str, baudrate: int, options: RtuOptions
) -> tuple[Endpoint, Mapping[str, Any]]:
    from ..ports.endpoint import Endpoint

    return _split(Endpoint(scheme, path=device, options={"baudrate": baudrate}), options)
