"""
The schemes and options of URLs of endpoints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from ..protocol.checks import DURATION, duration_of

if TYPE_CHECKING:
    from ..protocol.framing import Framing

__all__ = [
    "ASCII_DEFAULTS", "CLIENT_OPTIONS", "DEFAULT_PORT", "OTHER_NAMES", "PARITIES", "SCHEMES",
    "SECURITY_OPTIONS", "SERIAL_DEFAULTS", "SERIAL_OPTIONS", "TRANSPORTS", "Option",
    "Scheme", "Transport", "TransportRules", "character_bits", "framing_of", "options_of",
    "parity_of", "shape_of",
]  # fmt: skip

DEFAULT_PORT = 502
"""The port of Modbus/TCP."""

Scheme = Literal["tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp", "tls", "unix", "rtu", "ascii"]

Transport = Literal["tcp", "udp", "tls", "unix", "serial"]

SCHEMES: dict[Scheme, tuple[Framing, Transport]] = {
    "tcp": ("tcp", "tcp"),
    "rtu+tcp": ("rtu", "tcp"),
    "ascii+tcp": ("ascii", "tcp"),
    "udp": ("udp", "udp"),
    "rtu+udp": ("rtu", "udp"),
    "tls": ("tcp", "tls"),
    "unix": ("tcp", "unix"),
    "rtu": ("rtu", "serial"),
    "ascii": ("ascii", "serial"),
}
"""Scheme -> framing and transport."""


def framing_of(url: str) -> Framing:
    """Return the framing of an endpoint's URL, of which only the scheme is read."""
    return SCHEMES[url.partition("://")[0]][0]  # type: ignore[index]


class Option(NamedTuple):
    """An option of URLs; the command line takes it as --NAME, with hyphens."""

    convert: Callable[[str], Any]  # or ValueError
    wanted: str  # what the text must be, for errors
    text: str  # what the option sets, for --help; without the default value
    placeholder: str = "N"  # for the value in --help; empty for a switch


def _switch(text: str) -> bool:
    return ("0", "1", "false", "true").index(text.lower()) % 2 == 1


PARITIES = {"none": "N", "even": "E", "odd": "O", "n": "N", "e": "E", "o": "O"}
"""Word -> parity, as serial ports take it."""


def parity_of(word: object) -> Any:
    """Return the parity of a word, such as "N" for "none" or "n", or raise ValueError."""
    if not isinstance(word, str) or word.lower() not in PARITIES:
        raise ValueError(f'parity must be "N", "E" or "O", not {word!r}')
    return PARITIES[word.lower()]


def _number(text: str) -> Option:
    return Option(int, "a number", text)


def _seconds(text: str) -> Option:
    return Option(duration_of, DURATION, text, "S")


def _text(text: str, placeholder: str) -> Option:
    return Option(str, "text", text, placeholder)


SERIAL_OPTIONS: dict[str, Option] = {
    "baudrate": _number("bits per second"),
    "parity": Option(parity_of, "none, even or odd", "parity: none, even or odd", "P"),
    "data_bits": _number("data bits of a character, 7 or 8"),
    "stop_bits": _number("stop bits, 1 or 2"),
    "rs485": _text(
        "direction control of an RS-485 transceiver: kernel, rts-up or rts-down", "MODE"
    ),
    "rts_delay": _seconds("seconds between RTS and the data; unless given, one character"),
    "echo": Option(_switch, "0 or 1", "all that is sent comes back; unless given, found out", ""),
    "silence": _seconds("seconds of silence between frames; unless given, 3.5 characters"),
}

SERIAL_DEFAULTS: dict[str, Any] = {"baudrate": 19200, "parity": "E", "data_bits": 8, "stop_bits": 1}


def character_bits(settings: Mapping[str, Any]) -> int:
    """Return the bits of a character on a line with settings as in `SERIAL_DEFAULTS`."""
    data: int = settings["data_bits"]
    stop: int = settings["stop_bits"]
    return 1 + data + int(settings["parity"] != "N") + stop


# ASCII frames are text with delimiters.
ASCII_DEFAULTS: dict[str, Any] = {"data_bits": 7, "silence": 0.0}

