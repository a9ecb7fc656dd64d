"""
Whom to ask: the options of every command that is a client, and the client they make.
"""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any

from . import security
from .help import VerbatimHelp

if TYPE_CHECKING:
    from ..client.blocking import Context
    from ..ports.endpoint import Endpoint

__all__ = ["URLS", "add_arguments", "connected", "endpoint_of", "url_of"]

URLS = """\
URL: tcp://HOST[:502], tls://HOST[:802], udp://HOST[:502], rtu+tcp://HOST:PORT, ascii+tcp://...,
     rtu:///dev/ttyUSB0, ascii:///dev/ttyUSB0; or just HOST, HOST:PORT or /dev/ttyUSB0.
     Options follow a question mark, in quotes, for & has a meaning in a shell,
     such as "rtu:///dev/ttyUSB0?baudrate=9600&parity=N" or "tcp://192.0.2.10?unit=7&timeout=2"
     any: unit timeout retries busy_retries request_spacing connect_delay accept_unit native ...
     serial: baudrate parity data_bits stop_bits rs485 rts_delay echo silence
     tls: cert key ca pin server_name password_env"""
"""The end of each --help."""

PARITIES = {"none": "N", "even": "E", "odd": "O", "n": "N", "e": "E", "o": "O"}

SERIAL = ("baudrate", "parity", "data_bits", "stop_bits")


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Tell argparse of them."""
    command.formatter_class = VerbatimHelp
    command.add_argument(
        "url", metavar="URL", help="such as 192.0.2.10, tcp://192.0.2.10:1502 or /dev/ttyUSB0"
    )
    command.add_argument(
        "-u", "--unit", type=int, metavar="N", help="0..255 (that of the URL, or 1)"
    )
    command.add_argument("--timeout", type=float, metavar="S", help="seconds (of the URL, or 1)")
    command.add_argument(
        "-v", "--verbose", action="store_true", help="show every frame on stderr, both ways"
    )
    group = command.add_argument_group("of a serial port, unless the URL says it")
    group.add_argument("-b", "--baudrate", type=int, metavar="N", help="bits per second (19200)")
    group.add_argument("-p", "--parity", type=_parity, metavar="P", help="none, even or odd (even)")
    group.add_argument("-d", "--data-bits", type=int, metavar="N", help="7 or 8 (8; ascii: 7)")
    group.add_argument("-s", "--stop-bits", type=int, metavar="N", help="1 or 2 (1)")
    security.add_arguments(command)


def _parity(text: str) -> str:
    try:
        return PARITIES[text.lower()]
    except KeyError:
        raise argparse.ArgumentTypeError(f"must be none, even or odd, not {text!r}") from None


def endpoint_of(options: argparse.Namespace) -> Endpoint:
    """
    Give where to connect: the URL, and what options say instead.

    Raises:
        ValueError: which part is wrong, and what is allowed.
    """
    from dataclasses import replace

    from ..ports.endpoint import parse

    endpoint = parse(url_of(options.url))
    serial = _given(options, SERIAL)
    if serial and endpoint.transport != "serial":
        name = next(iter(serial)).replace("_", "-")
        raise ValueError(f"--{name} is for serial ports, and means nothing on {endpoint}")
    return replace(
        endpoint,
        options={**endpoint.options, **serial},
        client_options={**endpoint.client_options, **_given(options, ("unit", "timeout"))},
    )


def connected(options: argparse.Namespace) -> Context:
    """
    Make the client; it connects when it is used.

    Raises:
        TypeError, ValueError: an option is wrong.
    """
    from ..client.blocking import Context

    given: dict[str, Any] = {}
    if (secured := security.told(options)) is not None:
        given["security"] = secured
    if options.verbose:
        from .tracing import Tracing

        given["trace"] = Tracing()
    return Context.from_url(endpoint_of(options).url, **given)


def _given(options: argparse.Namespace, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: value for name in names if (value := getattr(options, name)) is not None}


def url_of(text: str) -> str:
    """
    Give a URL for what was typed: without a scheme a path is a serial port, all else a host.

    Raises:
        ValueError: it can be neither.
    """
    if "://" in text:
        return text
    if text.startswith(("/", "./", "../", "~/")):
        from os.path import abspath, expanduser

        path, mark, query = text.partition("?")
        return f"rtu://{abspath(expanduser(path))}{mark}{query}"
    host, mark, query = text.partition("?")
    if host.count(":") > 1 and not host.startswith("["):
        host = f"[{host}]"
    if not re.fullmatch(r"\[[^\]]+\](:[0-9]+)?|[^:/\[\]@]+(:[0-9]+)?", host):
        raise ValueError(
            f"{text!r} must be a URL, such as tcp://192.0.2.10, a host or a path of a serial port"
        )
    return f"tcp://{host}{mark}{query}"
