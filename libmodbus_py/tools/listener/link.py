"""
A connection through a tap: one of a client, and one to the device.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable

from ...ports.endpoint import Endpoint
from ...ports.sockets import TcpPort, keep_alive
from ...ports.waiting import Waker, milliseconds, run
from .separator import Direction

__all__ = ["Passed", "TapLink", "shut_down"]

Passed = Callable[[Direction, float, bytes], object]
"""Called with the sender, the time and the bytes, once they were passed on."""

CONNECT_TIMEOUT = 10.0

# Seconds without a byte after which a connection ends, as at a server (`Limits.idle_timeout`).
IDLE = 3600.0

# The same when one side has closed its direction, or takes no bytes.
LEAVING = 60.0

# Seconds of silence after which the system probes a side, as for clients.
KEEPALIVE = 30.0

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