SECURITY_OPTIONS: dict[str, Option] = {
    "cert": _text("own certificate, a PEM file", "FILE"),
    "key": _text("private key of the certificate; unless given, in the same file", "FILE"),
    "ca": _text("certificates of the trusted authorities, a PEM file", "FILE"),
    "crl": _text("revocation lists of these authorities, a PEM file", "FILE"),
    "pin": _text("trust only this certificate: a PEM file, or its SHA-256", "FILE"),
    "server_name": _text("name in the server's certificate; unless given, the host", "NAME"),
    "password_env": _text("environment variable that contains the key's password", "NAME"),
}


class TransportRules(NamedTuple):
    """The properties of a transport."""

    port_class: str  # its file in this folder, imported when it is first needed, and its name
    options: Mapping[str, Option] = MappingProxyType({})  # of URLs, besides those of clients
    port: int = DEFAULT_PORT  # the one that a URL means without a port; 0 if there are none
    example: str = ""  # of a path, if endpoints are paths of this machine
    is_serial: bool = False
    is_datagram: bool = False  # each ADU is a datagram, without a connection
    is_secure: bool = False  # client and server show each other certificates

    @property
    def has_path(self) -> bool:
        """True if an endpoint is a path of this machine, not a host and a port."""
        return bool(self.example)


TRANSPORTS: dict[Transport, TransportRules] = {
    "tcp": TransportRules("sockets.TcpPort"),
    "udp": TransportRules("sockets.UdpPort", is_datagram=True),
    "tls": TransportRules("tls.TlsPort", SECURITY_OPTIONS, 802, is_secure=True),
    "unix": TransportRules("unix.UnixPort", port=0, example="/run/modbus.sock"),
    "serial": TransportRules(
        "serial.SerialPort", SERIAL_OPTIONS, 0, "/dev/ttyUSB0", is_serial=True
    ),
}


def options_of(scheme: Scheme) -> Mapping[str, Option]:
    """Return the options that URLs of a scheme may contain, besides those of clients."""
    framing, transport = SCHEMES[scheme]
    if transport == "tcp" and framing != "tcp":  # a line behind a converter
        return {"echo": SERIAL_OPTIONS["echo"]}
    return TRANSPORTS[transport].options


def shape_of(scheme: Scheme) -> str:
    """Return how URLs of a scheme look, for help texts: ``tcp://HOST[:502]``."""
    rules = TRANSPORTS[SCHEMES[scheme][1]]
    if rules.has_path:
        return f"{scheme}://{rules.example}"
    if "+" in scheme:  # for serial device servers, which have no usual port
        return f"{scheme}://HOST:PORT"
    return f"{scheme}://HOST[:{rules.port}]"


CLIENT_OPTIONS: dict[str, Option] = {
    "unit": _number("unit that is addressed, 0..255"),
    "timeout": _seconds("seconds until a request times out, including the time to connect"),
    "retries": _number("how often to repeat a request whose response is missing or damaged"),
    "busy_retries": _number("how often to repeat a request that a device refuses as busy"),
    "max_in_flight": _number("maximum number of requests in flight"),
    "turnaround": _seconds("seconds to wait after a broadcast"),
    "request_spacing": _seconds("minimum seconds between the starts of two requests"),
    "connect_delay": _seconds("seconds between connecting and the first request"),
    "timeouts_before_reconnect": _number("consecutive timeouts after which the client reconnects"),
    "keepalive": Option(
        lambda text: None if text == "none" else duration_of(text),
        f"{DURATION}, or none",
        "seconds of silence after which TCP probes the connection, or none",
        "S",
    ),
    "max_pause": _seconds("maximum seconds between two attempts to connect"),
    "accept_unit": _text("same; or any, to accept answers from another unit", "WHICH"),
    "write_function": _text("how values are written: auto, single or multiple", "WHICH"),
    "delimiter": Option(
        lambda text: int(text, 0),
        "a number such as 10 or 0x0A",
        "byte that ends ASCII frames, behind CR",
    ),
}

OTHER_NAMES = {"certificate": "cert", "trust": "ca"}
"""Names of arguments of `Security` -> the options of URLs that set them."""
