"""
Addresses on the command line: HOST:PORT.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from urllib.parse import urlsplit

__all__ = ["Address", "address_like"]

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
