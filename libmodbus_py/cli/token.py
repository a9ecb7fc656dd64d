"""
The command token: a secret for `--page-token`, in a file that only its owner can read.

It is as the page makes them itself, for a terminal: a service has none, and its log is no place for
a secret.
"""

from __future__ import annotations

import argparse
import os
import secrets

from .parser import Parser, declare

TOKEN_BYTES = 24
"""32 letters; a page takes 22 to 200."""

DESCRIPTION = """\
Make a new token of 32 letters and digits for a live page. A client with the
token can see the page, and change what it shows."""

EXAMPLES = """\
examples:
  libmodbus-py token                            # printed
  libmodbus-py token page.token                 # for --page-token page.token
  libmodbus-py token /etc/libmodbus-py/page.token
  libmodbus-py token "$STATE_DIRECTORY/token"   # in a service of systemd"""

ARGUMENTS = """
[FILE]
    new file for the token, which only its owner can read; without it, the token is printed
"""


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, EXAMPLES
    declare(command, ARGUMENTS)
    command.set_defaults(run=_make)


def _make(options: argparse.Namespace) -> int:
    """Print a token, or write it to a new file; an existing one may be in use."""
    token = secrets.token_urlsafe(TOKEN_BYTES)
    if options.file is None:
        print(token)
        return 0
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    descriptor = os.open(options.file, flags, 0o600)
    try:
        with open(descriptor, "w") as file:
            file.write(f"{token}\n")
    except OSError:
        # A file without a token would be in the way of the next try.
        os.unlink(options.file)
        raise
    return 0
