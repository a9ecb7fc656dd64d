"""
A file that is written aside and then takes the place of the former one.
"""

from __future__ import annotations

import contextlib
import glob
import os
import stat
import tempfile

__all__ = ["remove_leftovers", "write_aside"]

# The end of the name of a file that is being written.
ASIDE = ".new"


def write_aside(path: str | os.PathLike[str], text: str) -> None:
    """
    Write a text to a file so that it is there wholly, or the file is as before.

    A new file is readable by its owner only; one that is replaced keeps its permissions.

    Raises:
        OSError: it cannot be written; nothing is left of it.
    """
    target = os.path.realpath(path)  # a link stays a link
    folder, name = os.path.split(target)
    descriptor, aside = tempfile.mkstemp(ASIDE, f"{name}.", folder)
    try:
        with open(descriptor, "w", encoding="utf-8", newline="") as file:
            with contextlib.suppress(FileNotFoundError):
                os.fchmod(descriptor, stat.S_IMODE(os.stat(target).st_mode))
            file.write(text)
            file.flush()
            os.fsync(descriptor)
        os.replace(aside, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(aside)
        raise
    _settle(folder)


def remove_leftovers(path: str | os.PathLike[str]) -> None:
    """Remove what a process left that ended while it wrote a file. No other may write it now."""
    for aside in glob.glob(f"{glob.escape(os.path.realpath(path))}.????????{ASIDE}"):
        with contextlib.suppress(OSError):
            os.unlink(aside)


def _settle(folder: str) -> None:
    """Force the new name to the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
