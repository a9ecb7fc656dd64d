"""
Who one is and whom one trusts, for tls:// URLs, as told by options.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..security.security import Security

__all__ = ["add_arguments", "told"]

OPTIONS: list[tuple[str, str, str]] = [
    ("cert", "FILE", "own certificate, PEM"),
    ("key", "FILE", "its private key (in the same file)"),
    ("ca", "FILE", "the authorities who sign those that are trusted"),
    ("server-name", "NAME", "that the server's certificate has (the host of the URL)"),
    ("password-env", "NAME", "the environment variable with the key's password"),
]
"""Options that are said once; those of URLs, with hyphens."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Tell argparse of them."""
    group = command.add_argument_group("for tls://, unless the URL says it")
    for name, metavar, text in OPTIONS:
        group.add_argument(f"--{name}", metavar=metavar, help=text)
    group.add_argument(
        "--pin",
        action="append",
        metavar="FILE",
        help="trust only this certificate: a file or its SHA-256; may be repeated",
    )


def told(options: argparse.Namespace) -> Security | None:
    """
    Give what the options say, or None if they say nothing.

    Raises:
        ValueError: a file that is none, and others; as of `Security`.
    """
    names = [name.replace("-", "_") for name, *_ in OPTIONS]
    given = {name: value for name in names if (value := getattr(options, name)) is not None}
    if options.pin:
        given["pin"] = ",".join(options.pin)
    if not given:
        return None
    from ..ports.tls import named_security

    return named_security("the command line", given)
