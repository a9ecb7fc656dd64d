"""
Conversions: parameters of modbus-connection to URLs, errors of this package to those of it.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeAlias
from urllib.parse import urlsplit

import modbus_connection as theirs

from ....ports.endpoint import Endpoint, parse
from ....ports.hosts import split_host_and_port
from ....ports.schemes import Scheme
from ....protocol.errors import (
    ExceptionResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)

__all__ = ["SUPPORTED_FRAMINGS", "Params", "converted", "not_connected", "url_of"]

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


def url_of(params: Params) -> str:
    """Return the URL that parameters of modbus-connection describe."""
    found = next((SCHEMES[kind] for kind in SCHEMES if isinstance(params, kind)), None)
    if found is None:
        wanted = ", ".join(kind.__name__ for kind in SCHEMES)
        raise TypeError(f"params must be one of {wanted}, not {type(params).__name__}")
    transport, schemes = found
    framer = getattr(params, "framer", "socket")
    if framer not in schemes:
        raise ValueError(
            f"framer must be one of {', '.join(schemes)} over {transport.upper()}, not {framer!r}; "
            "modbus_connection.pymodbus.ModbusConnection may support it"
        )
    if isinstance(params, theirs.ModbusSerialParams):
        return _of_serial(params)
    endpoint = Endpoint(schemes[framer], host=params.host, port=params.port)
    return _checked("host", params.host, endpoint)


def _of_serial(params: theirs.ModbusSerialParams) -> str:
    device, framer = params.device, params.framer
    if device.startswith("/"):
        options = {
            "baudrate": params.baudrate,
            "data_bits": params.bytesize,
            "parity": params.parity,
            "stop_bits": params.stopbits,
        }
        return _checked("device", device, Endpoint(framer, path=device, options=options))
    host, port = "", None
    if device.startswith("socket://"):
        with contextlib.suppress(ValueError):
            host, port = split_host_and_port(urlsplit(device).netloc)
    if not port:
        raise ValueError(f"device must be a path or socket://HOST:PORT, not {device!r}")
    scheme: Scheme = "rtu+tcp" if framer == "rtu" else "ascii+tcp"
    return _checked("device", device, Endpoint(scheme, host=host, port=port))


def _checked(name: str, given: str, endpoint: Endpoint) -> str:
    """Return the URL; refuse a host or device that a URL cannot contain unchanged."""
    with contextlib.suppress(ValueError):
        found = parse(endpoint.url)
        # URLs contain hosts in lower case.
        if (
            found == replace(endpoint, host=found.host)
            and found.host.lower() == endpoint.host.lower()
        ):
            return found.url
    raise ValueError(
        f"{name} {given!r} is invalid: in a URL, {endpoint.url!r}, it would name another endpoint"
    )


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
    return _kind(error)(text)


def not_connected(error: ModbusConnectionError | RuntimeError) -> theirs.ModbusError:
    """Return the error of modbus-connection for a connection that could not be established."""
    is_late = getattr(error, "errno", None) == errno.ETIMEDOUT
    kind = theirs.ModbusTimeoutError if is_late else theirs.ModbusConnectionError
    return kind(_reason(error))


def _kind(error: ModbusError | RuntimeError) -> type[theirs.ModbusError]:
    if getattr(error, "answers_another", False):
        return theirs.ModbusDesyncError
    return next(kind for ours, kind in KINDS if isinstance(error, ours))


def _reason(error: Cause) -> str:
    """Return the message of an error without its request, because the operation names that."""
    if isinstance(error, ModbusError):
        place = "" if error.unit is None or not error.asked else f"unit {error.unit}: "
        return f"{place}{error.args[0]}"
    return str(error)
