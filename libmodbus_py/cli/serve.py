"""
The command serve: a device file, or one device that has everything, until a signal.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from collections.abc import Callable, Iterator
from functools import partial
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from ..device.device import Device
from ..device.mapping import Mapping
from ..ports.endpoint import SCHEMES, Endpoint, parse
from ..protocol.errors import ModbusConnectionError
from ..protocol.pdu import RECORDS_PER_FILE
from ..server.limits import FULL_POLICIES, Limits
from ..server.server import Running, Server
from ..server.units import UNKNOWN_UNIT_POLICIES
from ..simulator import device_file
from . import security

__all__ = ["add_command"]

LIMITS: list[tuple[str, Callable[[str], Any], str, str]] = [
    ("max-connections", int, "N", "over TCP (what the descriptor limit leaves)"),
    ("connections-per-address", int, "N", "of them for one address (a tenth, but 8 at least)"),
    ("frame-timeout", float, "S", "seconds that a frame may take from its first byte (5)"),
    ("handshake-timeout", float, "S", "seconds to the end of a TLS handshake (5)"),
    ("idle-timeout", float, "S", "seconds without a request, inf for no limit (3600)"),
    ("max-unsent", int, "BYTES", "of answers that a client does not take (65536)"),
    ("requests-per-second", float, "N", "of one address (no limit; UDP: 1000)"),
]
"""Options of `serve` that are one number."""

LIMIT_NAMES = [*(name.replace("-", "_") for name, *_ in LIMITS), "when_full", "allow"]


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "serve",
        help="serve a device file; or all tables and ten files, all zero, to every unit",
        epilog=f"URLs: {' '.join(f'{scheme}://...' for scheme in SCHEMES)}",
    )
    command.add_argument("urls", metavar="URL", nargs="+", help="such as tcp://127.0.0.1:1502")
    command.add_argument("--device", metavar="FILE", help="a device file, such as plant.toml")
    command.add_argument(
        "--own-unit",
        type=int,
        metavar="N",
        help="which of several answers units 0 and 255 on TCP and UDP, too",
    )
    command.add_argument(
        "--metrics", type=_address, metavar="HOST:PORT", help="answer Prometheus here, over HTTP"
    )
    _add_limit_arguments(command)
    security.add_arguments(command)
    command.set_defaults(run=_serve)


def _add_limit_arguments(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("what clients may cost")
    for name, convert, metavar, text in LIMITS:
        group.add_argument(f"--{name}", type=convert, metavar=metavar, help=text)
    group.add_argument("--when-full", choices=FULL_POLICIES, help="(close-idle)")
    group.add_argument(
        "--allow", action="append", metavar="NETWORK", help="serve only these; may be repeated"
    )
    group.add_argument(
        "--unknown-unit",
        choices=UNKNOWN_UNIT_POLICIES,
        default="refuse",
        help="what a unit nobody is gets on TCP and UDP (refuse)",
    )


def _serve(options: argparse.Namespace) -> int:
    devices, faults = _devices(options.device)
    server = Server(
        devices,
        faults,
        _limits(options),
        options.unknown_unit,
        options.own_unit,
        security.told(options),
    )
    with _metrics(server, options.metrics):
        server.serve_forever(*options.urls, on_listening=partial(_say, options.allow))
    return 0


def _address(text: str) -> tuple[str, int]:
    with contextlib.suppress(ValueError):
        parts = urlsplit(f"//{text}")
        if parts.netloc == text and parts.hostname and parts.port is not None:
            return parts.hostname, parts.port
    raise argparse.ArgumentTypeError(f"must be HOST:PORT, such as 127.0.0.1:9400, not {text!r}")


@contextlib.contextmanager
def _metrics(server: Server, address: tuple[str, int] | None) -> Iterator[None]:
    """Expose them while the server runs, if there is an address for them."""
    if address is None:
        yield
        return
    try:
        from ..integrations import exposition, prometheus
    except ImportError as error:
        sys.exit(f"libmodbus-py: {error}")
    prometheus.collect(server)
    with contextlib.ExitStack() as stack:
        try:
            url = stack.enter_context(exposition.exposing(*address))
        except OSError as error:
            place = ":".join(map(str, address))
            raise ModbusConnectionError(
                f"cannot listen for metrics on {place}: {error.strerror}", errno=error.errno
            ) from error
        print(f"metrics on {url}", flush=True)
        yield


def _say(allowed: list[str] | None, running: Running) -> None:
    for url in running.urls:
        print(f"listening on {url}", flush=True)
    unguarded = [] if allowed else [url for url in running.urls if _is_open(parse(url))]
    if unguarded:
        print(
            f"libmodbus-py: anybody who reaches {', '.join(unguarded)} may read and write;"
            " --allow NETWORK, or certificates and tls://, say who may",
            file=sys.stderr,
            flush=True,
        )


def _is_open(endpoint: Endpoint) -> bool:
    """Whether other machines may reach it, and nothing asks who they are."""
    if endpoint.transport in ("serial", "tls"):
        return False
    try:
        return not ip_address(endpoint.host.partition("%")[0]).is_loopback
    except ValueError:
        return endpoint.host != "localhost"


def _devices(file: str | None) -> tuple[Any, Any]:
    if file is not None:
        return device_file.load(file)
    everything = Mapping(65536, 65536, 65536, 65536)
    files = {number: [0] * RECORDS_PER_FILE for number in range(1, 11)}
    return Device(everything, files=files), None


def _limits(options: argparse.Namespace) -> Limits:
    given = {name: value for name in LIMIT_NAMES if (value := getattr(options, name)) is not None}
    if given.get("idle_timeout") == math.inf:
        given["idle_timeout"] = None
    return Limits(**given)
