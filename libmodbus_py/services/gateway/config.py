"""
Gateway files: a gateway, described in TOML.

``examples/gateway.toml`` of the source tree has every key once, explained. In short::

    listen                      URLs
    own_units, queue, longest_wait, writes_first        as `Gateway`
    [limits]                    as `Limits`
    [[route]]                   as `Route`: to, units, device_units, cache, merge, read_only,
                                writable: tables, or parts {table, address, count, file}
    [roles.NAME]                who may read and write what, as `Allow`; "" without a role
"""

from __future__ import annotations

import contextlib
import re
import reprlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from os import PathLike
from typing import Any

from ...ports.endpoint import parse as parse_url
from ...server.limits import Limits
from ...tools.files import roles
from ...tools.files.tables import checked_table
from ...tools.files.texts import load_file
from ...tools.files.toml_text import read_toml
from .circles import check_line
from .manner import Manner
from .routes import Route, by_unit

__all__ = ["GatewayFile", "GatewayFileError", "load", "parse"]

# 256 units can have no more.
MOST_ROUTES = 256

OPTIONS = tuple(each.name for each in fields(Manner) if each.init)
"""What `Gateway` takes as it is."""

KEYS = ("listen", *OPTIONS, "limits", "route", "roles")

ROUTE = tuple(each.name for each in fields(Route) if each.init)

LIMITS = tuple(each.name for each in fields(Limits) if each.init)


class GatewayFileError(ValueError):
    """A gateway file that cannot be: which file, line and key, and what is allowed."""


@dataclass(frozen=True)
class GatewayFile:
    """
    What a gateway file describes.

    Attributes:
        listen: URLs, for `Gateway.serving`.
        routes: for `Gateway` and `Gateway.change_routes`.
        options: of `Gateway`, by name.
    """

    listen: tuple[str, ...]
    routes: list[Route]
    options: dict[str, Any] = field(default_factory=dict)


def load(path: str | PathLike[str], known: Iterable[Route] = ()) -> GatewayFile:
    """
    Read a gateway file.

    Args:
        known: routes whose ports may be gone now: they were there, and may come back.

    Raises:
        GatewayFileError: it cannot be read, is no TOML, or says what cannot be.
    """
    return load_file(path, partial(parse, known=known), GatewayFileError)


def parse(text: str, known: Iterable[Route] = ()) -> GatewayFile:
    """
    Read the text of a gateway file.

    Args:
        known: as for `load`.

    Raises:
        GatewayFileError: it is no TOML, or says what cannot be; it begins with the key.
    """
    with _inside():
        given = checked_table("", read_toml(text), KEYS)
        listen = tuple(_listen(given.get("listen", [])))
        routes = [_route(f"route[{at}]", each) for at, each in enumerate(_routes(given))]
        with _renamed("routes", "route"):
            by_unit(routes)
        there = {route.endpoint.url for route in known}
        for at, route in enumerate(routes):
            if route.endpoint.url in there:
                continue
            check_line(f"route[{at}].to", route.endpoint, map(parse_url, listen))
        options = {name: given[name] for name in OPTIONS if name in given}
        Manner(**options)
        if "limits" in given:
            options["limits"] = _limits(given["limits"])
        if "roles" in given:
            options["authorize"] = roles.rules("roles", given["roles"])
        return GatewayFile(listen, routes, options)


@contextlib.contextmanager
def _inside() -> Iterator[None]:
    try:
        yield
    except (TypeError, ValueError) as error:
        raise GatewayFileError(str(error)) from None


@contextlib.contextmanager
def _renamed(name: str, key: str) -> Iterator[None]:
    """As the file calls it."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise type(error)(re.sub(rf"\b{name}\b", key, str(error))) from None


def _listen(given: object) -> Iterator[str]:
    if not isinstance(given, list):
        raise TypeError(f"listen must be a list of URLs, not {reprlib.repr(given)}")
    for at, url in enumerate(given):
        try:
            endpoint = parse_url(url)
        except (TypeError, ValueError) as error:
            raise type(error)(f"listen[{at}]: {error}") from None
        if endpoint.client_options:
            names = ", ".join(endpoint.client_options)
            raise ValueError(f"listen[{at}]: {url!r}: {names} is for clients")
        yield url


def _routes(given: Mapping[str, Any]) -> list[Any]:
    routes = given.get("route")
    if not isinstance(routes, list) or not routes:
        raise ValueError("route must hold at least one table: [[route]]")
    if len(routes) > MOST_ROUTES:
        raise ValueError(f"route must hold at most {MOST_ROUTES} tables, not {len(routes)}")
    return routes


def _route(where: str, given: object) -> Route:
    options = dict(checked_table(where, given, ROUTE))
    if "to" not in options:
        raise ValueError(f"{where}.to is missing")
    writable = options.get("writable")
    if isinstance(writable, list):
        options["writable"] = [
            roles.part(f"{where}.writable[{at}]", each) for at, each in enumerate(writable)
        ]
    try:
        return Route(**options)
    except (TypeError, ValueError) as error:
        message = str(error)
        key = next((name for name in ROUTE if re.match(rf"{name}\b", message)), None)
        raise type(error)(f"{where}.{message}" if key else f"{where}.to: {message}") from None


def _limits(given: object) -> Limits:
    try:
        return Limits(**checked_table("limits", given, LIMITS))
    except (TypeError, ValueError) as error:
        message = str(error)
        raise type(error)(
            message if message.startswith("limits") else f"limits.{message}"
        ) from None
