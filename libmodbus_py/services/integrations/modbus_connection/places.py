"""
Converts the parameters of modbus-connection to URLs of this package.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from modbus_connection import (
    ModbusSerialParams,
    ModbusTcpParams,
    ModbusTlsParams,
    ModbusUdpParams,
)

from ....ports.endpoint import Endpoint, parse
from ....ports.hosts import split_host_and_port
from ....ports.schemes import Scheme

__all__ = ["SUPPORTED_FRAMINGS", "Params", "url_of"]

Params: TypeAlias = ModbusTcpParams | ModbusUdpParams | ModbusTlsParams | ModbusSerialParams

SCHEMES: dict[str, dict[str, Scheme]] = {
    "tcp": {"socket": "tcp", "rtu": "rtu+tcp", "ascii": "ascii+tcp"},
    "udp": {"socket": "udp", "rtu": "rtu+udp"},
    "tls": {"socket": "tls"},
    "serial": {"rtu": "rtu", "ascii": "ascii"},
}
"""Transport -> framing -> scheme."""

SUPPORTED_FRAMINGS: Mapping[str, tuple[str, ...]] = {
    transport: tuple(framings) for transport, framings in SCHEMES.items()
}
"""Transport ("tcp", "udp", "tls", "serial") -> the framings that this backend supports on it."""

TRANSPORTS: dict[type, str] = {
    ModbusTcpParams: "tcp",
    ModbusUdpParams: "udp",
    ModbusTlsParams: "tls",
    ModbusSerialParams: "serial",
}

OVER_TCP = "socket://"


def url_of(params: Params) -> str:
    """
    Return the URL that parameters of modbus-connection describe.

    Raises:
        TypeError: `params` has another class.
        ValueError: a parameter is not supported; the message names it and the allowed values.
    """
    transport = next((TRANSPORTS[kind] for kind in TRANSPORTS if isinstance(params, kind)), "")
    if not transport:
        wanted = ", ".join(kind.__name__ for kind in TRANSPORTS)
        raise TypeError(f"params must be one of {wanted}, not {type(params).__name__}")
    if isinstance(params, ModbusSerialParams):
        return _serial(params)
    return _network(params, transport)


def _network(params: Any, transport: str) -> str:
    framer = getattr(params, "framer", "socket")
    if framer not in SCHEMES[transport]:
        possible = ", ".join(SCHEMES[transport])
        raise ValueError(
            f"framer must be one of {possible} over {transport.upper()}, not {framer!r}; "
            "modbus_connection.pymodbus.ModbusConnection may support it"
        )
    return _url("host", params.host, SCHEMES[transport][framer], params.host, params.port)


def _serial(params: ModbusSerialParams) -> str:
    device = params.device
    if device.startswith(OVER_TCP):
        host, port = _host_and_port(device)
        return _url("device", device, SCHEMES["tcp"][params.framer], host, port)
    if not device.startswith("/"):
        raise ValueError(f"device must be a path or socket://HOST:PORT, not {device!r}")
    scheme = SCHEMES["serial"][params.framer]
    options = {
        "baudrate": params.baudrate,
        "data_bits": params.bytesize,
        "parity": params.parity,
        "stop_bits": params.stopbits,
    }
    return _checked("device", device, Endpoint(scheme, path=device, options=options))


def _host_and_port(device: str) -> tuple[str, int]:
    with contextlib.suppress(ValueError):
        host, port = split_host_and_port(urlsplit(device).netloc)
        if port:
            return host, port
    raise ValueError(f"device must be a path or socket://HOST:PORT, not {device!r}")


def _url(name: str, given: str, scheme: Scheme, host: str, port: int) -> str:
    return _checked(name, given, Endpoint(scheme, host=host, port=port))


def _checked(name: str, given: str, endpoint: Endpoint) -> str:
    """Return the URL; refuse a host or device that a URL cannot contain unchanged."""
    try:
        if parse(endpoint.url) == endpoint:
            return endpoint.url
    except ValueError:
        pass
    raise ValueError(
        f"{name} {given!r} is invalid: in a URL, {endpoint.url!r}, it would name another endpoint"
    )
