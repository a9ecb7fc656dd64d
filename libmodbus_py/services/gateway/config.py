"""
Gateway files: a gateway, described in TOML.

``examples/gateway.toml`` of the source tree has every key once, explained. In short::

    listen                      URLs
    own_units, queue, longest_wait, writes_first        as `Gateway`
    [limits]                    as `Limits`
    [[route]]                   as `Route`: url, units, device_units, cache, merge, read_only,
                                writable: tables, or parts {table, address, count, file}
    [roles.NAME]                who may read and write what, as `Allow`; "" without a role
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from typing import Any

from ...files.schema import Key, Keys, a_list, keys_of, tables
from ...files.texts import FileError, load_file, read_toml
from ...ports.endpoint import parse_to_listen
from ...protocol.mistakes import Path, WrongValue, inside, item
from ...server.limits import Limits
from ...tools.files.rights import parts_of_tables, roles
from .gateway import Gateway
from .routes import GatewayOptions, Route, check_line, check_routes


@dataclass(frozen=True)
class GatewayFile:
    """The contents of a gateway file: URLs to listen on, and the arguments of `Gateway`."""

    listen: tuple[str, ...]
    routes: list[Route]
    options: dict[str, Any] = field(default_factory=dict)


def load(path: str | PathLike[str], former_routes: Iterable[Route] = ()) -> GatewayFile:
    """
    Read a gateway file, or raise FileError. Serial ports of `former_routes` may be
    missing now, because they may come back.
    """
    return load_file(path, partial(parse, former_routes=former_routes), FileError)


def parse(text: str, former_routes: Iterable[Route] = ()) -> GatewayFile:
    """Read the text of a gateway file, or raise TypeError or ValueError."""
    settings = FILE.read((), read_toml(text))
    listen, routes = settings.pop("listen", ()), settings.pop("route", ())
    if not routes:
        raise WrongValue("route", "must hold at least one table: [[route]]")
    check_routes(routes, "route")
    there = {route.endpoint.url for route in former_routes}
    for at, route in enumerate(routes):
        if route.endpoint.url not in there:
            check_line(("route", at, "url"), route.endpoint, map(parse_to_listen, listen))
    GatewayOptions(**{name: settings[name] for name in OPTIONS if name in settings})
    if "roles" in settings:
        settings["authorize"] = settings.pop("roles")
    return GatewayFile(listen, routes, settings)


# --- the keys ----------------------------------------------------------------------------


def _listen(path: Path, value: object) -> tuple[str, ...]:
    urls = tuple(a_list(path, value))
    for at, url in enumerate(urls):
        with inside(*item(path, at)):
            parse_to_listen(url)
    return urls


def _routes(path: Path, value: object) -> list[Route]:
    return [ROUTE.read(item(path, at), route) for at, route in enumerate(tables(path, value))]


OPTIONS = keys_of(Gateway).only(*keys_of(GatewayOptions))
"""Options of `Gateway` that are passed to it unchanged."""

ROUTE = keys_of(Route, writable=parts_of_tables)

FILE = Keys(
    [
        Key("listen", _listen, "URLs of the endpoints where clients are served", ()),
        *OPTIONS.values(),
        Key("limits", keys_of(Limits).read, "limits for clients, as `Limits`"),
        Key("route", _routes, "a table for each line and its units: [[route]]"),
        Key("roles", roles, "the accesses that each role allows: [roles.NAME]"),
    ]
)
