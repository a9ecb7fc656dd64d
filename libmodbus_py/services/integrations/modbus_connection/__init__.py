"""
A backend of Home Assistant's modbus-connection: connections and units built on `AsyncClient`.

::

    from modbus_connection import ModbusTcpParams
    from libmodbus_py.modbus_connection import ModbusConnection

    connection = ModbusConnection(ModbusTcpParams(host="192.0.2.10"), timeout=3)
    await connection.for_unit(1).read_holding_registers(100, 3)
    connection.statistics                # counters, which continue after a reconnection

Files::

    connection   ClientConnection: connects, closes, and sends one request at a time
    units        ConnectionUnit: the 19 operations of a unit
    places       converts parameters to URLs; the supported framings
    causes       converts errors of this package to those of modbus-connection

It needs Python 3.13 or newer, and modbus-connection, which libmodbus-py[homeassistant] installs.
"""

from __future__ import annotations

import ssl
from typing import Literal, TypedDict, Unpack

from ....protocol.extras import how_to_add

try:
    from modbus_connection import (
        ModbusSerialParams,
        ModbusTcpParams,
        ModbusTlsParams,
        ModbusUdpParams,
    )
except ImportError as error:
    raise ImportError(
        "the backend of modbus-connection needs modbus-connection and Python 3.13 or newer: "
        + how_to_add("homeassistant")
    ) from error

from ....protocol.checks import integer
from .connection import ClientConnection
from .places import SUPPORTED_FRAMINGS, Params
from .units import ConnectionUnit

# fmt: off
__all__ = [
    "SUPPORTED_FRAMINGS", "ModbusConnection", "connect_serial", "connect_tcp", "connect_tls",
    "connect_udp",
]
# fmt: on


class ModbusConnection(ClientConnection):
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

    def for_unit(self, unit_id: int) -> ConnectionUnit:
        """
        Return a handle for a unit, 0..255. On serial lines unit 0 is a broadcast: writes only.

        Raises:
            TypeError, ValueError: `unit_id` has the wrong type, or is out of range.
        """
        return ConnectionUnit(self, integer("unit_id", unit_id, 0, 255))


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
    return await _connected(ModbusTcpParams(host=host, port=port, framer=framer), times)


async def connect_udp(
    host: str,
    *,
    port: int = 502,
    framer: Literal["socket", "rtu", "ascii"] = "socket",
    **times: Unpack[Timings],
) -> ModbusConnection:
    """Connect over UDP, like `connect_tcp`; `framer` must not be "ascii"."""
    return await _connected(ModbusUdpParams(host=host, port=port, framer=framer), times)


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
    params = ModbusTlsParams(
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
    params = ModbusSerialParams(
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
        connection.close_later()
        raise
    return connection
