"""
A backend of Home Assistant's modbus-connection: connections and units built on `AsyncClient`.

::

    from modbus_connection import ModbusTcpParams
    from libmodbus_py.modbus_connection import ModbusConnection

    connection = ModbusConnection(ModbusTcpParams(host="192.0.2.10"), timeout=3)
    await connection.for_unit(1).read_holding_registers(100, 3)
    connection.statistics                # counters, which continue after a reconnection

It needs Python 3.12 or newer, and modbus-connection, which libmodbus-py[homeassistant] installs.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ssl
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Literal, TypeAlias, TypedDict, TypeVar, Unpack
from urllib.parse import urlsplit

from ....version import how_to_add

try:
    import modbus_connection as theirs
except ImportError as error:
    raise ImportError(
        "the backend of modbus-connection needs modbus-connection and Python 3.12 or newer: "
        + how_to_add("homeassistant")
    ) from error

from ....client.asynchronous import AsyncClient
from ....client.reconnecting import State
from ....client.sender import Sender
from ....client.statistics import Statistics
from ....ports.endpoint import Endpoint, parse
from ....ports.hosts import split_host_and_port
from ....ports.schemes import Scheme
from ....protocol.checks import integer, seconds
from ....protocol.errors import (
    ExceptionResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)
from ....security.security import GivenContext
from ...tasks import KeptTasks
from .units import ConnectionUnit

# fmt: off
__all__ = [
    "SUPPORTED_FRAMINGS", "ModbusConnection", "connect_serial", "connect_tcp", "connect_tls",
    "connect_udp",
]
# fmt: on

Result = TypeVar("Result")

Params: TypeAlias = (
    theirs.ModbusTcpParams
    | theirs.ModbusUdpParams
    | theirs.ModbusTlsParams
    | theirs.ModbusSerialParams
)

# asyncio and clients raise RuntimeError if another event loop uses them.
Cause: TypeAlias = ModbusError | theirs.ModbusError | RuntimeError

SCHEMES: dict[type, tuple[str, dict[str, Scheme]]] = {
    theirs.ModbusTcpParams: ("tcp", {"socket": "tcp", "rtu": "rtu+tcp", "ascii": "ascii+tcp"}),
    theirs.ModbusUdpParams: ("udp", {"socket": "udp", "rtu": "rtu+udp"}),
    theirs.ModbusTlsParams: ("tls", {"socket": "tls"}),
    theirs.ModbusSerialParams: ("serial", {"rtu": "rtu", "ascii": "ascii"}),
}
"""Class of parameters -> the transport, and framing -> scheme."""

SUPPORTED_FRAMINGS: Mapping[str, tuple[str, ...]] = {
    transport: tuple(schemes) for transport, schemes in SCHEMES.values()
}
"""Transport ("tcp", "udp", "tls", "serial") -> the framings that this backend supports on it."""

# The times of `AsyncClient`; units may require any, even 0.
SHORTEST_S, LONGEST_S = 0.001, 86_400.0

# The number of consecutive timeouts that closes the connection: more than ever occur.
NEVER = 1_000_000

FILES = ("verify", "client_cert", "client_key")


class ModbusConnection(theirs.ModbusConnection):
    """
    A connection to a Modbus network, as defined by ``modbus_connection.ModbusConnection``.

    The first request connects, and so does the first request after the connection was lost.
    Requests are sent one at a time, and none is sent twice: neither after a lost connection, nor
    after a timeout, nor when the device is busy. After a timeout the connection is kept, and a
    late response is dropped. A response to another request closes the connection
    and raises ModbusDesyncError.

    A connection belongs to the event loop that uses it first.

    Args:
        params: ``ModbusTcpParams``, ``ModbusUdpParams``, ``ModbusTlsParams`` or
            ``ModbusSerialParams``, whose `device` may be ``socket://HOST:PORT``.
        timeout: seconds for one request, and for connecting; 10 unless this argument or a unit
            (``require_timeout``) sets another timeout.
        message_spacing: seconds from the end of a request to the start of the next one.
        connect_delay: seconds between connecting and the first request.

    Attributes:
        url: the URL of the connection, as for `AsyncClient`.
        statistics: a `Statistics` with the counters of the connection, which continue after a
            reconnection; ``integrations.prometheus.collect`` accepts the connection.
        last_error: the message of the last error; empty if there was none.

    Raises:
        TypeError, ValueError: parameters that are not supported, such as ASCII over UDP, or an
            invalid time.
    """

    _client: AsyncClient | None

    def __init__(
        self,
        params: Params,
        *,
        timeout: float | None = None,
        message_spacing: float | None = None,
        connect_delay: float | None = None,
    ) -> None:
        self.url: str = url_of(params)
        self.statistics: Statistics = Statistics()
        self.last_error: str = ""
        times = {
            "timeout": timeout,
            "message_spacing": message_spacing,
            "connect_delay": connect_delay,
        }
        for name, value in times.items():
            if value is not None:
                seconds(name, value, low=0)
        super().__init__(params, **times)
        self._later = KeptTasks()

    def for_unit(self, unit_id: int) -> ConnectionUnit:
        """
        Return a handle for a unit, 0..255. On serial lines unit 0 is a broadcast: writes only.

        Raises:
            TypeError, ValueError: `unit_id` has the wrong type, or is out of range.
        """
        return ConnectionUnit(self, integer("unit_id", unit_id, 0, 255))

    async def carry_out(
        self, unit: int, operation: str, ask: Callable[[], Awaitable[Result]]
    ) -> Result:
        """Connect, wait until no other request is under way, and send a request."""
        try:
            await self.connect()
            await self._fall_silent(unit)
            async with self._pacer.paced(unit):
                await self.connect()  # again, if the connection was lost meanwhile
                try:
                    return await ask()
                except ModbusError as error:
                    if error.answers_another and self._client is not None:
                        # Before another request is sent over this connection.
                        client, self._client = self._client, None
                        with contextlib.suppress(theirs.ModbusConnectionError):
                            await self._close_client(client)
                    raise
        except (ModbusError, theirs.ModbusError, RuntimeError) as error:
            converted_error = converted(error, operation)
            self.last_error = str(converted_error)
            raise converted_error from error

    async def _fall_silent(self, unit: int) -> None:
        """Wait while late answers of a unit may come, one timeout at the most; others may ask."""
        loop = asyncio.get_running_loop()
        until = loop.time() + self._timeout
        while self._client is not None and loop.time() < until:
            ready_at = Sender(self._client).ready_at(unit)
            if ready_at <= loop.time():
                break
            await asyncio.sleep(min(ready_at, until) - loop.time())

    def handle(self, unit: int) -> AsyncClient:
        """Return a handle of the current client for a unit, or raise ModbusConnectionError."""
        if self._client is None:
            raise theirs.ModbusConnectionError("the connection was lost before the request")
        return self._client.for_unit(unit)

    # --- methods for the base class, which decides when to connect, to wait and to close ------

    async def _connect_client(self) -> AsyncClient:
        client = AsyncClient(
            self.url,
            timeout=min(max(self._timeout, SHORTEST_S), LONGEST_S),
            timeouts_before_reconnect=NEVER,
            security=await self._security(),
            statistics=self.statistics,
            on_state=self._note_state,
        )
        try:
            return await client.__aenter__()  # closes the client if connecting fails
        except (ModbusConnectionError, RuntimeError) as error:
            failure = not_connected(error)
            self.last_error = str(failure)
            raise failure from error

    async def _close_client(self, client: AsyncClient) -> None:
        try:
            await client.close()
        except RuntimeError as error:
            raise theirs.ModbusConnectionError(f"closing: {error}") from error

    async def _security(self) -> GivenContext | None:
        params = self._params
        if not isinstance(params, theirs.ModbusTlsParams):
            return None
        try:
            return GivenContext(await params.create_ssl_context())
        except OSError as error:  # SSLError is an OSError
            text = ", ".join(f"{name}={getattr(params, name)!r}" for name in FILES)
            raise ValueError(f"cannot use {text} for TLS: {error.strerror or error}") from None

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        # States of earlier clients, and of a client that is still connecting, are ignored.
        client = self._client
        if state is State.DISCONNECTED and client is not None and client.state is state:
            self._on_connection_lost(error)

    # The tests of modbus-connection call it, too.
    def _on_connection_lost(self, error: Exception | None) -> None:
        if self._closed or self._client is None:
            return
        client, self._client = self._client, None
        self.last_error = f"connection lost: {error}"
        # The client is closed because it would connect again for requests that wait.
        self._later.begin(client.close())
        # Called by the event loop, so that it handles the exceptions of callbacks.
        asyncio.get_running_loop().call_soon(self._lost_callbacks.fire)


# --- parameters to URLs, errors to those of modbus-connection -------------------------------------


def url_of(params: Params) -> str:
    """Return the URL that parameters describe; refuse a host or device that it would not name."""
    scheme = next((SCHEMES[kind] for kind in SCHEMES if isinstance(params, kind)), None)
    if scheme is None:
        names = ", ".join(kind.__name__ for kind in SCHEMES)
        raise TypeError(f"params must be one of {names}, not {type(params).__name__}")
    transport, schemes = scheme
    framer = getattr(params, "framer", "socket")
    if framer not in schemes:
        raise ValueError(
            f"framer must be one of {', '.join(schemes)} over {transport.upper()}, not {framer!r}; "
            "modbus_connection.pymodbus.ModbusConnection may support it"
        )
    if isinstance(params, theirs.ModbusSerialParams):
        name, value, endpoint = "device", params.device, _of_serial(params)
    else:
        endpoint = Endpoint(schemes[framer], host=params.host, port=params.port)
        name, value = "host", params.host
    with contextlib.suppress(ValueError):
        parts = parse(endpoint.url)
        # URLs contain hosts in lower case, but for the interface of an address.
        same = replace(endpoint, host=parts.host)
        if parts == same and parts.host.lower() == endpoint.host.lower():
            return parts.url
    raise ValueError(
        f"{name} {value!r} is invalid: in a URL, {endpoint.url!r}, it would name another endpoint"
    )


def _of_serial(params: theirs.ModbusSerialParams) -> Endpoint:
    device, framer = params.device, params.framer
    if device.startswith("/"):
        options = {
            "baudrate": params.baudrate,
            "data_bits": params.bytesize,
            "parity": params.parity,
            "stop_bits": params.stopbits,
        }
        return Endpoint(framer, path=device, options=options)
    host, port = "", None
    if device.startswith("socket://"):
        with contextlib.suppress(ValueError):
            host, port = split_host_and_port(urlsplit(device).netloc)
    if not port:
        raise ValueError(f"device must be a path or socket://HOST:PORT, not {device!r}")
    return Endpoint("rtu+tcp" if framer == "rtu" else "ascii+tcp", host=host, port=port)


KINDS: tuple[tuple[type[BaseException], type[theirs.ModbusError]], ...] = (
    (ModbusTimeoutError, theirs.ModbusTimeoutError),
    (ModbusConnectionError, theirs.ModbusConnectionError),
    (ModbusError, theirs.ModbusProtocolError),
    (RuntimeError, theirs.ModbusConnectionError),
)


def converted(error: Cause, operation: str) -> theirs.ModbusError:
    """Return the error of modbus-connection for an operation; the message names the operation."""
    text = f"{operation}: {_reason(error)}"
    if isinstance(error, theirs.ModbusError):  # perhaps one that several operations waited for
        return type(error)(text)
    if isinstance(error, ExceptionResponse):
        return theirs.ModbusExceptionError.from_code(error.code, text)
    if getattr(error, "answers_another", False):
        return theirs.ModbusDesyncError(text)
    return next(kind for ours, kind in KINDS if isinstance(error, ours))(text)


def not_connected(error: ModbusConnectionError | RuntimeError) -> theirs.ModbusError:
    """Return the error of modbus-connection for a connection that could not be established."""
    is_late = getattr(error, "errno", None) == errno.ETIMEDOUT
    kind = theirs.ModbusTimeoutError if is_late else theirs.ModbusConnectionError
    return kind(_reason(error))


def _reason(error: Cause) -> str:
    """Return the message of an error without its request, because the operation names that."""
    if isinstance(error, ModbusError):
        place = "" if error.unit is None or not error.asked else f"unit {error.unit}: "
        return f"{place}{error.args[0]}"
    return str(error)


# --- functions that connect -----------------------------------------------------------------------


class Timings(TypedDict, total=False):
    """Times in seconds, as for `ModbusConnection`."""

    timeout: float | None
    message_spacing: float | None
    connect_delay: float | None


async def connect_tcp(
    host: str,
    *,
    port: int = 502,
    framer: Literal["socket", "rtu", "ascii"] | None = None,
    **times: Unpack[Timings],
) -> ModbusConnection:
    """
    Connect over TCP.

    Args:
        host, port, framer: as for ``ModbusTcpParams``.
        times: `timeout`, `message_spacing` and `connect_delay` of `ModbusConnection`.

    Raises:
        TypeError, ValueError: as for `ModbusConnection`.
        modbus_connection.ModbusConnectionError: the connection could not be established.
        modbus_connection.ModbusTimeoutError: it was not established in time.
    """
    return await _connected(theirs.ModbusTcpParams(host=host, port=port, framer=framer), times)


async def connect_udp(
    host: str,
    *,
    port: int = 502,
    framer: Literal["socket", "rtu", "ascii"] = "socket",
    **times: Unpack[Timings],
) -> ModbusConnection:
    """Connect over UDP, like `connect_tcp`; `framer` must not be "ascii"."""
    return await _connected(theirs.ModbusUdpParams(host=host, port=port, framer=framer), times)


async def connect_tls(
    host: str,
    *,
    port: int = 802,
    verify: bool | str = True,
    check_hostname: bool = True,
    client_cert: str | None = None,
    client_key: str | None = None,
    client_key_password: str | None = None,
    sslctx: ssl.SSLContext | None = None,
    **times: Unpack[Timings],
) -> ModbusConnection:
    """Connect over TLS, like `connect_tcp`; other arguments are as for ``ModbusTlsParams``."""
    params = theirs.ModbusTlsParams(
        host=host,
        port=port,
        verify=verify,
        check_hostname=check_hostname,
        client_cert=client_cert,
        client_key=client_key,
        client_key_password=client_key_password,
        sslctx=sslctx,
    )
    return await _connected(params, times)


async def connect_serial(
    port: str,
    *,
    baudrate: int = 9600,
    bytesize: Literal[7, 8] = 8,
    parity: Literal["N", "E", "O"] = "N",
    stopbits: Literal[1, 2] = 1,
    framer: Literal["rtu", "ascii"] = "rtu",
    **times: Unpack[Timings],
) -> ModbusConnection:
    """
    Connect to a serial port, or to a serial server at ``socket://HOST:PORT``. Errors are as for
    `connect_tcp`.
    """
    params = theirs.ModbusSerialParams(
        device=port,
        baudrate=baudrate,
        bytesize=bytesize,
        parity=parity,
        stopbits=stopbits,
        framer=framer,
    )
    return await _connected(params, times)


async def _connected(params: Params, times: Timings) -> ModbusConnection:
    connection = ModbusConnection(params, **times)
    try:
        await connection.connect()
    except BaseException:  # the caller gets no connection to close
        connection._closed = True
        connection._later.begin(connection.close())
        raise
    return connection
