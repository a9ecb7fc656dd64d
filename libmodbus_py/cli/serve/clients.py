"""
Options for what clients of a server may do, and for a record of it: limits and an audit trail.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

from ...server.limits import FULL_POLICIES, Limits
from ..arguments import add_defaults, flag, given
from ..help import make_rare

__all__ = ["add_audit", "add_limits", "limits_of"]

# fmt: off
NUMBERS: dict[str, tuple[Callable[[str], Any], str, str]] = {
    "max_connections": (
        int, "N", "maximum number of TCP connections; by default what the open-file limit allows"
    ),
    "connections_per_address": (
        int, "N", "maximum number of TCP connections per address; by default a tenth of all"
    ),
    "frame_timeout": (float, "S", "seconds from the first byte of a frame to the last"),
    "handshake_timeout": (float, "S", "seconds for a TLS handshake"),
    "certificate_interval": (
        float, "S", "seconds between checks of the certificates of open TLS connections"
    ),
    "idle_timeout": (
        float, "S", "seconds without a request after which a connection is closed, or inf"
    ),
    "max_unsent": (
        int, "BYTES", "bytes of responses buffered for a client that does not read them"
    ),
    "requests_per_second": (
        float, "N", "requests answered per address; by default all, over UDP 1000"
    ),
}
"""Field of `Limits` -> type, placeholder and text of the option."""
# fmt: on


def add_limits(command: argparse.ArgumentParser) -> Any:
    """Add the options for limits to argparse, and return their group."""
    group = command.add_argument_group("limits on clients")
    added = [
        group.add_argument(flag(name), type=convert, metavar=placeholder, help=text)
        for name, (convert, placeholder, text) in NUMBERS.items()
    ]
    added.append(
        group.add_argument(
            "--when-full",
            choices=FULL_POLICIES,
            metavar="POLICY",
            help="when there is no room for a connection: close-idle closes another one, which is"
            " idle; refuse closes the new one",
        )
    )
    make_rare(*added)
    add_defaults(added, lambda: {each.name: each.default for each in fields(Limits)})
    group.add_argument(
        "--allow",
        action="append",
        metavar="NETWORK",
        help="serve clients of this network or address only; may be repeated",
    )
    return group


def limits_of(options: argparse.Namespace) -> Limits | None:
    """Return the limits that the options set, or None without any."""
    typed = given(options, [*NUMBERS, "when_full", "allow"])
    if typed.get("idle_timeout") == math.inf:
        typed["idle_timeout"] = None
    return Limits(**typed) if typed else None


def add_audit(command: argparse.ArgumentParser) -> None:
    """Add the options for an audit trail to argparse."""
    group = command.add_argument_group("audit trail")
    group.add_argument(
        "--audit",
        metavar="FILE",
        help="append a line of JSON to this file for each write, and for each request, connection"
        " and TLS handshake that is refused; SIGHUP opens it again",
    )
    group.add_argument(
        "--audit-required",
        action="store_true",
        help="refuse writes with exception 4 while the file cannot be written",
    )
