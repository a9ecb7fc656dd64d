"""
Calls that only Linux has.

Not every Python on Linux has a name for all of them: PyPy lacks some, and takes what stands beside.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import resource
import socket
import stat
import struct
import time
from collections.abc import Callable
from typing import BinaryIO

# Python has no name for it before 3.14; the number is that of <linux/in.h>.
IP_PKTINFO: int = getattr(socket, "IP_PKTINFO", 8)

# The number is that of <linux/time.h>.
CLOCK_BOOTTIME: int = getattr(time, "CLOCK_BOOTTIME", 7)

KEY_REJECTED: int = getattr(errno, "EKEYREJECTED", errno.EACCES)
"""The errno of a certificate that is refused."""


class Flag:
    """
    A descriptor that is readable while the flag is set.

    Attributes:
        descriptor: to wait for; -1 when closed.

    Raises:
        OSError: no descriptor is left.
    """

    __slots__ = ("_end", "descriptor")

    def __init__(self) -> None:
        self.descriptor: int = -1
        self._end = -1  # the end of a pipe that is written; -1 without one
        if hasattr(os, "eventfd"):
            self.descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        else:
            self.descriptor, self._end = os.pipe()  # which programs that are started do not inherit
            os.set_blocking(self.descriptor, False)
            os.set_blocking(self._end, False)

    def set(self) -> None:
        """Make the descriptor readable; do nothing when it is closed."""
        if self._end >= 0:
            with contextlib.suppress(BlockingIOError):  # a full pipe is readable
                os.write(self._end, b"\0")
        elif self.descriptor >= 0:
            os.eventfd_write(self.descriptor, 1)

    def clear(self) -> None:
        """Make the descriptor not readable; do nothing when it is closed."""
        with contextlib.suppress(BlockingIOError):
            if self._end >= 0:
                while os.read(self.descriptor, 4096):
                    pass
            elif self.descriptor >= 0:
                os.eventfd_read(self.descriptor)

    def close(self) -> None:
        """Close the descriptor; any number of times."""
        ends = self.descriptor, self._end
        self.descriptor = self._end = -1
        for end in ends:
            if end >= 0:
                os.close(end)


def call_in_children(function: Callable[[], None]) -> None:
    """Call a function in each process that is forked from this one from now on."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=function)


def boot_time() -> float:
    """Return seconds of a clock that continues while the machine is suspended."""
    return time.clock_gettime(CLOCK_BOOTTIME)


def peer_credentials(connection: socket.socket) -> tuple[int, int]:
    """
    Return the process and the user at the other end of a connected Unix socket.

    Both are those at the time of the connection; the process is 0 if it is in a container whose
    processes have other numbers.
    """
    size = struct.calcsize("3i")
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    process, user, _ = struct.unpack("3i", credentials)
    return process, user


def lock_file(descriptor: int) -> None:
    """
    Lock an open file until it is closed.

    Raises:
        BlockingIOError: another program has it.
        OSError: it cannot be locked.
    """
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


# --- files ----------------------------------------------------------------------------------


def open_file(path: str | os.PathLike[str]) -> BinaryIO:
    """
    Open a regular file to read it, without waiting: a named pipe would wait for a writer.

    Raises:
        OSError: the file cannot be opened, or is a pipe, a device or a folder.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY)
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
        raise OSError(errno.EINVAL, "not a regular file", os.fspath(path))
    return open(descriptor, "rb")


# --- descriptors ----------------------------------------------------------------------------


def most_descriptors() -> int:
    """Return the number of descriptors that this process may have open."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def allow_all_descriptors() -> None:
    """Raise the number of descriptors to what the system allows, if that is possible."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def reserve_descriptors(descriptor: int, highest: int) -> None:
    """
    Make the system's table of descriptors grow now, up to a number.

    On Linux, growth in a process with threads delays a new descriptor by 10 ms (synchronize_rcu).
    """
    with contextlib.suppress(OSError):
        duplicate = getattr(fcntl, "F_DUPFD_CLOEXEC", fcntl.F_DUPFD)  # PyPy has the second only
        os.close(fcntl.fcntl(descriptor, duplicate, highest))
