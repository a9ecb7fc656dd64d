"""
A live page of a server, as told by an option.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator
from ipaddress import ip_address

from ...protocol.errors import ModbusConnectionError
from ...server.server import Running, Server
from .addresses import Address, address_like

__all__ = ["add_argument", "shown"]

EXAMPLE = ("127.0.0.1", 8080)


def add_argument(command: argparse.ArgumentParser) -> None:
    """Tell argparse of it."""
    command.add_argument(
        "--page",
        type=address_like("{}:{}".format(*EXAMPLE)),
        nargs="?",
        const=EXAMPLE,
        metavar="HOST:PORT",
        help="show everything on a live page, over HTTP ({}:{})".format(*EXAMPLE),
    )


@contextlib.contextmanager
def shown(
    server: Server, address: Address | None, announce: Callable[[Running], object]
) -> Iterator[Callable[[Running], object]]:
    """
    Show a server on a page while the block runs, if there is an address.

    Args:
        announce: tells where the server listens.

    Returns:
        What tells that, and where the page is.

    Raises:
        ModbusConnectionError: the address cannot be had, with errno.
    """
    if address is None:
        yield announce
        return
    from ...tools.page.page import live_page

    with contextlib.ExitStack() as stack:
        try:
            page = stack.enter_context(live_page(server, *address))
        except OSError as error:
            place = ":".join(map(str, address))
            raise ModbusConnectionError(
                f"cannot show a page on {place}: {error.strerror}", errno=error.errno
            ) from error

        def announce_all(running: Running) -> None:
            announce(running)
            print(f"page on {page.url}", flush=True)
            if not _is_here(address[0]):
                print(
                    "libmodbus-py: whoever reaches the page and has its URL may change everything,"
                    " and nothing of it is encrypted",
                    file=sys.stderr,
                    flush=True,
                )

        yield announce_all


def _is_here(host: str) -> bool:
    try:
        return ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return host == "localhost"
