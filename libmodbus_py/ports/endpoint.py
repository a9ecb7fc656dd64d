"""
Endpoints as URLs, alike for clients, servers and the command line.

The schemes are those of `SCHEMES` in `schemes`, among them::

    tcp://HOST:PORT    rtu+tcp://HOST:PORT    ascii+tcp://HOST:PORT
    udp://HOST:PORT    rtu+udp://HOST:PORT
    tls://HOST:PORT?cert=own.pem&key=own.key&ca=authority.pem
    unix:///run/modbus.sock
    listen+tcp://0.0.0.0:PORT    listen+rtu+tcp://0.0.0.0:PORT    the device connects to it
    rtu:///dev/ttyUSB0?baudrate=19200&parity=E&data_bits=8&stop_bits=1
    ascii:///dev/ttyUSB0?baudrate=9600&parity=E&data_bits=7&stop_bits=1

Without a scheme, a path such as /dev/ttyUSB0 is a serial port in RTU mode, and all else a host for
tcp: 192.0.2.10, 192.0.2.10:1502, [::1]:1502.

HOST is a name, an IPv4 address or an IPv6 address in brackets. With udp, each datagram contains one
frame of Modbus/TCP; with rtu+udp, one RTU frame. Every URL may contain options of clients:
``tcp://192.0.2.10?unit=7&timeout=0.5``.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from os.path import abspath, expanduser
from typing import TYPE_CHECKING, Any

from ..protocol.mistakes import close_option, close_to
from ..protocol.scan import pause_between_frames
from .hosts import host_and_port, split_host_and_port
from .options import ASCII_DEFAULTS, CLIENT_OPTIONS, SERIAL_DEFAULTS, Option, character_bits
from .schemes import DEFAULT_PORT, SCHEMES, TRANSPORTS, Scheme, Transport, options_of, shape_of

if TYPE_CHECKING:
    from urllib.parse import SplitResult

    from ..protocol.framing import Framing

# A password has no use here, but a URL may contain one, which must not be logged.
PASSWORD = "(?<=password=)[^&#]+|(?<=:)[^/@:]+(?=@)"

# Schemes of other programs without their signs -> the one that is meant here. They stand in URLs
# of pyserial, simonvetter/modbus, Telegraf, NewLife.Modbus, the W3C's Modbus binding, and others.
OTHER_SCHEMES: dict[str, Scheme] = {
    **dict.fromkeys(("modbus", "modbustcp", "mbtcp", "mbap"), "tcp"),
    **dict.fromkeys(("socket", "serialtcp", "tcprtu", "rtutcp", "rtuovertcp"), "rtu+tcp"),
    **dict.fromkeys(("tcpascii", "asciitcp", "asciiovertcp"), "ascii+tcp"),
    **dict.fromkeys(("modbusudp", "mbudp"), "udp"),
    **dict.fromkeys(("udprtu", "rtuudp", "rtuoverudp"), "rtu+udp"),
    **dict.fromkeys(("tcptls", "tlstcp", "tcps", "ssl", "modbustls", "modbuss", "mbaps"), "tls"),
    **dict.fromkeys(("serial", "file", "tty", "modbusrtu", "rtuserial"), "rtu"),
    "modbusascii": "ascii",
}


@dataclass(frozen=True)
class Endpoint:
    """An endpoint to connect to or to listen at; ``str`` is its URL, without client options."""

    scheme: Scheme
    host: str = ""
    port: int = 0
    path: str = ""  # of a serial port or a Unix socket, which have no host
    # Both are converted, but not checked.
    options: dict[str, Any] = field(default_factory=dict, hash=False)
    client_options: dict[str, Any] = field(default_factory=dict, hash=False)

    @property
    def framing(self) -> Framing:
        """ "tcp", "rtu", "ascii" or "udp"."""
        return SCHEMES[self.scheme][0]

    @property
    def transport(self) -> Transport:
        """ "tcp", "udp", "tls", "unix" or "serial"."""
        return SCHEMES[self.scheme][1]

    @property
    def has_path(self) -> bool:
        return TRANSPORTS[self.transport].has_path

    @property
    def is_serial(self) -> bool:
        return TRANSPORTS[self.transport].is_serial

    @property
    def is_datagram(self) -> bool:
        return TRANSPORTS[self.transport].is_datagram

    @property
    def is_secure(self) -> bool:
        return TRANSPORTS[self.transport].is_secure

    @property
    def is_listening(self) -> bool:
        return TRANSPORTS[self.transport].is_listening

    @property
    def has_transactions(self) -> bool:
        """True if ADUs have a transaction id; False for the framings of serial lines."""
        return self.framing in ("tcp", "udp")

    @property
    def address(self) -> str:
        """The path, or the host and its port as in "192.0.2.1:502"."""
        return self.path if self.has_path else host_and_port(self.host, self.port)

    @property
    def key(self) -> tuple[str, str]:
        """The kind of port and the address, on all machines the same: no name is looked up."""
        kind = "tcp" if self.is_secure else self.transport
        if self.has_path:
            return kind, posixpath.normpath(f"/{self.path.lstrip('/')}")
        return kind, host_and_port(_one_spelling(self.host), self.port)

    @property
    def serial_settings(self) -> dict[str, Any]:
        """The settings of the serial port, with the defaults of the framing for missing ones."""
        defaults = ASCII_DEFAULTS if self.framing == "ascii" else {}
        return {**defaults, **self.options}

    @property
    def pause(self) -> float:
        """The seconds of silence between frames on a serial line; 0 on networks."""
        if not self.is_serial:
            return 0.0
        settings = {**SERIAL_DEFAULTS, **self.serial_settings}
        return pause_between_frames(settings["baudrate"], character_bits(settings))

    @property
    def url(self) -> str:
        return self._shown({**self.options, **self.client_options})

    def __str__(self) -> str:
        return self._shown({} if self.is_secure else self.options)

    def _shown(self, options: dict[str, Any]) -> str:
        at = host_and_port(_zoned(self.host), self.port)
        address = _quoted(self.path) if self.has_path else at
        texts = {
            name: "none" if value is None else str(value)
            for name, value in options.items()
            if not callable(value)  # no URL can name a function
        }
        query = "&".join(f"{name}={_quoted(text, '/')}" for name, text in texts.items())
        return f"{self.scheme}://{address}{'?' if query else ''}{query}"


def _quoted(text: str, safe: str = "/:@+,=~") -> str:
    """Return a path or an option as URLs contain it; bytes that are not UTF-8 are quoted, too."""
    from urllib.parse import quote

    return quote(text, safe, errors="surrogateescape")


def _zoned(host: str) -> str:
    """Return a host as URLs contain it: with %25 before the zone of an IPv6 address (RFC 6874)."""
    return host.replace("%", "%25", 1)


def _one_spelling(host: str) -> str:
    """Return a host as it is usually written: ::1 for 0:0:0:0:0:0:0:1, and names in lower case."""
    if ":" not in host:
        return host.lower()
    from socket import AF_INET6, inet_ntop, inet_pton

    address, percent, zone = host.partition("%")
    try:
        return f"{inet_ntop(AF_INET6, inet_pton(AF_INET6, address))}{percent}{zone}"
    except OSError:
        return host.lower()


def parse(url: str) -> Endpoint:
    """Return the endpoint of a URL, a host, HOST:PORT, or a path, or raise ValueError."""
    if not isinstance(url, str):
        raise TypeError(f"url must be a string, not {type(url).__name__}")
    from urllib.parse import unquote, urlsplit

    url = url_of(url)
    parts = urlsplit(url)
    url = re.sub(PASSWORD, "***", url)  # from here on the text is for error messages only
    if re.search(r"[\x00-\x1f\x7f]", url):  # of which Python leaves some out
        raise ValueError(f"{url!r}: a URL has no control characters")
    if parts.scheme not in SCHEMES:
        raise ValueError(f"{url!r}: {_wrong_scheme(url.partition('://')[0].lower())}")
    if parts.fragment or parts.username is not None:
        raise ValueError(f"{url!r}: neither user nor fragment have a meaning here")
    scheme: Scheme = parts.scheme
    options, others = _options(url, parts.query, options_of(scheme))
    if not TRANSPORTS[SCHEMES[scheme][1]].has_path:
        host, port = _host_and_port(url, scheme, parts)
        return Endpoint(scheme, host, port, "", options, others)
    path = unquote(parts.path, errors="surrogateescape")
    if parts.netloc or not path.strip("/"):
        raise ValueError(f"{url!r}: a path is missing, as in {shape_of(scheme)}")
    return Endpoint(scheme, "", 0, path, options, others)


def _wrong_scheme(scheme: str) -> str:
    if scheme == "rfc2217":
        return (
            "RFC 2217 is not supported; set the line in the serial device server, let it pass raw "
            "bytes (its mode is called raw, socket or TCP server), and use rtu+tcp://"
        )
    suggestion = OTHER_SCHEMES.get(re.sub("[^a-z]", "", scheme))
    close = f"; did you mean {suggestion}://?" if suggestion else close_to(scheme, SCHEMES)
    return f"the scheme must be one of {', '.join(SCHEMES)}{close}"


def url_of(text: str) -> str:
    """Return a URL: without a scheme a path is a serial port in RTU mode, all else tcp."""
    if "://" in text:
        return text
    place, mark, query = text.partition("?")
    if place.startswith(("/", "./", "../", "~/")):
        return f"rtu://{_quoted(abspath(expanduser(place)))}{mark}{query}"
    try:
        host, port = split_host_and_port(place)
        # A number alone is not a host, but a unit that stands where the URL should.
        if re.fullmatch("[0-9,-]+", place):
            raise ValueError
    except ValueError:
        url = re.sub(PASSWORD, "***", text)
        raise ValueError(
            f"{url!r}: must be a URL, such as tcp://192.0.2.10, a host or a path of a serial port"
        ) from None
    at = host_and_port(_zoned(host), DEFAULT_PORT if port is None else port)
    return f"tcp://{at}{mark}{query}"


def parse_to_listen(url: str) -> Endpoint:
    """Return the endpoint of a URL at which to listen, as `parse`."""
    endpoint = parse(url)
    if endpoint.is_listening:
        raise ValueError(f"{url!r}: this is for clients, whose device connects; servers: tcp://")
    if endpoint.client_options:
        names = ", ".join(endpoint.client_options)
        raise ValueError(f"{url!r}: {names} is for clients, not for an endpoint that listens")
    return endpoint


def _host_and_port(url: str, scheme: Scheme, parts: SplitResult) -> tuple[str, int]:
    if parts.path not in ("", "/"):
        raise ValueError(f"{url!r}: nothing but options may follow the port")
    if not parts.netloc:
        raise ValueError(f"{url!r}: a host is missing, as in {scheme}://127.0.0.1:502")
    try:
        host, port = split_host_and_port(parts.netloc)
    except ValueError as error:
        raise ValueError(f"{url!r}: {error}") from None
    if ":" in host and not parts.netloc.startswith("["):
        raise ValueError(f"{url!r}: an IPv6 address needs brackets, as in {scheme}://[::1]:502")
    name, percent, zone = host.partition("%")
    if zone.startswith("25") and zone != "25":  # "%25" by RFC 6874; "%" alone is common
        zone = zone[2:]
    host = f"{name.lower()}{percent}{zone}"  # a zone is the name of an interface, as it is written
    return host, TRANSPORTS[SCHEMES[scheme][1]].port if port is None else port


def _options(
    url: str, query: str, own: Mapping[str, Option]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the options of the endpoint itself, and those of clients."""
    from urllib.parse import parse_qsl

    choices = {**own, **CLIENT_OPTIONS}
    options: dict[str, Any] = {}
    for name, text in parse_qsl(query, keep_blank_values=True, errors="surrogateescape"):
        if name not in choices:
            close = close_option(name, choices)
            raise ValueError(f"{url!r}: {name!r} must be one of {', '.join(choices)}{close}")
        if name in options:
            raise ValueError(f"{url!r}: {name} is given twice")
        form = choices[name].form
        try:
            options[name] = form.convert(text)
        except ValueError:
            raise ValueError(f"{url!r}: {name} must be {form.wanted}, not {text!r}") from None
    return (
        {name: value for name, value in options.items() if name in own},
        {name: value for name, value in options.items() if name not in own},
    )
