"""
The command gateway: requests passed on, until a signal; SIGHUP reads the file again.
"""

from __future__ import annotations

import argparse
import logging
from typing import Any

from ...ports.schemes import SCHEMES
from ...services.gateway import config
from ...services.gateway.gateway import Gateway
from ...services.gateway.routes import parse_route
from ...tools.files.rereading import reread
from .. import security
from ..help import VerbatimHelp
from ..output import counted
from . import limits, metrics
from .announcing import announcing
from .hangup import unless_closed

__all__ = ["add_command"]

logger: logging.Logger = logging.getLogger(__name__)

# What a file says, too.
OPTIONS = ("own_units", "queue", "longest_wait", "writes_first")

ROUTE = "[UNITS[:DEVICE_UNITS]=]URL"


EXAMPLES = """\
examples:
  libmodbus-py gateway tcp://0.0.0.0:502 --to rtu:///dev/ttyUSB0
  libmodbus-py gateway tcp://127.0.0.1:1502 --to "1-10=rtu:///dev/ttyUSB0?baudrate=9600&parity=N"
  libmodbus-py gateway tcp://0.0.0.0:502 --to 1-10=tcp://192.0.2.10 --to 11:1=tcp://192.0.2.11
  libmodbus-py gateway --config gateway.toml --metrics 127.0.0.1:9400"""


def add_command(commands: Any) -> None:
    """Tell argparse of it."""
    command = commands.add_parser(
        "gateway",
        epilog=f"{EXAMPLES}\n\nURLs: {' '.join(f'{scheme}://...' for scheme in SCHEMES)};\n"
        "those of --to take options of clients, such as ?timeout=0.5",
        formatter_class=VerbatimHelp,
    )
    command.add_argument("urls", metavar="URL", nargs="*", help="such as tcp://0.0.0.0:502")
    command.add_argument(
        "--to",
        action="append",
        metavar=ROUTE,
        help="where the devices are, such as 1-10=rtu:///dev/ttyUSB0; may be repeated",
    )
    command.add_argument("--config", metavar="FILE", help="a gateway file, such as gateway.toml")
    group = command.add_argument_group("how requests are dealt with")
    group.add_argument("--own-units", metavar="UNITS", help="those of the gateway itself (255)")
    group.add_argument("--queue", type=int, metavar="N", help="of one client that wait (16)")
    group.add_argument("--longest-wait", type=float, metavar="S", help="for a turn (5)")
    group.add_argument("--writes-first", action="store_true", default=None, help="they overtake")
    metrics.add_argument(command)
    limits.add_arguments(command)
    security.add_arguments(command)
    command.set_defaults(run=_gateway)


def _gateway(options: argparse.Namespace) -> int:
    if (options.config is None) == (options.to is None):
        raise ValueError("either --to or --config must say where the devices are")
    given = {name: value for name in OPTIONS if (value := getattr(options, name)) is not None}
    if bounds := limits.told(options):
        given["limits"] = bounds
    given["security"] = security.told(options)
    if options.config is None:
        gateway = Gateway([parse_route(text) for text in options.to], **given)
        with metrics.exposed(gateway, options.metrics):
            gateway.serve_forever(*options.urls, on_listening=announcing(options.allow))
        return 0
    file = config.load(options.config)
    urls = options.urls or file.listen
    if not urls:
        raise ValueError(f"{options.config}: listen is missing, and no URL is given")
    gateway = Gateway(file.routes, **{**file.options, **given})
    with metrics.exposed(gateway, options.metrics):
        gateway.serve_forever(
            *urls,
            on_listening=announcing(options.allow),
            on_hangup=unless_closed(lambda: _read_again(gateway, options.config, file)),
        )
    return 0


def _read_again(gateway: Gateway, path: str, before: config.GatewayFile) -> None:
    def use(file: config.GatewayFile) -> list[str]:
        gateway.change_routes(file.routes)
        lines = [f"{path}: {counted(len(file.routes), 'route')}"]
        if (file.listen, repr(file.options)) != (before.listen, repr(before.options)):
            lines.append(
                f"{path}: only routes can change while the gateway runs; restart it"
                " for the other changes"
            )
        return lines

    reread(lambda: config.load(path, known=before.routes), use, logger.warning)
