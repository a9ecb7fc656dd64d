"""
The options for a live page.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, TextIO, TypeGuard

from ...protocol.errors import ModbusConnectionError
from ..help import make_rare
from ..output import complain, inform
from .metrics import Address, OneAddress, address_like

if TYPE_CHECKING:
    from ...server.server import Running
    from ...tools.faults.server import Server
    from ...tools.page.page import Page
    from ...tools.page.table_source import Shown

__all__ = ["add_argument", "shown", "tables_shown"]

EXAMPLE = ("127.0.0.1", 8080)

TOKEN = "LIBMODBUS_PY_PAGE_TOKEN"
"""The environment variable that has the token of the page."""


def add_argument(command: argparse._ActionsContainer, what: str = "the devices") -> None:
    """
    Add the options to argparse.

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
