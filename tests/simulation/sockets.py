"""
TCP connections and datagrams in memory, with the faces of `socket.socket` and `select.epoll` that
the package uses.

What is sent arrives later, in order, in the pieces that the carriage of its direction makes of it.
"""

from __future__ import annotations

import errno
import os
import select
import socket
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from .events import Events
from .loop import Descriptors

Carriage = Callable[[bytes], Iterable[tuple[float, bytes]]]
"""Returns, for what was sent: pieces, and after how many seconds each arrives at the earliest."""

# What a direction holds before its sender must wait, as the system's buffers do.
CAPACITY = 1 << 16

DELAY = 0.0002

END, RESET = b"", None


def at_once(data: bytes) -> Iterable[tuple[float, bytes]]:
    """Carry all of it, whole, in the time that a local network takes."""
    return [(DELAY, data)]


class MemorySocket:
    """One end of a connection, or of an exchange of datagrams."""

    other: MemorySocket
    address: tuple[str, int] = ("", 0)

    def __init__(
        self, events: Events, descriptors: Descriptors, *, is_datagram: bool = False
    ) -> None:
        self.carriage: Carriage = at_once
        self.on_input: Callable[[], object] | None = None
        self.on_sent: Callable[[bytes], object] | None = None
        self.capacity: int = CAPACITY
        self.sent: int = 0
        self._events = events
        self._descriptors = descriptors
        self._descriptor = descriptors.new()
        self._is_datagram = is_datagram
        self._transit: deque[tuple[float, bytes | None]] = deque()
        self._inbox: deque[bytes] = deque()
        self._coming = 0  # bytes in flight to this side, or unread
        self._has_ended = False  # the other side sends nothing more
        self._error = 0
        self._is_shut = False
        self._epoll: MemoryEpoll | None = None
        descriptors.writable.add(self._descriptor)

    # --- as a socket ------------------------------------------------------------------------

    @property
    def is_closed(self) -> bool:
        return self._descriptor < 0

    def fileno(self) -> int:
        return self._descriptor

    def setsockopt(self, *_: Any) -> None:
        self._check()

    def setblocking(self, flag: bool) -> None:
        self._check()

    def getsockopt(self, level: int, option: int) -> int:
        """Return SO_ERROR, the one option that is asked for."""
        self._check()
        return self._error

    def recv(self, size: int, flags: int = 0) -> bytes:
        self._check()
        if not self._inbox:
            if self._error:
                raise _error(self._error)
            if self._has_ended:
                return b""
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        data = self._inbox[0]
        piece = data if self._is_datagram else data[:size]
        if flags & socket.MSG_PEEK:
            return piece
        self._inbox.popleft()
        if len(piece) < len(data):
            self._inbox.appendleft(data[len(piece) :])
        self._coming -= len(piece)
        self._follow()
        self.other.note_room()
        return piece

    def send(self, data: bytes | bytearray | memoryview) -> int:
        self._check()
        if self._error or self._is_shut:
            raise _error(self._error or errno.EPIPE)
        if not data and not self._is_datagram:
            return 0
        room = self._room
        if room <= 0 and not self._is_datagram:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        piece = bytes(data) if self._is_datagram else bytes(data[:room])
        self.sent += len(piece)
        if self.on_sent is not None:
            self.on_sent(piece)
        for delay, part in self.carriage(piece):
            self.other.expect(delay, part)
        self._note_writable()
        return len(piece)

    def shutdown(self, how: int) -> None:
        self._check()
        if how != socket.SHUT_RD and not self._is_shut:
            self._is_shut = True
            self.other.expect(DELAY, END)
        if how != socket.SHUT_WR:
            self._has_ended = True
            self._follow()

    def close(self) -> None:
        """Close; the other end is told in order, or at once if something was unread here."""
        if self._descriptor < 0:
            return
        if not self._is_datagram and not self._is_shut:
            self.other.expect(DELAY, RESET if self._inbox else END)
        self._descriptors.forget(self._descriptor)
        self._descriptor = -1
        self._inbox.clear()

    # --- on the way -------------------------------------------------------------------------

    def expect(self, delay: float, data: bytes | None) -> None:
        """Let something arrive here, behind what is on its way already."""
        at = self._events.now + delay
        if self._transit and not self._is_datagram:
            at = max(at, self._transit[-1][0])
        self._transit.append((at, data))
        self._coming += len(data or b"")
        self._events.at(at, self._arrive)

    def reset(self, number: int = errno.ECONNRESET) -> None:
        """End the connection here as if the other side had reset it, now."""
        self._error = number
        self._follow()

    def refuse(self) -> None:
        """Refuse the attempt to connect whose near end this is."""
        self._error = errno.ECONNREFUSED
        self._note_writable()

    def note_room(self) -> None:
        self._note_writable()

    def _arrive(self) -> None:
        came = False
        for entry in list(self._transit):
            at, data = entry
            if at > self._events.now:
                if self._is_datagram:
                    continue
                break
            self._transit.remove(entry)
            came = True
            self._take(data)
        if came and self._descriptor >= 0:
            self._follow()
            if self.on_input is not None:
                self.on_input()

    def _take(self, data: bytes | None) -> None:
        if data is RESET:
            self._error = errno.ECONNRESET
        elif self._descriptor < 0:
            if data and not self._is_datagram:
                self.other.expect(DELAY, RESET)
        elif data == END and not self._is_datagram:
            self._has_ended = True
        else:
            assert data is not None
            self._inbox.append(data)

    # --- what can be done -------------------------------------------------------------------

    @property
    def _room(self) -> int:
        return self.capacity - self.other._coming

    @property
    def is_readable(self) -> bool:
        return bool(self._inbox or self._has_ended or self._error)

    @property
    def has_failed(self) -> bool:
        return self._error != 0

    def _follow(self) -> None:
        """Note whether there are bytes to read."""
        if self._descriptor < 0:
            return
        change = self._descriptors.readable
        (change.add if self.is_readable else change.discard)(self._descriptor)
        if self._epoll is not None:
            self._epoll.follow(self._descriptor)
        if self._error:
            self._note_writable()

    def _note_writable(self) -> None:
        if self._descriptor < 0:
            return
        can = self._error or self._is_datagram or self._room > 0
        change = self._descriptors.writable
        (change.add if can else change.discard)(self._descriptor)
        if self._epoll is not None:
            self._epoll.follow(self._descriptor)

    def watch_with(self, epoll: MemoryEpoll | None) -> None:
        self._epoll = epoll

    def _check(self) -> None:
        if self._descriptor < 0:
            raise _error(errno.EBADF)


