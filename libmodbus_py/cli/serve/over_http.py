"""Metrics for Prometheus and a live page, which commands serve over HTTP beside Modbus."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, TextIO

from ..arguments import refuse_options
from ..output import complain, inform
from ..parser import Group, Parser, declare

if TYPE_CHECKING:
    from ...server.server import Server
    from ...tools.page.page import Page
    from ...tools.page.table_source import ShownTable

Address = tuple[str, int]

TOKEN = "LIBMODBUS_PY_PAGE_TOKEN"
"""The environment variable that has the token of the page."""


def add_metrics(command: Parser) -> None:
    text = "serve metrics for Prometheus at this address, over HTTP"
    declare(command, f"--metrics HOST:PORT\n  {text}", metrics={"type": _address})


OF_PAGE = f"""
--page [HOST:PORT]
    serve a live page of %s at this address, over HTTP (127.0.0.1:8080)
rare --page-url URL
    the URL under which browsers reach the page through a proxy or a tunnel, such as
    https://plant.example/modbus
rare --page-token FILE
    file with the token of the page, 22 or more letters, digits, - or _, so that its URL stays the
    same; by default, {TOKEN} in the environment, or a new one
"""


def add_page(command: Parser | Group, what: str = "the devices") -> None:
    declare(command, OF_PAGE % what, page={"type": _address, "const": ("127.0.0.1", 8080)})


def _address(text: str) -> Address:
    from ...ports.hosts import split_host_and_port

    with contextlib.suppress(ValueError):
        host, port = split_host_and_port(text)
        if port is not None:
            return host, port
    raise argparse.ArgumentTypeError(f"must be HOST:PORT, such as 127.0.0.1:8080, not {text!r}")


@contextlib.contextmanager
def exposed(
    server: Any, address: Address | None, *others: Any, to: TextIO | None = None
) -> Iterator[None]:
    """Serve metrics of a server and of others while the block runs, if there is an address."""
    if address is None:
        yield
        return
    from ...server.service import explained
    from ...services.integrations import prometheus

    prometheus.collect(server, *others)
    with contextlib.ExitStack() as stack:
        with explained("cannot listen for metrics on {}:{}".format(*address)):
            url = stack.enter_context(prometheus.exposing(*address))
        inform(f"metrics on {url}", to)
        yield


@contextlib.contextmanager
def shown(
    make: Callable[[], Server | ShownTable], options: argparse.Namespace, to: TextIO | None = None
) -> Iterator[Callable[[], None]]:
    """
    Show what `make` returns on a live page while the block runs, if there is an address.

    Yields a function that prints the URL of the page; with its token only if that is new, and the
    stream a terminal.
    """
    address: Address | None = options.page
    if address is None:
        refuse_options(options, ("page_token", "page_url"), "needs --page")
        yield lambda: None
        return
    from ...ports.hosts import is_loopback
    from ...server.server import Server
    from ...server.service import explained
    from ...tools.page.page import live_page, table_page
    from ...tools.page.table_source import TableSource

    stream = to or sys.stdout
    token = _token_of(options.page_token)
    if token is None and not stream.isatty():
        raise ValueError(
            f"--page-token FILE, or {TOKEN} in the environment, must give the token of the"
            " page: a new one is printed on a terminal only"
        )
    what = make()
    page_of: Callable[..., contextlib.AbstractContextManager[Page]]
    if isinstance(what, Server):
        page_of, can = partial(live_page, what), "change all devices"
    else:
        page_of, can = partial(table_page, TableSource(what)), "see all values"
    with contextlib.ExitStack() as stack:
        with explained("cannot show a page on {}:{}".format(*address)):
            page = stack.enter_context(page_of(*address, token, options.page_url))

        def print_url() -> None:
            inform(f"page on {page.url if token is None else page.url.replace(token, '...')}", to)
            if not is_loopback(address[0]):
                complain(
                    f"anyone with the URL of the page can {can}, and the connection is not"
                    " encrypted",
                    "warning",
                )

        yield print_url


@contextlib.contextmanager
def tables_shown(make: Callable[[], ShownTable], options: argparse.Namespace) -> Iterator[None]:
    """Show tables on a live page while the block runs, and print its URL to stderr at once."""
    with shown(make, options, sys.stderr) as print_url:
        print_url()
        yield


def _token_of(file: str | None) -> str | None:
    """Return the token of the page from a file or the environment; None without either."""
    if file is None:
        return os.environ.get(TOKEN) or None
    from ...security.security import read_secret

    try:
        return read_secret(file).strip()
    except OSError as error:
        raise ValueError(f"--page-token: {file}: {error.strerror}") from None
    except UnicodeDecodeError:
        return "-"  # which is refused, as other wrong tokens are
