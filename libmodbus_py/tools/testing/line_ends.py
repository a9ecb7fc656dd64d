"""
The far ends of serial lines that are pseudo-terminals.

The program at the near end may discard the bytes that wait to be read (tcflush), even between poll
and read. So these functions never block in read.
"""

from __future__ import annotations

import os
import select

__all__ = ["open_line", "read_what_is_there", "write_all"]

# Bytes are dropped if the line takes none for this many seconds, as without flow control.
TIMEOUT = 1.0


def open_line() -> tuple[int, int, str]:
    """Return the far end and the near end of a raw line, and the path of the near end."""
    import pty
    import tty

    far, near = pty.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    return far, near, os.ttyname(near)


def read_what_is_there(far: int) -> bytes:
    """Return the bytes that can be read without waiting, possibly none."""
    try:
        return os.read(far, 4096)
    except BlockingIOError:
        return b""


def write_all(far: int, data: bytes) -> None:
    """Write all bytes; drop the rest if there is no room for `TIMEOUT` seconds."""
    while data:
        try:
            data = data[os.write(far, data) :]
        except BlockingIOError:
            if not select.select([], [far], [], TIMEOUT)[1]:
                return
