"""
The command serve: a device file, or one device that has everything, until a signal.

SIGHUP reads the file again, and with --reload every change of it does.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable
from typing import Any

from ...device.device import Device
from ...device.mapping import Mapping
from ...ports.schemes import SCHEMES
from ...protocol.pdu import RECORDS_PER_FILE
from ...server.server import Running, Server
from ...server.units import UNKNOWN_UNIT_POLICIES
from ...tools.simulator import device_file, example_files
from ...tools.simulator.reloading import Reloader
from .. import security
from . import limits, metrics, page
from .announcing import announcing
from .hangup import unless_closed

__all__ = ["add_command"]

EXAMPLE_URL = "tcp://127.0.0.1:1502"


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "serve",
        epilog=f"URLs: {' '.join(f'{scheme}://...' for scheme in SCHEMES)}",
    )
    command.add_argument(
        "urls",
        metavar="URL",
        nargs="*",
        help=f"such as {EXAMPLE_URL}, which is where examples are served unless it is said",
    )
    source = command.add_mutually_exclusive_group()
    source.add_argument("--device", metavar="FILE", help="a device file, such as plant.toml")
    source.add_argument(
        "--example",
        metavar="NAME",
        nargs="?",
        const="",
        help="a device file that comes with the package; without a name they are listed",
    )
    command.add_argument(
        "--reload",
        action="store_true",
        help="read the device file again when it or a register map of it changes, as SIGHUP does;"
        " connections stay, and a mistake changes nothing",
    )
    command.add_argument(
        "--own-unit",
        type=int,
        metavar="N",
        help="which of several answers units 0 and 255 on TCP and UDP, too",
    )
    metrics.add_argument(command)
    page.add_argument(command)
    limits.add_arguments(command).add_argument(
        "--unknown-unit",
        choices=UNKNOWN_UNIT_POLICIES,
        default="refuse",
        help="what a unit nobody is gets on TCP and UDP (refuse)",
    )
    security.add_arguments(command)
    command.set_defaults(run=_serve)


def _serve(options: argparse.Namespace) -> int:
    if options.example == "":
        return _list_examples()
    path = options.device if options.example is None else example_files.path_of(options.example)
    urls = options.urls or ([EXAMPLE_URL] if options.example is not None else [])
    if not urls:
        raise ValueError("the following arguments are required: URL")
    if options.reload and path is None:
        raise ValueError("--reload means nothing without --device or --example")
    simulation = None if path is None else device_file.load(path)
    devices, faults = simulation or (_everything(), None)
    server = Server(
        devices,
        faults,
        limits.told(options),
        options.unknown_unit,
        options.own_unit,
        security.told(options),
    )
    announce = announcing(options.allow)
    with (
        metrics.exposed(server, options.metrics),
        page.shown(server, options.page, announce) as announce_all,
    ):
        if simulation is None or path is None:
            server.serve_forever(*urls, on_listening=announce_all)
        else:
            reloader = Reloader(server, path, simulation, is_watching=options.reload, tell=_tell)
            _serve_and_reload(server, urls, announce_all, reloader)
    return 0


def _serve_and_reload(
    server: Server, urls: list[str], announce: Callable[[Running], object], reloader: Reloader
) -> None:
    def begin(running: Running) -> None:
        reloader.start()
        announce(running)

    try:
        server.serve_forever(*urls, on_listening=begin, on_hangup=unless_closed(reloader.ask))
    finally:
        reloader.close()


def _tell(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # nobody listens, and it goes on serving
        print(f"libmodbus-py: {line}", file=sys.stderr, flush=True)


def _list_examples() -> int:
    found = example_files.described()
    width = max(map(len, found))
    for name, description in found.items():
        print(f"{name:{width}}  {description}")
    return 0


def _everything() -> Device:
    everything = Mapping(65536, 65536, 65536, 65536)
    files = {number: [0] * RECORDS_PER_FILE for number in range(1, 11)}
    return Device(everything, files=files)
