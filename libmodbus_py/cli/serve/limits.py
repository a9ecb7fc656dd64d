"""
What clients may cost, as told by options.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

from ...server.limits import FULL_POLICIES, Limits

__all__ = ["add_arguments", "told"]

OPTIONS: list[tuple[str, Callable[[str], Any], str, str]] = [
    ("max-connections", int, "N", "over TCP (what the descriptor limit leaves)"),
    ("connections-per-address", int, "N", "of them for one address (a tenth, but 8 at least)"),
    ("frame-timeout", float, "S", "seconds that a frame may take from its first byte (5)"),
    ("handshake-timeout", float, "S", "seconds to the end of a TLS handshake (5)"),
    ("idle-timeout", float, "S", "seconds without a request, inf for no limit (3600)"),
    ("max-unsent", int, "BYTES", "of answers that a client does not take (65536)"),
    ("requests-per-second", float, "N", "of one address (no limit; UDP: 1000)"),
]
"""Those that are one number."""

NAMES = [*(name.replace("-", "_") for name, *_ in OPTIONS), "when_full", "allow"]


def add_arguments(command: argparse.ArgumentParser) -> Any:
    """Tell argparse of them; gives their group."""
    group = command.add_argument_group("what clients may cost")
    for name, convert, metavar, text in OPTIONS:
        group.add_argument(f"--{name}", type=convert, metavar=metavar, help=text)
    group.add_argument("--when-full", choices=FULL_POLICIES, help="(close-idle)")
    group.add_argument(
        "--allow", action="append", metavar="NETWORK", help="serve only these; may be repeated"
    )
    return group


def told(options: argparse.Namespace) -> Limits | None:
    """
    Give what the options say, or None if they say nothing.

    Raises:
        ValueError: as of `Limits`.
    """
    given = {name: value for name in NAMES if (value := getattr(options, name)) is not None}
    if given.get("idle_timeout") == math.inf:
        given["idle_timeout"] = None
    return Limits(**given) if given else None
