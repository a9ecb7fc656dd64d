"""
The command serve: a device file, or one device that has everything, until a signal.
"""

from __future__ import annotations

import argparse
from typing import Any

from ..device.device import Device
from ..device.mapping import Mapping
from ..ports.endpoint import SCHEMES
from ..protocol.pdu import RECORDS_PER_FILE
from ..server.server import Server
from ..server.units import UNKNOWN_UNIT_POLICIES
from ..simulator import device_file
from . import limits, metrics, security
from .announcing import announcing

__all__ = ["add_command"]


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
    metrics.add_argument(command)
    limits.add_arguments(command).add_argument(
        "--unknown-unit",
        choices=UNKNOWN_UNIT_POLICIES,
        default="refuse",
        help="what a unit nobody is gets on TCP and UDP (refuse)",
    )
    security.add_arguments(command)
    command.set_defaults(run=_serve)


def _serve(options: argparse.Namespace) -> int:
    devices, faults = _devices(options.device)
    server = Server(
        devices,
        faults,
        limits.told(options),
        options.unknown_unit,
        options.own_unit,
        security.told(options),
    )
    with metrics.exposed(server, options.metrics):
        server.serve_forever(*options.urls, on_listening=announcing(options.allow))
    return 0


def _devices(file: str | None) -> tuple[Any, Any]:
    if file is not None:
        return device_file.load(file)
    everything = Mapping(65536, 65536, 65536, 65536)
    files = {number: [0] * RECORDS_PER_FILE for number in range(1, 11)}
    return Device(everything, files=files), None
