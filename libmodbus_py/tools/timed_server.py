"""
A TCP server with a thread and a limited time for each connection: for pages, taps and metrics.
"""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
import socketserver
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any, Self, cast

from ..ports.hosts import host_and_port, listen_on, start_thread
from ..protocol.logs import HarmlessLogger

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds between two looks for connections whose time is over; the server ends as soon.
SWEEP = 0.2

MOST_CONNECTIONS = 64


class TimedServer(socketserver.ThreadingMixIn, socketserver.TCPServer):
    """
    A TCP server that closes each connection after `limit` seconds, however slowly its client sends.

    When there are `MOST_CONNECTIONS`, the oldest one with a limit makes room for a new one, which
    is closed if there is none. It listens on all `addresses` of the host, at one `port`; `place` is
    "http://HOST:PORT". `is_closed` is True once `serving` ends.
    """

    def __init__(self, host: str, port: int, handler: Any, limit: float) -> None:
        self._limit = limit
        # Socket -> when it is closed; None for connections without a limit.
        self._open: dict[socket.socket, float | None] = {}
        self._lock = threading.Lock()
        self.is_closed: bool = False
        super().__init__((host, port), handler, bind_and_activate=False)
        self.socket.close()  # a TCPServer has one socket, and this one as many as addresses
        self._listeners = listen_on(host, port)
        self._ready = selectors.DefaultSelector()
        for listener in self._listeners:
            listener.setblocking(False)  # another thread may have taken the connection
            self._ready.register(listener, selectors.EVENT_READ)
        names = [listener.getsockname() for listener in self._listeners]
        self.addresses: list[str] = [name[0] for name in names]
        self.port: int = names[0][1]
        self.server_address = names[0]
        self.place: str = f"http://{host_and_port(host, self.port)}"

    @contextlib.contextmanager
    def serving(self, name: str) -> Iterator[Self]:
        """Serve in a thread of this name while the block runs, and close everything."""
        thread = threading.Thread(target=self.serve_forever, args=(SWEEP,), name=name, daemon=True)
        try:
            start_thread(thread)
            try:
                yield self
            finally:
                self.shutdown()
                thread.join()
        finally:
            self.is_closed = True
            with self._lock:
                connections = list(self._open)
            for connection in connections:
                _cut(connection)
            self.server_close()

    def fileno(self) -> int:
        """Return a descriptor that is ready when a connection waits on any address."""
        return self._ready.fileno()

    def get_request(self) -> tuple[socket.socket, Any]:
        for key, _ in self._ready.select(0):
            try:
                request, address = cast(socket.socket, key.fileobj).accept()
            except OSError as error:
                if error.errno in (errno.EMFILE, errno.ENFILE):
                    time.sleep(SWEEP)  # until a descriptor is free
                raise
            request.setblocking(True)
            return request, address
        raise BlockingIOError("no connection waits any more")

    def server_close(self) -> None:
        for listener in self._listeners:
            listener.close()
        self._ready.close()
        super().server_close()

    def keep(self, request: socket.socket, limit: float | None = None) -> None:
        """Set the limit of a connection from now on; None for none: it is closed at the end."""
        with self._lock:
            self._open.pop(request, None)  # the oldest is the first
            self._open[request] = None if limit is None else time.monotonic() + limit

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._lock:
            if len(self._open) >= MOST_CONNECTIONS:
                connections = (connection for connection, until in self._open.items() if until)
                oldest = next(connections, request)
                _cut(oldest)  # its thread ends, and closes it
                self._open.pop(oldest, None)
            self._open[request] = time.monotonic() + self._limit
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        now = time.monotonic()
        with self._lock:
            late = [connection for connection, until in self._open.items() if until and until < now]
        for connection in late:
            _cut(connection)

    def handle_error(self, request: object, client_address: object) -> None:
        """Log an exception of a connection's thread, unless it means that the client has gone."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            logger.exception("a connection ended with an error")


def _cut(request: socket.socket) -> None:
    with contextlib.suppress(OSError):  # it is over already
        request.shutdown(socket.SHUT_RDWR)
