"""
The sources of bytes, with the time of each piece: a serial port, or a tap.

Clients connect to a tap, and it connects to the device. Every connection has its own thread, which
passes bytes on before it keeps them for the listener, so that a slow listener does not delay a
device.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

from ...ports.endpoint import Endpoint
from ...ports.hosts import reason
from ...ports.sockets import keep_alive, refuse_own
from ...ports.waiting import Waker, milliseconds
from ...protocol.errors import ModbusConnectionError
from ...protocol.logs import HarmlessLogger
from ..timed_server import TimedServer
from .separator import Direction

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds before connecting to the device times out.
CONNECT_TIMEOUT = 10.0

# Seconds without a byte after which a connection ends, as at a server (`Limits.idle_timeout`).
IDLE = 3600.0

LEAVING = 60.0  # the same, once one side has sent its last byte or takes no bytes
KEEPALIVE = 30.0  # seconds of silence after which the system probes a side, as for clients
READ_SIZE = 65_536  # bytes that are read at once

# The most bytes that are kept for the listener; further bytes are passed on without being kept.
MAX_UNSEEN = 1 << 20

# The bytes of memory that a piece takes in addition to its own.
PIECE_COST = 100


class TimedBytes(NamedTuple):
    """Bytes that a connection received together, none at its end."""

    link: int  # 0 for a serial line
    sender: Direction | None  # None for a serial line
    at: float
    data: bytes


class SerialSource:
    """A serial port that is only read; `descriptor` is readable when there are bytes."""

    def __init__(self, endpoint: Endpoint, clock: Callable[[], float]) -> None:
        from ...ports.serial import ReadOnlySerialPort  # which not every system has

        self._port = ReadOnlySerialPort(endpoint.path, **endpoint.serial_settings)
        self._clock = clock
        self.open = self._port.open
        self.close = self._port.close

    @property
    def descriptor(self) -> int:
        return self._port.descriptor

    def receive(self) -> list[TimedBytes]:
        return [TimedBytes(0, None, self._clock(), data) for data in self._port.receive()]


class Tap(TimedServer):
    """A source of the bytes between clients of an endpoint and a device."""

    daemon_threads = True  # `close` does not wait for connections that are being established

    def __init__(self, endpoint: Endpoint, target: Endpoint, clock: Callable[[], float]) -> None:
        self._target = target
        self._clock = clock
        self._numbers = count(1)
        self._unseen_lock = threading.Lock()
        self._pieces: deque[TimedBytes] = deque()
        self._unseen = 0
        self._stack = contextlib.ExitStack()
        self._process = os.getpid()
        try:
            self._waker = Waker()
            self._stack.callback(self._waker.close)
            super().__init__(endpoint.host, endpoint.port, None, IDLE)
            self._stack.enter_context(self.serving("tap"))
        except OSError as error:
            self._stack.close()
            raise ModbusConnectionError(
                f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
            ) from error
        self.descriptor: int = self._waker.descriptor
        self.endpoint: Endpoint = Endpoint(endpoint.scheme, host=endpoint.host, port=self.port)

    def open(self) -> None:
        """Do nothing: the tap is open."""

    def receive(self) -> list[TimedBytes]:
        """Return the bytes that have passed, oldest first; an empty piece ends a connection."""
        with self._unseen_lock:
            self._waker.clear()
            pieces, self._pieces = self._pieces, deque()
            self._unseen = 0
        return list(pieces)

    def close(self) -> None:
        """Close all connections; any number of times. In a forked child, only its copies."""
        if os.getpid() == self._process:
            self._stack.close()
        else:
            self.server_close()

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Connect to the device, and pass bytes on, until both sides have ended, or are idle."""
        number = next(self._numbers)
        with contextlib.ExitStack() as stack:
            try:
                place = self._target.host, self._target.port
                device = stack.enter_context(socket.create_connection(place, CONNECT_TIMEOUT))
                refuse_own(device)
            except (OSError, UnicodeError) as error:  # the host cannot be a name, such as a..b
                logger.warning("cannot connect to %s: %s", self._target, reason(error))
                return
            with contextlib.suppress(OSError):  # a side is gone, or takes no bytes
                self._carry(number, request, device)
        self._show(TimedBytes(number, "client", self._clock(), b""))

    def _carry(self, number: int, client: socket.socket, device: socket.socket) -> None:
        ways: dict[int, tuple[Direction, socket.socket, socket.socket]] = {
            client.fileno(): ("client", client, device),
            device.fileno(): ("server", device, client),
        }
        poll = select.poll()
        for end in (client, device):
            end.settimeout(LEAVING)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            keep_alive(end, KEEPALIVE)
            poll.register(end, select.POLLIN)
        while ways:
            ready = poll.poll(milliseconds(IDLE if len(ways) == 2 else LEAVING))
            if not ready:
                return
            self.keep(client, IDLE)
            for descriptor, events in ready:
                sender, source, sink = ways[descriptor]
                data = source.recv(READ_SIZE)
                at = self._clock()
                if data:
                    sink.sendall(data)
                    self._show(TimedBytes(number, sender, at, data))
                elif events & select.POLLHUP:  # both directions have ended, or the server cut it
                    return
                else:
                    poll.unregister(descriptor)
                    del ways[descriptor]
                    sink.shutdown(socket.SHUT_WR)

    def _show(self, piece: TimedBytes) -> None:
        with self._unseen_lock:
            cost = len(piece.data) + PIECE_COST
            if self._unseen + cost > MAX_UNSEEN:
                return
            self._unseen += cost
            self._pieces.append(piece)
            self._waker.wake()
