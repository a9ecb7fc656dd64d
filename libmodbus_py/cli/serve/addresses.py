"""
Addresses on the command line: HOST:PORT.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from typing import Any

__all__ = ["Address", "OneAddress", "address_like"]

Address = tuple[str, int]


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
