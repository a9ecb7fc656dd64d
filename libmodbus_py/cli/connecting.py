"""
Endpoints and clients, made of URLs and of the options that override them.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ..ports.schemes import CLIENT_OPTIONS, SECURITY_OPTIONS, SERIAL_OPTIONS, TRANSPORTS, options_of
from .arguments import REPEATED, flag, given

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from ..client.blocking import Context
    from ..ports.endpoint import Endpoint

__all__ = ["OF_CLIENTS", "OF_SERVERS", "connected", "endpoint_of", "with_options"]

OF_SERVERS = (*SERIAL_OPTIONS, *SECURITY_OPTIONS)
"""The options of URLs that mean something to a server."""

OF_CLIENTS = (*CLIENT_OPTIONS, *OF_SERVERS)
"""The options of URLs that mean something to a client."""


def endpoint_of(options: argparse.Namespace) -> Endpoint:
    """Return where to connect: the URL, with the options that were typed."""
    return with_options([options.url], options)[0]


def connected(options: argparse.Namespace) -> Context:
    """Make the client; it connects when it is used."""
    from ..client.blocking import Context

    endpoint = endpoint_of(options)
    hooks: dict[str, Any] = {}
    if options.verbose:
        from .tracing import Tracing

        hooks["trace"] = Tracing()
    return Context.from_url(endpoint.url, **hooks)


def with_options(
    urls: Iterable[str], options: argparse.Namespace, names: Collection[str] = OF_CLIENTS
) -> list[Endpoint]:
    """Return the endpoints of URLs, each with those of the named options that apply to it."""
    from dataclasses import replace

    from ..ports.endpoint import parse

    endpoints = [parse(url) for url in urls]
    typed = given(options, names)
    for name in REPEATED:
        if name in typed:
            typed[name] = ",".join(typed[name])
    useful = {name for each in endpoints for name in options_of(each.scheme)}
    for transport, rules in TRANSPORTS.items():
        useless = [name for name in typed if name in rules.options and name not in useful]
        if useless:
            wanted = "serial ports" if rules.is_serial else f"{transport}:// URLs"
            places = ", ".join(map(str, endpoints))
            raise ValueError(f"{flag(useless[0])} applies to {wanted} only, not to {places}")
    client = {name: value for name, value in typed.items() if name in CLIENT_OPTIONS}
    found = []
    for each in endpoints:
        own = {name: typed[name] for name in options_of(each.scheme) if name in typed}
        settings, of_client = {**each.options, **own}, {**each.client_options, **client}
        found.append(replace(each, options=settings, client_options=of_client))
    return found
