"""
A TCP connection, made here and handed to libmodbus.

modbus_connect knows no host names, gives wrong errors, and aborts the process on
descriptors of 1024 and above (3.1.6).
"""

from __future__ import annotations

import errno
import socket

from ..binding.library import check, lib, make
from .socket_link import SocketLink

__all__ = ["TcpLink"]


class TcpLink(SocketLink):
    """A TCP connection; the arguments are those of `SocketLink`."""

    gone = ("closed by the other side", errno.ECONNRESET)
    kind = socket.SOCK_STREAM

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self.context = make(lib.modbus_new_tcp(b"127.0.0.1", lib.MODBUS_TCP_DEFAULT_PORT))

    def open(self, deadline: float) -> None:
        super().open(deadline)
        assert self._socket is not None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        check(lib.modbus_set_socket(self.context, self.descriptor))

    def abandon(self) -> None:
        if self._socket is not None:
            lib.modbus_set_socket(self.context, -1)
        super().abandon()

    def receive_many(self, deadline: float) -> list[bytes]:
        data = self._read(deadline, 1 << 16)
        assert self._socket is not None
        # A server that leaves Nagle's algorithm on, as libmodbus's own does, sends its next
        # answer only when this one is acknowledged: after 40 ms, unless told to do it at once.
        # The system forgets this setting, so it is made each time.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return [data] if data else []
