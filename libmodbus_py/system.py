"""
Calls that only Linux has, and what takes their place elsewhere.

Each part is looked for when it is used, so that no import fails where it is missing. A port to
another system changes this file; all others use what every POSIX system has.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import Protocol

__all__ = [
    "IP_PKTINFO",
    "KEY_REJECTED",
    "PROBES",
    "TCP_QUICKACK",
    "DescriptorPoller",
    "Flag",
    "allow_all_descriptors",
    "boot_time",
    "call_in_children",
    "lock_file",
    "make_poller",
    "most_descriptors",
    "peer_credentials",
    "reserve_descriptors",
    "set_odd_baudrate",
]

TCP_QUICKACK: int | None = getattr(socket, "TCP_QUICKACK", None)
"""Option of a TCP socket: acknowledge at once; None where the system decides alone."""

PROBES: tuple[int | None, ...] = (
    # macOS calls the first one so.
    getattr(socket, "TCP_KEEPIDLE", getattr(socket, "TCP_KEEPALIVE", None)),
    getattr(socket, "TCP_KEEPINTVL", None),
    getattr(socket, "TCP_KEEPCNT", None),
)
"""Options of a TCP socket: silence before probes, time between them, their number."""

# Python has no name for it before 3.14; the number is that of <linux/in.h>.
IP_PKTINFO: int = getattr(socket, "IP_PKTINFO", 8 if sys.platform == "linux" else 26)

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


class DescriptorPoller(Protocol):
    """
    Many descriptors that are waited for through one, as `select.epoll`.

    Events are POLLIN and POLLOUT of `select`; errors are reported as POLLERR or POLLHUP, or as the
    events that were asked for.
    """

    @property
    def closed(self) -> bool: ...

    def fileno(self) -> int:
        """Return a descriptor that is readable while one of the others is ready."""
        ...

    def register(self, fd: int, eventmask: int = ..., /) -> None: ...
    def modify(self, fd: int, eventmask: int, /) -> None: ...
    def unregister(self, fd: int, /) -> None: ...

    def poll(self, timeout: float | None = ..., maxevents: int = ..., /) -> list[tuple[int, int]]:
        """Return descriptors that are ready, with their events."""
        ...

    def close(self) -> None: ...


def make_poller() -> DescriptorPoller:
    """
    Return a poller: an epoll, or in its place what asyncio waits with, such as kqueue.

    Raises:
        OSError: no descriptor is left.
    """
    if hasattr(select, "epoll"):
        return select.epoll()
    return SelectorPoller()


class SelectorPoller:
    """A poller made from the selector of the system, which must have a descriptor of its own."""

    def __init__(self) -> None:
        import selectors

        self._selector = selectors.DefaultSelector()
        # Descriptors -> events of select, those that are registered without events included.
        self._wanted: dict[int, int] = {}
        self._events = (
            (select.POLLIN, selectors.EVENT_READ),
            (select.POLLOUT, selectors.EVENT_WRITE),
        )
        self.closed: bool = False

    def fileno(self) -> int:
        return self._selector.fileno()

    def register(self, fd: int, eventmask: int = select.POLLIN) -> None:
        if fd in self._wanted:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        self._want(fd, eventmask)

    def modify(self, fd: int, eventmask: int) -> None:
        self.unregister(fd)
        self._want(fd, eventmask)

    def unregister(self, fd: int) -> None:
        if self._wanted.pop(fd):
            self._selector.unregister(fd)

    def _want(self, descriptor: int, events: int) -> None:
        # No selector takes a descriptor without events; epoll does, and reports errors only.
        if wanted := sum(flag for event, flag in self._events if events & event):
            self._selector.register(descriptor, wanted)
        self._wanted[descriptor] = events

    def poll(self, timeout: float | None = None, maxevents: int = -1) -> list[tuple[int, int]]:
        found = [
            (key.fd, sum(event for event, flag in self._events if ready & flag))
            for key, ready in self._selector.select(timeout)
        ]
        if 0 <= maxevents < len(found):
            import random  # none of them is always the last

            return random.sample(found, maxevents)
        return found

    def close(self) -> None:
        self.closed = True
        self._selector.close()


def call_in_children(function: Callable[[], None]) -> None:
    """Call a function in each process that is forked from this one from now on."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=function)


def boot_time() -> float:
    """Return seconds of a clock that continues while the machine is suspended, if it has one."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


def peer_credentials(made: socket.socket) -> tuple[int, int] | None:
    """
    Return the process and the user at the other end of a connected Unix socket.

    Both are those at the time of the connection; the process is 0 if it is in a container whose
    processes have other numbers. None on a system that does not report them like Linux.
    """
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    size = struct.calcsize("3i")
    found = made.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    process, user, _ = struct.unpack("3i", found)
    return process, user


def lock_file(descriptor: int) -> None:
    """
    Lock an open file until it is closed; do nothing on a system without such locks.

    Raises:
        BlockingIOError: another program has it.
        OSError: it cannot be locked.
    """
    try:
        import fcntl
    except ImportError:
        return
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


# --- descriptors ----------------------------------------------------------------------------


def most_descriptors() -> int:
    """Return the number of descriptors that this process may have open."""
    try:
        import resource
    except ImportError:
        return 1024  # as usual where there is a limit
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def allow_all_descriptors() -> None:
    """Raise the number of descriptors to what the system allows, if that is possible."""
    try:
        import resource
    except ImportError:
        return
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def reserve_descriptors(descriptor: int, highest: int) -> None:
    """
    Make the system's table of descriptors grow now, up to a number.

    On Linux, growth in a process with threads delays a new descriptor by 10 ms (synchronize_rcu).
    """
    with contextlib.suppress(ImportError, OSError):
        import fcntl

        duplicate = getattr(fcntl, "F_DUPFD_CLOEXEC", fcntl.F_DUPFD)  # PyPy has the second only
        os.close(fcntl.fcntl(descriptor, duplicate, highest))


# --- serial ports -----------------------------------------------------------------------------


def set_odd_baudrate(descriptor: int, baudrate: int) -> None:
    """
    Set a rate without a constant of its own, and check that the port accepted it.

    Raises:
        OSError: the port, or this system, cannot do it.
    """
    if sys.platform != "linux":
        rates = "only usual rates can be set on this system"
        raise OSError(errno.EINVAL, f"baudrate {baudrate} refused: {rates}")
    import fcntl

    # struct termios2, TCGETS2, TCSETS2, CBAUD and BOTHER of asm-generic/termbits.h; where they
    # differ the ioctl fails, and the baud rate is refused.
    termios2 = struct.Struct("4IB19B2I")
    get, set_, rate_bits, other_rate = 0x802C542A, 0x402C542B, 0o010017, 0o010000
    try:
        fields = list(termios2.unpack(fcntl.ioctl(descriptor, get, bytes(termios2.size))))
        fields[2] = fields[2] & ~(rate_bits | rate_bits << 16) | other_rate
        fields[-2:] = baudrate, baudrate
        fcntl.ioctl(descriptor, set_, termios2.pack(*fields))
        *_, speed = termios2.unpack(fcntl.ioctl(descriptor, get, bytes(termios2.size)))
    except OSError as error:
        raise OSError(error.errno, f"baudrate {baudrate} refused: {error.strerror}") from None
    # A receiver tolerates 2 % (serial line, 2.4).
    if abs(speed - baudrate) > baudrate * 0.02:
        raise OSError(errno.EINVAL, f"baudrate {baudrate} refused: the port does {speed}")
