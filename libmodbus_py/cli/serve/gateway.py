"""The command gateway: forward requests until a signal; SIGHUP reads the gateway file again."""

from __future__ import annotations

import argparse
import contextlib
import inspect
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from ...client.asynchronous import MAX_PAUSE
from ...files.texts import compared, reread
from ...ports.options import CLIENT_OPTIONS, SERIAL_OPTIONS
from ...ports.schemes import SECURITY_OPTIONS
from ...protocol.mistakes import Problem
from ...services.gateway import config
from ...services.gateway.gateway import Gateway
from ...services.gateway.routes import Route, parse_route
from .. import arguments, logs
from ..arguments import with_options
from ..parser import Parser, declare
from . import over_http
from .running import add_audit, add_limits, starting

if TYPE_CHECKING:
    from ...tools.page.table_source import ShownTable

OPTIONS = ("own_units", "queue", "longest_wait", "writes_first")
"""Arguments of `Gateway` that a gateway file contains too."""

OF_DEVICES = tuple(name for name in CLIENT_OPTIONS if name != "unit")
"""Options of clients that the URLs of --to take."""

ROUTE = "[UNITS[:DEVICE_UNITS]=]URL"

EPILOG = f"""\
examples:
  libmodbus-py gateway tcp://0.0.0.0:502 --to rtu:///dev/ttyUSB0
  libmodbus-py gateway 127.0.0.1:1502 --to /dev/ttyUSB0 -b 9600 -p none -u 1-10
  libmodbus-py gateway 0.0.0.0:502 --to 1-10=192.0.2.10 --to 11:1=192.0.2.11
  libmodbus-py gateway --config gateway.toml --metrics 127.0.0.1:9400

{arguments.SCHEMES_OF_URLS}
     The URL of a route can set the options of its requests, as in
     --to "1-10=tcp://192.0.2.10?timeout=0.5"; an option overrides all URLs."""

ARGUMENTS = f"""
[URL ...]
    where to listen, such as tcp://0.0.0.0:502
--to {ROUTE} ...
    forward requests to these units, or to all, to this URL; may be repeated
"""

OF_WAITING = """
--own-units UNITS
    units with the statistics of the gateway itself
--queue N
    waiting requests per client
--longest-wait S
    seconds that a request may wait
--writes-first
    let writes overtake waiting reads
"""


def add_command(command: Parser) -> None:
    command.description = (
        "Forward requests of clients to devices on other lines, and the answers back."
    )
    command.epilog = EPILOG
    declare(command, ARGUMENTS, url={"dest": "urls"})
    arguments.add_units(command, "units of each --to that names none, such as 1-10,17 (all)")
    declare(command, "--config FILE\n  read routes and options from a file")
    over_http.add_metrics(command)
    over_http.add_page(command, "lines, units and clients")
    arguments.add_verbose(command)
    logs.add_arguments(command)
    usual = inspect.signature(Gateway).parameters
    own_units = ",".join(map(str, usual["own_units"].default))
    defaults = {name: usual[name].default for name in OPTIONS} | {"own_units": own_units}
    group = command.group("waiting requests")
    declare(group, OF_WAITING, lambda: defaults, writes_first={"default": None})
    arguments.add_client_options(
        command.group("requests to the devices"),
        without=("unit",),
        usual=lambda: {"max_pause": f"{MAX_PAUSE:g}"},
    )
    add_limits(command)
    add_audit(command)
    arguments.add_serial_options(command)
    arguments.add_security_options(command)
    command.set_defaults(run=_gateway)


def _gateway(options: argparse.Namespace) -> int:
    if (options.config is None) == (options.to is None):
        files = [url for url in options.urls if url.endswith(".toml")]
        hint = f": type --config {files[0]}" if files else ""
        raise ValueError(f"either --to or --config must say where the devices are{hint}")
    with starting(options) as command:
        file = None if options.config is None else config.load(options.config)
        urls = options.urls or list(file.listen if file else ())
        if file is not None and not urls:
            raise ValueError(f"{options.config}: listen is missing, and no URL is given")
        if file is not None:
            why = f"needs --to: {options.config} has its own routes"
            arguments.refuse_options(options, ("units", *OF_DEVICES), why)
        routes = [parse_route(text, options.units) for text in options.to or ()]
        urls, routes = _overridden(urls, routes, options)
        usual = file.options if file else {}
        gateway = Gateway(
            file.routes if file else routes,
            **{**usual, **arguments.typed_options(options, OPTIONS), **command.hooks},
        )
        if file is not None:
            command.files.insert(0, partial(_read_again, gateway, str(options.config), file))

        def make_shown() -> ShownTable:
            from ...services.gateway.shown_gateway import ShownGateway

            page = ShownGateway(options.config or ", ".join(options.urls), gateway)
            tracing.enter_context(gateway.tracing(page.note))
            return page

        with contextlib.ExitStack() as tracing:
            command.serve(gateway, urls, make_shown)
    return 0


def _overridden(
    urls: list[str], routes: list[Route], options: argparse.Namespace
) -> tuple[list[str], list[Route]]:
    """Return where to listen and the routes, with the options that were typed."""
    places = [*urls, *(route.url for route in routes)]
    places = [with_option.url for with_option in with_options(places, options, SERIAL_OPTIONS)]
    listen = with_options(places[: len(urls)], options, SECURITY_OPTIONS)
    devices = with_options(places[len(urls) :], options, OF_DEVICES)
    return [endpoint.url for endpoint in listen], [
        replace(route, url=device.url) for route, device in zip(routes, devices, strict=True)
    ]


def _read_again(gateway: Gateway, path: str, before: config.GatewayFile) -> str:
    def use(file: config.GatewayFile) -> str:
        earlier, now = ({row.units: row for row in rows} for rows in (gateway.routes, file.routes))
        gateway.change_routes(file.routes)
        line = compared(path, "route", earlier, now)
        if (file.listen, repr(file.options)) != (before.listen, repr(before.options)):
            line = Problem(f"{line}; changes that are not routes need a restart of the gateway")
        return line

    return reread(lambda: config.load(path, before.routes), use)
