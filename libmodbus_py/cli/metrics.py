"""
Metrics of a server, over HTTP, as told by an option.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from ..protocol.errors import ModbusConnectionError

__all__ = ["add_argument", "exposed"]


def add_argument(command: argparse.ArgumentParser) -> None:
    """Tell argparse of it."""
    command.add_argument(
        "--metrics", type=_address, metavar="HOST:PORT", help="answer Prometheus here, over HTTP"
    )


def _address(text: str) -> tuple[str, int]:
    with contextlib.suppress(ValueError):
        parts = urlsplit(f"//{text}")
        if parts.netloc == text and parts.hostname and parts.port is not None:
            return parts.hostname, parts.port
    raise argparse.ArgumentTypeError(f"must be HOST:PORT, such as 127.0.0.1:9400, not {text!r}")


@contextlib.contextmanager
def exposed(server: Any, address: tuple[str, int] | None) -> Iterator[None]:
    """
    Expose the statistics of a server while the block runs, if there is an address.

    Raises:
        SystemExit: what this needs is not installed.
        ModbusConnectionError: the address cannot be had, with errno.
    """
    if address is None:
        yield
        return
    try:
        from ..integrations import exposition, prometheus
    except ImportError as error:
        sys.exit(f"libmodbus-py: {error}")
    prometheus.collect(server)
    with contextlib.ExitStack() as stack:
        try:
            url = stack.enter_context(exposition.exposing(*address))
        except OSError as error:
            place = ":".join(map(str, address))
            raise ModbusConnectionError(
                f"cannot listen for metrics on {place}: {error.strerror}", errno=error.errno
            ) from error
        print(f"metrics on {url}", flush=True)
        yield
