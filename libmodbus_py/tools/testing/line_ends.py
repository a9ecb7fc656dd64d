"""
The far ends of serial lines that are pseudo-terminals.

Who has the near end open may discard what waits to be read (tcflush), also between a look whether
something is there and the reading of it. So these never wait to read.
"""

from __future__ import annotations

import os
import pty
import select
import tty

__all__ = ["open_line", "read_what_is_there", "write_all"]

# Seconds without room after which bytes are lost, as on a line without flow control.
PATIENCE = 1.0


def open_line() -> tuple[int, int, str]:
    """Give the far end of a line that changes no byte, the near end, and the path of that."""
    far, near = pty.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    return far, near, os.ttyname(near)


def read_what_is_there(far: int) -> bytes:
    """Give nothing if there is nothing."""
    try:
        return os.read(far, 4096)
    except BlockingIOError:
        return b""


def write_all(far: int, data: bytes) -> None:
    """Wait while there is no room, but not for ever: then the rest is lost."""
    while data:
        try:
            data = data[os.write(far, data) :]
        except BlockingIOError:
            if not select.select([], [far], [], PATIENCE)[1]:
                return