def pair(
    events: Events, descriptors: Descriptors, *, is_datagram: bool = False
) -> tuple[MemorySocket, MemorySocket]:
    """Return two ends that are connected."""
    one = MemorySocket(events, descriptors, is_datagram=is_datagram)
    other = MemorySocket(events, descriptors, is_datagram=is_datagram)
    one.other, other.other = other, one
    return one, other


class _Inbox:
    """A socket at which something waits to be taken."""

    def __init__(self, descriptors: Descriptors, on_close: Callable[[], object]) -> None:
        self._descriptors = descriptors
        self._descriptor = descriptors.new()
        self._waiting: deque[tuple[Any, tuple[str, int]]] = deque()
        self._on_close = on_close

    def fileno(self) -> int:
        return self._descriptor

    def put(self, what: Any, source: tuple[str, int]) -> None:
        """Let something from the other side arrive."""
        self._waiting.append((what, source))
        self._descriptors.readable.add(self._descriptor)

    def take(self) -> tuple[Any, tuple[str, int]]:
        if not self._waiting:
            self._descriptors.readable.discard(self._descriptor)
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return self._waiting.popleft()

    def close(self) -> None:
        if self._descriptor >= 0:
            self._on_close()
            self._descriptors.forget(self._descriptor)
            self._descriptor = -1


class MemoryListener(_Inbox):
    """A socket that listens: whoever connected waits here to be accepted."""

    def accept(self) -> tuple[MemorySocket, tuple[str, int]]:
        return self.take()

    def close(self) -> None:
        super().close()
        while self._waiting:
            self._waiting.popleft()[0].close()


class MemoryDatagrams(_Inbox):
    """A socket of a server that receives datagrams from anybody, and answers them."""

    def __init__(
        self,
        descriptors: Descriptors,
        send: Callable[[bytes, tuple[str, int]], object],
        on_close: Callable[[], object],
    ) -> None:
        super().__init__(descriptors, on_close)
        self._send = send

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        data, source = self.take()
        return data[:size], source

    def sendto(self, data: bytes, target: tuple[str, int]) -> int:
        self._send(data, target)
        return len(data)


class MemoryEpoll:
    """In place of `select.epoll`; it is readable itself while any of its sockets is ready."""

    def __init__(self, descriptors: Descriptors, sockets: dict[int, MemorySocket]) -> None:
        self._descriptors = descriptors
        self._sockets = sockets
        self._descriptor = descriptors.new()
        self._wanted: dict[int, int] = {}
        self._ready: dict[int, int] = {}
        self.closed: bool = False

    def fileno(self) -> int:
        return self._descriptor

    def register(self, descriptor: int, events: int) -> None:
        self._wanted[descriptor] = events
        self._sockets[descriptor].watch_with(self)
        self.follow(descriptor)

    def modify(self, descriptor: int, events: int) -> None:
        self._wanted[descriptor] = events
        self.follow(descriptor)

    def unregister(self, descriptor: int) -> None:
        del self._wanted[descriptor]
        self._sockets.pop(descriptor).watch_with(None)
        self._ready.pop(descriptor, None)
        self._tell()

    def poll(self, timeout: float = 0, most: int = -1) -> list[tuple[int, int]]:
        ready = list(self._ready.items())[: most if most >= 0 else None]
        for descriptor, events in ready:  # the other descriptors come first the next time
            del self._ready[descriptor]
            self._ready[descriptor] = events
        return ready

    def close(self) -> None:
        self.closed = True
        self._descriptors.forget(self._descriptor)

    def follow(self, descriptor: int) -> None:
        """Check again whether one of the sockets is ready."""
        mask = self._wanted.get(descriptor, 0)
        can_read = descriptor in self._descriptors.readable
        can_write = descriptor in self._descriptors.writable
        events = mask & (can_read * select.EPOLLIN | can_write * select.EPOLLOUT)
        if descriptor in self._wanted and self._sockets[descriptor].has_failed:
            events |= select.EPOLLERR | select.EPOLLHUP  # whether wanted or not
        if events:
            self._ready[descriptor] = events
        else:
            self._ready.pop(descriptor, None)
        self._tell()

    def _tell(self) -> None:
        change = self._descriptors.readable
        (change.add if self._ready else change.discard)(self._descriptor)


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))
