"""
A tap between clients and a device: clients connect to it, and it connects to the device.

Every connection has a thread of its own that passes bytes on before it keeps them for the listener,
so that a slow listener delays no device.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable

from ...ports.endpoint import Endpoint
from ...ports.listening import listen_on, reason
from ...ports.names import start_thread
from ...ports.waiting import Waker
from ...protocol.errors import ModbusConnectionError
from .separator import Direction
from .source import TimedBytes

__all__ = ["MAX_LINKS", "Tap"]

logger: logging.Logger = logging.getLogger(__name__)

# The number of connections at once; more are refused.
MAX_LINKS = 64

# Bytes that are kept for the listener; more are passed on without being kept.
MAX_UNSEEN = 1 << 20

# The memory of a piece apart from its bytes.
PIECE_COST = 100

CONNECT_TIMEOUT = 10.0

READ_SIZE = 65_536


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
        self._links: dict[int, tuple[socket.socket, ...]] = {}
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
            for ends in self._links.values():
                for end in ends:
                    _shut_down(end)
            self._close_listeners()
            self._waker.close()

    def _close_listeners(self) -> None:
        for each in self._listeners:
            _shut_down(each)  # which ends the wait of its thread
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
            if self._is_closed or len(self._links) >= MAX_LINKS:
                client.close()
                return
            self._count += 1
            number = self._count
            self._links[number] = (client,)
        thread = threading.Thread(target=self._link, args=(number, client), daemon=True)
        try:
            thread.start()
        except RuntimeError:  # no thread is left
            self._end(number, client)

    def _link(self, number: int, client: socket.socket) -> None:
        ends = [client]
        try:
            place = self._target.host, self._target.port
            server = socket.create_connection(place, timeout=CONNECT_TIMEOUT)
            ends.append(server)
            with self._lock:
                if self._is_closed:
                    return
                self._links[number] = client, server
            for end in ends:
                end.settimeout(None)
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                end.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            self._carry(number, client, server)
        except OSError as error:
            if not self._is_closed and len(ends) == 1:
                logger.warning("cannot connect to %s: %s", self._target, error)
        finally:
            self._end(number, *ends)

    def _carry(self, number: int, client: socket.socket, server: socket.socket) -> None:
        poll = select.poll()
        ways: dict[int, tuple[Direction, socket.socket, socket.socket]] = {
            client.fileno(): ("client", client, server),
            server.fileno(): ("server", server, client),
        }
        for descriptor in ways:
            poll.register(descriptor, select.POLLIN)
        while ways:
            for descriptor, _ in poll.poll():
                sender, source, sink = ways[descriptor]
                data = source.recv(READ_SIZE)
                at = self._clock()
                if not data:
                    poll.unregister(descriptor)
                    del ways[descriptor]
                    _shut_down(sink, socket.SHUT_WR)
                    continue
                sink.sendall(data)
                self._show(TimedBytes(number, sender, at, data))

    def _end(self, number: int, *ends: socket.socket) -> None:
        with self._lock:
            self._links.pop(number, None)
            for end in ends:
                end.close()
        self._show(TimedBytes(number, "client", self._clock(), b""))

    def _show(self, piece: TimedBytes) -> None:
        with self._lock:
            cost = len(piece.data) + PIECE_COST
            if self._is_closed or self._unseen + cost > MAX_UNSEEN:
                return
            self._unseen += cost
            self._pieces.append(piece)
            self._waker.wake()


def _shut_down(end: socket.socket, how: int = socket.SHUT_RDWR) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(how)
