"""
What URLs of endpoints may say: schemes, and options with their types.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from ..protocol.framing import Framing

# fmt: off
__all__ = [
    "CLIENT_OPTIONS", "DEFAULT_PORT", "SCHEMES", "SECURE_PORT", "SECURITY_OPTIONS",
    "SERIAL_OPTIONS", "Option", "Scheme", "Transport", "framing_of",
]
# fmt: on

DEFAULT_PORT = 502

# Of Modbus Security.
SECURE_PORT = 802

Scheme = Literal["tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp", "tls", "rtu", "ascii"]

Transport = Literal["tcp", "udp", "tls", "serial"]

SCHEMES: dict[Scheme, tuple[Framing, Transport]] = {
    "tcp": ("tcp", "tcp"),
    "rtu+tcp": ("rtu", "tcp"),
    "ascii+tcp": ("ascii", "tcp"),
    "udp": ("udp", "udp"),
    "rtu+udp": ("rtu", "udp"),
    "tls": ("tcp", "tls"),
    "rtu": ("rtu", "serial"),
    "ascii": ("ascii", "serial"),
}
"""Scheme -> framing, and what carries the bytes."""


def framing_of(url: str) -> Framing:
    """
    Return the framing of an endpoint's URL, of which only the scheme is read.

    Raises:
        KeyError: the scheme is not one of `SCHEMES`.
    """
    return SCHEMES[url.partition("://")[0]][0]  # type: ignore[index]


Option = tuple[Callable[[str], Any], str]
"""Converts a text; and what the text must be."""

INTEGER: Option = (int, "a number")
SECONDS: Option = (float, "a number")
TEXT: Option = (str, "text")
SWITCH: Option = (lambda text: ("0", "1", "false", "true").index(text.lower()) % 2 == 1, "0 or 1")

SERIAL_OPTIONS: dict[str, Option] = {
    "baudrate": INTEGER,
    "parity": TEXT,
    "data_bits": INTEGER,
    "stop_bits": INTEGER,
    "rs485": TEXT,
    "rts_delay": SECONDS,
    "echo": SWITCH,
    "silence": SECONDS,
}

SECURITY_OPTIONS: dict[str, Option] = dict.fromkeys(
    ("cert", "key", "ca", "pin", "server_name", "password_env"), TEXT
)

CLIENT_OPTIONS: dict[str, Option] = {
    "unit": INTEGER,
    "timeout": SECONDS,
    "retries": INTEGER,
    "busy_retries": INTEGER,
    "max_in_flight": INTEGER,
    "turnaround": SECONDS,
    "request_spacing": SECONDS,
    "connect_delay": SECONDS,
    "timeouts_before_reconnect": INTEGER,
    "keepalive": (lambda text: None if text == "none" else float(text), "a number or none"),
    "max_pause": SECONDS,
    "native": SWITCH,
    "accept_unit": TEXT,
    "delimiter": (lambda text: int(text, 0), "a number such as 10 or 0x0A"),
}
