"""
The option for a live page of a server.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator

from ...ports.hosts import is_loopback
from ...protocol.errors import ModbusConnectionError
from ...server.server import Running, Server
from ..output import complain
from .addresses import Address, address_like

__all__ = ["add_argument", "shown"]

EXAMPLE = ("127.0.0.1", 8080)


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


@contextlib.contextmanager
def shown(
    server: Server, address: Address | None, announce: Callable[[Running], object]
) -> Iterator[Callable[[Running], object]]:
    """
    Show a server on a live page while the block runs, if there is an address.

    Args:
        announce: prints where the server listens.

    Yields:
        A function that prints where the server listens, and the URL of the page.

    Raises:
        ModbusConnectionError: the address is not available, with errno.
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
            if not is_loopback(address[0]):
                complain(
                    "anyone with the URL of the page can change all devices, and the connection is"
                    " not encrypted"
                )

        yield announce_all
