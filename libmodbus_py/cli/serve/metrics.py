"""
The option for metrics, which Prometheus asks for over HTTP, and addresses such as its own.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator
from typing import Any, TextIO

from ...protocol.errors import ModbusConnectionError
from ..output import inform

__all__ = ["Address", "OneAddress", "add_argument", "address_like", "exposed"]

Address = tuple[str, int]


def add_argument(command: argparse.ArgumentParser) -> None:
    """Add the option to argparse."""
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
