"""
Programs that tests, fuzzers and benchmarks start, found also where a user's PATH does not lead.
"""

from __future__ import annotations

import os
import shutil

__all__ = ["find", "missing", "program"]

# Debian installs servers here, and leaves these folders out of the PATH of ordinary users.
SERVER_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


def find(name: str) -> str | None:
    """Return the path of a program, or None if it is not installed."""
    folders = [os.environ.get("PATH", os.defpath), *SERVER_FOLDERS]
    return shutil.which(name, path=os.pathsep.join(folders))


def program(name: str) -> str:
    """
    Return the path of a program.

    Raises:
        FileNotFoundError: the program is not installed.
    """
    found = find(name)
    if found is None:
        raise FileNotFoundError(f"{name} is not installed")
    return found


def missing(*names: str) -> list[str]:
    """Return those of these programs that are not installed."""
    return [name for name in names if find(name) is None]
