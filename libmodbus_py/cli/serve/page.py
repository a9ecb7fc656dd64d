"""
The option for a live page of a server.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Iterator

from ...ports.hosts import is_loopback
from ...protocol.errors import ModbusConnectionError
from ...server.server import Running, Server
from ..output import complain
from .addresses import Address, address_like

__all__ = ["add_argument", "shown"]

EXAMPLE = ("127.0.0.1", 8080)

TOKEN = "LIBMODBUS_PY_PAGE_TOKEN"
"""The environment variable that has the token of the page."""

# More than a token may have.
MAX_FILE = 1000


def add_argument(command: argparse.ArgumentParser) -> None:
    """Add the option to argparse."""
    command.add_argument(
        "--page",
        type=address_like("{}:{}".format(*EXAMPLE)),
        nargs="?",
        const=EXAMPLE,
        metavar="HOST:PORT",
        help="serve a live page of the devices at this address, over HTTP ({}:{})".format(*EXAMPLE),
    )
    command.add_argument(
        "--page-token",
        metavar="FILE",
        help="file with the token of the page, 22 or more letters, digits, - or _, so that its URL"
        f" stays the same; unless given, {TOKEN} in the environment, or a new one",
    )


def token_of(file: str | None) -> str | None:
    """
    Return the token of the page from a file or the environment; None without either.

    Raises:
        ValueError: the file cannot be read.
    """
    if file is None:
        return os.environ.get(TOKEN) or None
    try:
        with open(file, encoding="utf-8", errors="replace") as opened:
            return opened.read(MAX_FILE).strip()
    except OSError as error:
        raise ValueError(f"--page-token: {file}: {error.strerror}") from None


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
        ValueError: the token is wrong, or there is one but no page.
    """
    if address is None:
        if token_file is not None:
            raise ValueError("--page-token needs --page")
        yield announce
        return
    from ...tools.page.page import live_page

    with contextlib.ExitStack() as stack:
        try:
            page = stack.enter_context(live_page(server, *address, token_of(token_file)))
        except OSError as error:
            place = ":".join(map(str, address))
            raise ModbusConnectionError(
                f"cannot show a page on {place}: {error.strerror}", errno=error.errno
            ) from error

        def announce_all(running: Running) -> None:
            announce(running)
            print(f"page on {page.url}", flush=True)
            if not is_loopback(address[0]):
                complain(
                    "anyone with the URL of the page can change all devices, and the connection is"
                    " not encrypted"
                )

        yield announce_all
