"""The schemes of URLs of endpoints, and what sets their transports apart."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple

from .options import FILE, NAME, SERIAL_OPTIONS, Option

if TYPE_CHECKING:
    from ..protocol.framing import Framing

DEFAULT_PORT = 502
"""The port of Modbus/TCP."""

Scheme = Literal[
    "tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp", "tls", "unix", "rtu", "ascii",
    "listen+tcp", "listen+rtu+tcp",
]  # fmt: skip

Transport = Literal["tcp", "udp", "tls", "unix", "serial", "listen"]

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
    "listen+tcp": ("tcp", "listen"),
    "listen+rtu+tcp": ("rtu", "listen"),
}
"""Scheme -> framing and transport."""


def framing_of(url: str) -> Framing:
    """Return the framing of an endpoint's URL, of which only the scheme is read."""
    return SCHEMES[url.partition("://")[0]][0]  # type: ignore[index]


SECURITY_OPTIONS: Mapping[str, Option] = {
    "cert": Option("own certificate, a PEM file", FILE),
    "key": Option("private key of the certificate; by default, in the same file", FILE),
    "ca": Option("certificates of the trusted authorities, a PEM file", FILE),
    "crl": Option("revocation lists of these authorities, a PEM file", FILE),
    "pin": Option("trust only this certificate: a PEM file, or its SHA-256", FILE),
    "server_name": Option("name in the server's certificate; by default, the host", NAME),
    "password_env": Option("environment variable that contains the key's password", NAME),
}
"""The options of tls:// URLs."""


class TransportRules(NamedTuple):
    """The properties of a transport."""

    port_class: str  # the file of the port, and its class
    options: Mapping[str, Option] = MappingProxyType({})  # of URLs, besides those of clients
    port: int = DEFAULT_PORT  # of a URL that names no port; 0 if the transport has no ports
    example: str = ""  # of a path, if endpoints are paths of this machine
    is_serial: bool = False
    is_datagram: bool = False  # each ADU is a datagram, without a connection
    is_secure: bool = False  # client and server show each other certificates
    is_listening: bool = False  # the client listens, and its device connects

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
    "listen": TransportRules("listening.ListeningPort", is_listening=True),
}


def options_of(scheme: Scheme) -> Mapping[str, Option]:
    """Return the options that URLs of a scheme may contain, besides those of clients."""
    framing, transport = SCHEMES[scheme]
    if transport in ("tcp", "listen") and framing != "tcp":  # a line behind a converter
        return {name: SERIAL_OPTIONS[name] for name in ("echo", "silence")}
    return TRANSPORTS[transport].options


def shape_of(scheme: Scheme) -> str:
    """Return how URLs of a scheme look, for help texts: ``tcp://HOST[:502]``."""
    rules = TRANSPORTS[SCHEMES[scheme][1]]
    if rules.has_path:
        return f"{scheme}://{rules.example}"
    if "+" in scheme:  # for serial device servers, which have no usual port
        return f"{scheme}://HOST:PORT"
    return f"{scheme}://HOST[:{rules.port}]"
