"""
The sources of bytes, with the time of each piece: a serial port, or a tap.

Clients connect to a tap, and it connects to the device. Every connection has its own thread, which
passes bytes on before it keeps them for the listener, so that a slow listener does not delay a
device.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from ...ports.endpoint import Endpoint
from ...ports.hosts import listen_on, reason, start_thread
from ...ports.sockets import TcpPort, keep_alive
from ...ports.waiting import Waker, Woken, milliseconds, run
from ...protocol.errors import ModbusConnectionError
from ...protocol.logs import HarmlessLogger
from .separator import Direction

__all__ = ["SerialSource", "Tap", "TapLink", "TimedBytes"]


class TimedBytes(NamedTuple):
    """
    Bytes that were received together.

    Attributes:
        link: the number of the connection; 0 on a serial line.
        sender: "client" or "server"; None on a serial line, where the sender is not known.
        at: the time at which they arrived, in seconds.
        data: empty at the end of a connection.
    """

    link: int
    sender: Direction | None
    at: float
    data: bytes


class SerialSource:
    """
    A serial port that is only read.

    Attributes:
        descriptor: readable when there are bytes to receive.

    Raises:
        TypeError, ValueError: a setting is wrong.
    """

    def __init__(self, endpoint: Endpoint, clock: Callable[[], float]) -> None:
        from ...ports.serial import ReadOnlySerialPort  # which not every system has

        self._port = ReadOnlySerialPort(endpoint.path, **endpoint.serial_settings)
        self._clock = clock

    @property
    def descriptor(self) -> int:
        return self._port.descriptor

    def open(self) -> None:
        self._port.open()

    def receive(self) -> list[TimedBytes]:
        return [TimedBytes(0, None, self._clock(), data) for data in self._port.receive()]

    def close(self) -> None:
        self._port.close()


# --- between clients and a device -----------------------------------------------------------------


Passed = Callable[[Direction, float, bytes], object]
"""Called with the sender, the time and the bytes, once they were passed on."""

# Seconds before connecting to the device times out.
CONNECT_TIMEOUT = 10.0

# Seconds without a byte after which a connection ends, as at a server (`Limits.idle_timeout`).
IDLE = 3600.0

# The same when one side has closed its direction, or takes no bytes.
LEAVING = 60.0

# Seconds of silence after which the system probes a side, as for clients.
KEEPALIVE = 30.0

# Bytes that are read at once.
READ_SIZE = 65_536


class TapLink:
    """
    Passes bytes on between a client and a device, in a thread of its own.

    Args:
        client: the connection of the client.
        clock: returns the time of each piece, in seconds.

    Attributes:
        active_at: the time at which the last bytes arrived, or the client connected
            (time.monotonic).

    Raises:
        OSError: the process has no descriptor left.
    """

    def __init__(self, client: socket.socket, clock: Callable[[], float]) -> None:
        self._ends: list[socket.socket] = [client]
        self._clock = clock
        self._waker = Waker()
        self.active_at: float = time.monotonic()

    def connect(self, device: Endpoint) -> None:
        """
        Connect to the device.

        Raises:
            ModbusConnectionError: the connection could not be established.
            Woken: `end` was called.
        """
        port = TcpPort(device.host, device.port, KEEPALIVE)
        run(port.opening(time.monotonic() + CONNECT_TIMEOUT), self._waker)
        self._ends.append(port.detach())

    def carry(self, passed: Passed) -> None:
        """
        Pass bytes on until both sides have ended, or are idle for too long.

        Raises:
            OSError: a side is gone, or takes no bytes.
        """
        client, device = self._ends
        for end in self._ends:
            end.settimeout(LEAVING)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            keep_alive(end, KEEPALIVE)
        ways: dict[int, tuple[Direction, socket.socket, socket.socket]] = {
            client.fileno(): ("client", client, device),
            device.fileno(): ("server", device, client),
        }
        poll = select.poll()
        for descriptor in (*ways, self._waker.descriptor):
            poll.register(descriptor, select.POLLIN)
        while ways:
            ready = poll.poll(milliseconds(IDLE if len(ways) == 2 else LEAVING))
            if not ready:
                return
            self.active_at = time.monotonic()
            for descriptor, _ in ready:
                if descriptor not in ways:  # `end` was called
                    return
                sender, source, sink = ways[descriptor]
                data = source.recv(READ_SIZE)
                at = self._clock()
                if data:
                    sink.sendall(data)
                    passed(sender, at, data)
                else:
                    poll.unregister(descriptor)
                    del ways[descriptor]
                    shut_down(sink, socket.SHUT_WR)

    def end(self) -> None:
        """End the connection, from another thread: the waits of `connect` and `carry` end."""
        self._waker.wake()
        for end in self._ends:
            shut_down(end)

    def close(self) -> None:
        """Close both connections. Must not be called while another thread may call `end`."""
        self._waker.close()
        for end in self._ends:
            end.close()


def shut_down(end: socket.socket, how: int = socket.SHUT_RDWR) -> None:
    """Shut down a socket that may be disconnected already."""
    with contextlib.suppress(OSError):
        end.shutdown(how)


logger: HarmlessLogger = HarmlessLogger(__name__)

# The most connections at once; a further one ends the connection that has been idle longest.
MAX_LINKS = 64

# The most bytes that are kept for the listener; further bytes are passed on without being kept.
MAX_UNSEEN = 1 << 20

# The memory that a piece takes in addition to its bytes.
PIECE_COST = 100


class Tap:
    """
    A source of the bytes between clients and a device.

    Args:
        endpoint: the address for clients; port 0 for a free one.
        target: the address of the device.
        clock: returns the time of each piece, in seconds.

    Attributes:
        descriptor: readable when there are bytes to receive.
        endpoint: the address for clients, with its port.

    Raises:
        ModbusConnectionError: the endpoint cannot be opened, with errno.
    """

    def __init__(self, endpoint: Endpoint, target: Endpoint, clock: Callable[[], float]) -> None:
        self._target = target
        self._clock = clock
        self._lock = threading.RLock()
        self._pieces: deque[TimedBytes] = deque()
        self._unseen = 0
        self._links: dict[int, TapLink] = {}
        self._count = 0
        self._is_closed = False
        self._listeners: list[socket.socket] = []
        try:
            self._listeners = listen_on(endpoint.host, endpoint.port)
            self._waker = Waker()
            self.descriptor: int = self._waker.descriptor
            for each in self._listeners:
                accepting = threading.Thread(
                    target=self._accept, args=(each,), name="tap", daemon=True
                )
                start_thread(accepting)
        except OSError as error:
            self._is_closed = True
            self._close_listeners()
            raise ModbusConnectionError(
                f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
            ) from error
        port: int = self._listeners[0].getsockname()[1]
        self.endpoint: Endpoint = Endpoint(endpoint.scheme, host=endpoint.host, port=port)

    def open(self) -> None:
        """Do nothing: the tap is open."""

    def receive(self) -> list[TimedBytes]:
        """Return the bytes that have passed, oldest first; an empty piece ends a connection."""
        with self._lock:
            self._waker.clear()
            pieces, self._pieces = self._pieces, deque()
            self._unseen = 0
        return list(pieces)

    def close(self) -> None:
        """Close all connections; any number of times."""
        with self._lock:
            self._is_closed = True
            for link in self._links.values():
                link.end()
            self._close_listeners()
            self._waker.close()

    def _close_listeners(self) -> None:
        for each in self._listeners:
            shut_down(each)  # ends the wait of its thread
            each.close()

    # --- in threads -------------------------------------------------------------------------

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                client, _ = listener.accept()
            except OSError as error:
                if self._is_closed or error.errno in (errno.EBADF, errno.EINVAL):
                    return
                time.sleep(0.1)  # no descriptor is left: wait for one
                continue
            self._begin(client)

    def _begin(self, client: socket.socket) -> None:
        with self._lock:
            try:
                if self._is_closed:
                    raise OSError(errno.EBADF, "closed")
                link = TapLink(client, self._clock)
            except OSError:  # or no descriptor is left
                client.close()
                return
            self._make_room()
            self._count += 1
            number = self._count
            self._links[number] = link
        thread = threading.Thread(target=self._follow, args=(number, link), daemon=True)
        try:
            thread.start()
        except RuntimeError:  # no thread is left
            self._end(number, link)

    def _make_room(self) -> None:
        """End the connection that has been idle longest, if there are as many as allowed."""
        if len(self._links) >= MAX_LINKS:
            longest = min(self._links, key=lambda number: self._links[number].active_at)
            self._links.pop(longest).end()

    def _follow(self, number: int, link: TapLink) -> None:
        try:
            link.connect(self._target)
            link.carry(partial(self._passed, number))
        except ModbusConnectionError as error:
            logger.warning("%s", error)
        except (OSError, Woken):
            pass
        finally:
            self._end(number, link)

    def _passed(self, number: int, sender: Direction, at: float, data: bytes) -> None:
        self._show(TimedBytes(number, sender, at, data))

    def _end(self, number: int, link: TapLink) -> None:
        with self._lock:
            self._links.pop(number, None)
            link.close()
        self._show(TimedBytes(number, "client", self._clock(), b""))

    def _show(self, piece: TimedBytes) -> None:
        with self._lock:
            cost = len(piece.data) + PIECE_COST
            if self._is_closed or self._unseen + cost > MAX_UNSEEN:
                return
            self._unseen += cost
            self._pieces.append(piece)
            self._waker.wake()
