"""
A backend of Home Assistant's modbus-connection: its connections and units, on `AsyncClient`.

::

    from modbus_connection import ModbusTcpParams
    from libmodbus_py.modbus_connection import ModbusConnection

    connection = ModbusConnection(ModbusTcpParams(host="192.0.2.10"), timeout=3)
    await connection.for_unit(1).read_holding_registers(100, 3)
    connection.statistics                # what happened on it, through all reconnections

Its files::

    connection   ClientConnection: made, lost, closed, with one request at a time
    units        ConnectionUnit: its 19 operations
    places       the URLs of parameters; which framings there are
    causes       the errors of modbus-connection for those of this package

It needs Python 3.13 or newer and modbus-connection: libmodbus-py[homeassistant].
"""

from __future__ import annotations

import ssl
from typing import Literal, TypedDict, Unpack

try:
    from modbus_connection import (
        ModbusSerialParams,
        ModbusTcpParams,
        ModbusTlsParams,
        ModbusUdpParams,
    )
except ImportError as error:
    raise ImportError(
        "the backend of modbus-connection needs Python 3.13 or newer, and it: "
        "pip install 'libmodbus-py[homeassistant]'"
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
    A link to a Modbus network, as ``modbus_connection.ModbusConnection`` says it.

    It connects with the first request, and again with the next one after it was lost. One
    request at a time goes over it, and none is sent twice: neither after a loss, nor after a
    timeout, nor when the device is busy. A timeout keeps the link, and an answer that comes after
    it is dropped. An answer to another request drops the link (ModbusDesyncError).

    It belongs to the event loop that uses it first.

    Args:
        params: ``ModbusTcpParams``, ``ModbusUdpParams``, ``ModbusTlsParams`` or
            ``ModbusSerialParams``, whose `device` may be ``socket://HOST:PORT``.
        timeout: seconds for one request, and for connecting; 10 unless given here or by a unit
            (``require_timeout``).
        message_spacing: seconds from the end of a request to the start of the next one.
        connect_delay: seconds between connecting and the first request.

    Attributes:
        url: where it leads, as `AsyncClient` takes it.
        statistics: what happened on it, through all its reconnections: `Statistics`, which
            ``integrations.prometheus.collect`` takes, too.
        last_error: what went wrong last, in words; empty if nothing did.

    Raises:
        TypeError, ValueError: parameters that lead nowhere, such as ASCII over UDP; times that
            are none.
    """

    def for_unit(self, unit_id: int) -> ConnectionUnit:
        """
        Return a handle for a unit, 0..255. On serial lines unit 0 is a broadcast: writes only.

        Raises:
            TypeError, ValueError: no such unit.
        """
        return ConnectionUnit(self, integer("unit_id", unit_id, 0, 255))


class Timings(TypedDict, total=False):
    """As of `ModbusConnection`."""

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
        host, port, framer: as of ``ModbusTcpParams``.
        times: `timeout`, `message_spacing` and `connect_delay` of `ModbusConnection`.

    Raises:
        TypeError, ValueError: as of `ModbusConnection`.
        modbus_connection.ModbusConnectionError, modbus_connection.ModbusTimeoutError: it cannot.
    """
    return await _connected(ModbusTcpParams(host=host, port=port, framer=framer), times)


async def connect_udp(
    host: str,
    *,
    port: int = 502,
    framer: Literal["socket", "rtu", "ascii"] = "socket",
    **times: Unpack[Timings],
) -> ModbusConnection:
    """As `connect_tcp`, over UDP; it has no framer "ascii"."""
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
    """As `connect_tcp`, over TLS; what is said of certificates is as of ``ModbusTlsParams``."""
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
    """As `connect_tcp`, at a serial port, or ``socket://HOST:PORT``, which leads to one."""
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
    except BaseException:  # whoever waits no more has nothing to close
        connection.close_later()
        raise
    return connection
