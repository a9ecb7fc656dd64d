"""
The command gateway: forward requests until a signal; SIGHUP reads the gateway file again.
"""

from __future__ import annotations

import argparse
import contextlib
import inspect
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from ...client.asynchronous import IN_FLIGHT, MAX_PAUSE
from ...ports.schemes import CLIENT_OPTIONS, SECURITY_OPTIONS, SERIAL_OPTIONS
from ...services.gateway import config
from ...services.gateway.gateway import Gateway
from ...services.gateway.routes import Route, parse_route
from ...tools.files.texts import compared, reread
from .. import arguments, logs
from ..connecting import with_options
from ..foreign import place
from ..help import VerbatimHelp
from . import over_http
from .running import add_audit, add_limits, starting

if TYPE_CHECKING:
    from ...tools.page.table_source import Shown

__all__ = ["add_command"]

OPTIONS = ("own_units", "queue", "longest_wait", "writes_first")
"""Arguments of `Gateway` that a gateway file contains too."""

OF_DEVICES = tuple(name for name in CLIENT_OPTIONS if name not in ("unit", "native"))
"""Options of clients that the URLs of --to take."""

ROUTE = "[UNITS[:DEVICE_UNITS]=]URL"


EXAMPLES = """\
examples:
  libmodbus-py gateway tcp://0.0.0.0:502 --to rtu:///dev/ttyUSB0
  libmodbus-py gateway 127.0.0.1:1502 --to /dev/ttyUSB0 -b 9600 -p none -u 1-10
  libmodbus-py gateway 0.0.0.0:502 --to 1-10=192.0.2.10 --to 11:1=192.0.2.11
  libmodbus-py gateway --config gateway.toml --metrics 127.0.0.1:9400"""


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    command = commands.add_parser(
        "gateway",
        description="Forward requests of clients to devices on other lines, and the answers back.",
        epilog=f"{EXAMPLES}\n\n{arguments.SCHEMES_OF_URLS}\n"
        "     The URL of a route can set the options of its requests, as in\n"
        '     --to "1-10=tcp://192.0.2.10?timeout=0.5"; an option overrides all URLs.',
        formatter_class=VerbatimHelp,
    )
    command.add_argument(
        "urls",
        type=place,
        metavar="URL",
        nargs="*",
        help="where to listen, such as tcp://0.0.0.0:502",
    )
    command.add_argument(
        "--to",
        action="append",
        metavar=ROUTE,
        help="forward requests to these units, or to all, to this URL; may be repeated",
    )
    arguments.add_units(command, "units of each --to that names none, such as 1-10,17 (all)")
    command.add_argument("--config", metavar="FILE", help="read routes and options from a file")
    over_http.add_metrics(command)
    over_http.add_page(command, "lines, units and clients")
    arguments.add_verbose(command)
    logs.add_arguments(command)
    waiting = command.add_argument_group("waiting requests")
    added = [
        waiting.add_argument(
            "--own-units", metavar="UNITS", help="units with the statistics of the gateway itself"
        ),
        waiting.add_argument("--queue", type=int, metavar="N", help="waiting requests per client"),
        waiting.add_argument(
            "--longest-wait", type=float, metavar="S", help="seconds that a request may wait"
        ),
    ]
    waiting.add_argument(
        "--writes-first",
        action="store_true",
        default=None,
        help="let writes overtake waiting reads",
    )
    usual = inspect.signature(Gateway).parameters
    own_units = ",".join(map(str, usual["own_units"].default))
    defaults = {name: usual[name].default for name in OPTIONS} | {"own_units": own_units}
    arguments.add_defaults(added, lambda: defaults)
    arguments.add_client_options(
        command.add_argument_group("requests to the devices"),
        without=("unit", "native"),
        defaults=lambda: {"max_in_flight": str(IN_FLIGHT), "max_pause": f"{MAX_PAUSE:g}"},
    )
    add_limits(command)
    add_audit(command)
    arguments.add_serial_options(command)
    arguments.add_security_options(command)
    command.set_defaults(run=_gateway)


def _gateway(options: argparse.Namespace) -> int:
    if (options.config is None) == (options.to is None):
        raise ValueError("either --to or --config must say where the devices are")
    with starting(options) as command:
        file = None if options.config is None else config.load(options.config)
        urls = options.urls or list(file.listen if file else ())
        if file is not None and not urls:
            raise ValueError(f"{options.config}: listen is missing, and no URL is given")
        if file is not None and (typed := arguments.given(options, ("units", *OF_DEVICES))):
            name = arguments.flag(next(iter(typed)))
            raise ValueError(f"{name} needs --to: {options.config} has its own routes")
        routes = [parse_route(text, options.units) for text in options.to or ()]
        urls, routes = _overridden(urls, routes, options)
        usual = file.options if file else {}
        gateway = Gateway(
            file.routes if file else routes,
            **{**usual, **arguments.given(options, OPTIONS), **command.hooks},
        )
        if file is not None:
            command.files.insert(0, partial(_read_again, gateway, str(options.config), file))

        def make_shown() -> Shown:
            from ...services.gateway.shown_gateway import ShownGateway

            made = ShownGateway(options.config or ", ".join(options.urls), gateway)
            tracing.enter_context(gateway.tracing(made.note))
            return made

        with contextlib.ExitStack() as tracing:
            command.serve(gateway, urls, make_shown)
    return 0


def _overridden(
    urls: list[str], routes: list[Route], options: argparse.Namespace
) -> tuple[list[str], list[Route]]:
    """Return where to listen and the routes, with the options that were typed."""
    places = [*urls, *(route.to for route in routes)]
    places = [each.url for each in with_options(places, options, SERIAL_OPTIONS)]
    listen = with_options(places[: len(urls)], options, SECURITY_OPTIONS)
    devices = with_options(places[len(urls) :], options, OF_DEVICES)
    return [each.url for each in listen], [
        replace(route, to=each.url) for route, each in zip(routes, devices, strict=True)
    ]


def _read_again(gateway: Gateway, path: str, before: config.GatewayFile) -> str:
    def use(file: config.GatewayFile) -> str:
        earlier, now = ({each.units: each for each in of} for of in (gateway.routes, file.routes))
        gateway.change_routes(file.routes)
        line = compared(path, "route", earlier, now)
        if (file.listen, repr(file.options)) != (before.listen, repr(before.options)):
            line += "; changes that are not routes need a restart of the gateway"
        return line

    return reread(lambda: config.load(path, known=before.routes), use)
