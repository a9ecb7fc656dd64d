"""
Endpoints as URLs, alike for clients, servers and the command line.

::

    tcp://HOST:PORT    rtu+tcp://HOST:PORT    ascii+tcp://HOST:PORT    udp://HOST:PORT
    rtu:///dev/ttyUSB0?baudrate=19200&parity=E&data_bits=8&stop_bits=1
    ascii:///dev/ttyUSB0?baudrate=9600&parity=E&data_bits=7&stop_bits=1

HOST is a name, an IPv4 address or an IPv6 address in brackets; the default port
is 502. udp has one frame of Modbus/TCP in each datagram. Serial ports also take
rs485 (kernel, rts-up, rts-down), rts_delay and silence (seconds), echo (0, 1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal
from urllib.parse import parse_qsl, unquote, urlsplit

__all__ = ["DEFAULT_PORT", "Endpoint", "parse"]

DEFAULT_PORT = 502

Framing = Literal["tcp", "rtu", "ascii", "udp"]

Transport = Literal["tcp", "udp", "serial"]

SCHEMES: dict[str, tuple[Framing, Transport]] = {
    "tcp": ("tcp", "tcp"),
    "rtu+tcp": ("rtu", "tcp"),
    "ascii+tcp": ("ascii", "tcp"),
    "udp": ("udp", "udp"),
    "rtu": ("rtu", "serial"),
    "ascii": ("ascii", "serial"),
}
"""Scheme -> framing, and what carries the bytes."""


def _switch(text: str) -> bool:
    return {"1": True, "true": True, "0": False, "false": False}[text.lower()]


SERIAL_OPTIONS: dict[str, Callable[[str], Any]] = {
    "baudrate": int,
    "parity": str,
    "data_bits": int,
    "stop_bits": int,
    "rs485": str,
    "rts_delay": float,
    "echo": _switch,
    "silence": float,
}


@dataclass(frozen=True)
class Endpoint:
    """
    Where to connect or to listen.

    Attributes:
        scheme: one of `SCHEMES`.
        host, port: for TCP and UDP; else empty and 0.
        device: for serial ports; else empty.
        options: settings of the serial port, converted but not checked.
    """

    scheme: str
    host: str = ""
    port: int = 0
    device: str = ""
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def framing(self) -> Framing:
        """ "tcp", "rtu", "ascii" or "udp"."""
        return SCHEMES[self.scheme][0]

    @property
    def transport(self) -> Transport:
        """ "tcp", "udp" or "serial"."""
        return SCHEMES[self.scheme][1]

    def __str__(self) -> str:
        if self.transport == "serial":
            query = "&".join(f"{name}={value}" for name, value in self.options.items())
            return f"{self.scheme}://{self.device}{'?' if query else ''}{query}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse(url: str) -> Endpoint:
    """
    Read a URL.

    Raises:
        TypeError: not a string.
        ValueError: which part is wrong, and what is allowed.
    """
    if not isinstance(url, str):
        raise TypeError(f"url must be a string, not {type(url).__name__}")
    parts = urlsplit(url)
    if parts.scheme not in SCHEMES:
        raise ValueError(f"{url!r}: the scheme must be one of {', '.join(SCHEMES)}")
    if parts.fragment or parts.username is not None:
        raise ValueError(f"{url!r}: neither user nor fragment have a meaning here")
    read = _parse_serial if SCHEMES[parts.scheme][1] == "serial" else _parse_network
    return read(url, parts)


def _parse_network(url: str, parts: Any) -> Endpoint:
    if parts.path not in ("", "/") or parts.query:
        raise ValueError(f"{url!r}: nothing may follow the port")
    if not parts.hostname:
        raise ValueError(f"{url!r}: a host is missing, as in {parts.scheme}://127.0.0.1:502")
    try:
        port = DEFAULT_PORT if parts.port is None else parts.port
    except ValueError:
        raise ValueError(f"{url!r}: the port must be in 0..65535") from None
    return Endpoint(parts.scheme, host=parts.hostname, port=port)


def _parse_serial(url: str, parts: Any) -> Endpoint:
    device = unquote(parts.path)
    if parts.netloc or not device.strip("/"):
        raise ValueError(f"{url!r}: a device is missing, as in {parts.scheme}:///dev/ttyUSB0")
    options: dict[str, Any] = {}
    for name, text in parse_qsl(parts.query, keep_blank_values=True):
        convert = SERIAL_OPTIONS.get(name)
        if convert is None:
            raise ValueError(f"{url!r}: {name!r} must be one of {', '.join(SERIAL_OPTIONS)}")
        try:
            options[name] = convert(text)
        except ValueError:
            raise ValueError(f"{url!r}: {name} must be a number, not {text!r}") from None
        except KeyError:
            raise ValueError(f"{url!r}: {name} must be 0 or 1, not {text!r}") from None
    return Endpoint(parts.scheme, device=device, options=options)
