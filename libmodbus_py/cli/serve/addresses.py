"""
Addresses on the command line: HOST:PORT.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

__all__ = ["Address", "OneAddress", "address_like"]

Address = tuple[str, int]


def address_like(example: str) -> Callable[[str], Address]:
    """Return a function that reads an address; its error shows the example."""

    def read(text: str) -> Address:
        with contextlib.suppress(ValueError):
            parts = urlsplit(f"//{text}")
            if parts.netloc == text and parts.hostname and parts.port is not None:
                return parts.hostname, parts.port
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
