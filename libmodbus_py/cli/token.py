"""
The command token: a secret for `--page-token`, in a file that only its owner can read.
"""

from __future__ import annotations

import argparse
import os
import secrets

from .arguments import declare

__all__ = ["add_command"]

TOKEN_BYTES = 24

DESCRIPTION = """\
Make a new token: 32 letters and digits that nobody can guess. Whoever has the
token of a live page can see it, and change what it shows."""

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


def add_command(command: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    command.description, command.epilog = DESCRIPTION, EXAMPLES
    declare(command, ARGUMENTS)
    command.set_defaults(run=_make)


def _make(options: argparse.Namespace) -> int:
    token = secrets.token_urlsafe(TOKEN_BYTES)
    if options.file is None:
        print(token)
        return 0
    descriptor = os.open(options.file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with open(descriptor, "w") as file:
        file.write(f"{token}\n")
    return 0
