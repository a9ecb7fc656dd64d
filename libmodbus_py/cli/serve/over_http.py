"""
Metrics for Prometheus and a live page, which commands serve over HTTP beside Modbus.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, TextIO, TypeGuard

from ...protocol.errors import ModbusConnectionError
from ..help import make_rare
from ..output import complain, inform

if TYPE_CHECKING:
    from ...server.serving import Running
    from ...tools.faults.server import Server
    from ...tools.page.page import Page
    from ...tools.page.table_source import Shown

__all__ = ["add_metrics", "add_page", "exposed", "shown", "tables_shown"]

Address = tuple[str, int]


def add_metrics(command: argparse.ArgumentParser) -> None:
    """Add the option for metrics to argparse."""
    command.add_argument(
        "--metrics",
        action=OneAddress,
        type=address_like("127.0.0.1:9400"),
        metavar="HOST:PORT",
        help="serve metrics for Prometheus at this address, over HTTP",
    )


@contextlib.contextmanager
def exposed(
    server: Any, address: Address | None, *others: Any, to: TextIO | None = None
) -> Iterator[None]:
    """
    Serve the metrics of a server while the block runs, if there is an address.

    Args:
        others: further objects with statistics.
        to: the stream on which the URL is printed; None for the standard output.

    Raises:
        ImportError: prometheus_client is not installed.
        ModbusConnectionError: the address is not available, with errno.
    """
    if address is None:
        yield
        return
    from ...services.integrations import prometheus

    prometheus.collect(server, *others)
    with contextlib.ExitStack() as stack:
        try:
            url = stack.enter_context(prometheus.exposing(*address))
        except OSError as error:
            place = ":".join(map(str, address))
            raise ModbusConnectionError(
                f"cannot listen for metrics on {place}: {error.strerror}", errno=error.errno
            ) from error
        inform(f"metrics on {url}", to)
        yield


def address_like(example: str) -> Callable[[str], Address]:
    """Return a function that reads an address; its error shows the example."""

    def read(text: str) -> Address:
        from ...ports.hosts import split_host_and_port

        with contextlib.suppress(ValueError):
            host, port = split_host_and_port(text)
            if port is not None:
                return host, port
        raise argparse.ArgumentTypeError(f"must be HOST:PORT, such as {example}, not {text!r}")

    return read


class OneAddress(argparse.Action):
    """Sets an address, and refuses a second one; argparse alone would forget the first."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        if getattr(namespace, self.dest) is not None:
            raise argparse.ArgumentError(self, "may be given once: there is one address for all")
        setattr(namespace, self.dest, values)


EXAMPLE = ("127.0.0.1", 8080)

TOKEN = "LIBMODBUS_PY_PAGE_TOKEN"
"""The environment variable that has the token of the page."""


def add_page(command: argparse._ActionsContainer, what: str = "the devices") -> None:
    """
    Add the options for a page to argparse.

    Args:
        what: what the page shows.
    """
    command.add_argument(
        "--page",
        action=OneAddress,
        type=address_like("{}:{}".format(*EXAMPLE)),
        nargs="?",
        const=EXAMPLE,
        metavar="HOST:PORT",
        help="serve a live page of {} at this address, over HTTP ({}:{})".format(what, *EXAMPLE),
    )
    token = command.add_argument(
        "--page-token",
        metavar="FILE",
        help="file with the token of the page, 22 or more letters, digits, - or _, so that its URL"
        f" stays the same; unless given, {TOKEN} in the environment, or a new one",
    )
    make_rare(token)


def token_of(file: str | None) -> str | None:
    """
    Return the token of the page from a file or the environment; None without either.

    Raises:
        ValueError: the file cannot be read, or all users of the machine can read it.
    """
    if file is None:
        return os.environ.get(TOKEN) or None
    from ...security.renewed import read_secret

    try:
        return read_secret(file).strip()
    except OSError as error:
        raise ValueError(f"--page-token: {file}: {error.strerror}") from None
    except UnicodeDecodeError:
        return ""  # refused as a token


@contextlib.contextmanager
def shown(
    server: Server,
    address: Address | None,
    announce: Callable[[Running], object],
    token_file: str | None = None,
) -> Iterator[Callable[[Running], object]]:
    """
    Show a server on a live page while the block runs, if there is an address.

    Args:
        announce: prints where the server listens.
        token_file: the file with the token of the page; None for the environment or a new one.

    Yields:
        A function that prints where the server listens, and the URL of the page.

    Raises:
        ModbusConnectionError: the address is not available, with errno.
        ValueError: the token is wrong, there is one but no page, or there is none and a new one
            could be read in a log.
    """
    if not _is_wanted(address, token_file):
        yield announce
        return
    from ...tools.page.page import live_page

    can = "can change all devices"
    with _opened(partial(live_page, server), address, token_file, sys.stdout, can) as tell:

        def announce_all(running: Running) -> None:
            announce(running)
            tell()

        yield announce_all


@contextlib.contextmanager
def tables_shown(
    make: Callable[[], Shown], address: Address | None, token_file: str | None, to: TextIO
) -> Iterator[None]:
    """
    Show tables on a live page while the block runs, if there is an address.

    Args:
        make: returns what is shown; called only if there is an address.
        token_file: as for `shown`.
        to: the stream on which the URL of the page is printed.

    Raises:
        ModbusConnectionError, ValueError: as for `shown`.
    """
    if not _is_wanted(address, token_file):
        yield
        return
    from ...tools.page.page import table_page
    from ...tools.page.table_source import TableSource

    open_page, can = partial(table_page, TableSource(make())), "can see all values"
    with _opened(open_page, address, token_file, to, can) as tell:
        tell()
        yield


def _is_wanted(address: Address | None, token_file: str | None) -> TypeGuard[Address]:
    if address is None and token_file is not None:
        raise ValueError("--page-token needs --page")
    return address is not None


@contextlib.contextmanager
def _opened(
    open_page: Callable[..., contextlib.AbstractContextManager[Page]],
    address: Address,
    token_file: str | None,
    to: TextIO,
    can: str,
) -> Iterator[Callable[[], None]]:
    """
    Open a page while the block runs; yield a function that prints its URL.

    Args:
        to: the stream on which the URL is printed; with the token only if the token is new, and
            the stream is a terminal.
        can: what anyone with the URL can do.
    """
    from ...ports.hosts import is_loopback

    with contextlib.ExitStack() as stack:
        token = token_of(token_file)
        if token is None and not to.isatty():
            raise ValueError(
                f"--page-token FILE, or {TOKEN} in the environment, must give the token of the"
                " page: a new one is printed on a terminal only"
            )
        try:
            page = stack.enter_context(open_page(*address, token))
        except OSError as error:
            place = ":".join(map(str, address))
            raise ModbusConnectionError(
                f"cannot show a page on {place}: {error.strerror}", errno=error.errno
            ) from error

        def tell() -> None:
            url = page.url if token is None else page.url.replace(token, "...")
            inform(f"page on {url}", to)
            if not is_loopback(address[0]):
                danger = (
                    f"anyone with the URL of the page {can}, and the connection is not encrypted"
                )
                complain(danger, "warning")

        yield tell
