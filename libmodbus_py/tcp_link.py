"""
A TCP connection, made here and handed to libmodbus.

modbus_connect knows no host names, gives wrong errors, and aborts the process on
descriptors of 1024 and above (3.1.6).
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time

from ._c import check, lib, make
from .arguments import integer
from .errors import ModbusConnectionError
from .link import Link

__all__ = ["TcpLink"]


class TcpLink(Link):
    """
    A TCP connection.

    Args:
        host: a name, an IPv4 or an IPv6 address.
        port: 1..65535.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    can_die_silently = True
    gone = ("closed by the other side", errno.ECONNRESET)

    def __init__(self, host: str, port: int) -> None:
        if not isinstance(host, str):
            raise TypeError(f"host must be a string, not {type(host).__name__}")
        if not host.strip() or "\0" in host:
            raise ValueError(f"host must be a name or an address, not {host!r}")
        self.host = host
        self.port = integer("port", port, 1, 65535)
        self.context = make(lib.modbus_new_tcp(b"127.0.0.1", lib.MODBUS_TCP_DEFAULT_PORT))
        self._socket: socket.socket | None = None

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def open(self, deadline: float) -> None:
        connection = self._connect(deadline)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        connection.setblocking(False)
        self._socket = connection
        self._watch(connection.fileno())
        check(lib.modbus_set_socket(self.context, self.descriptor))

    def _connect(self, deadline: float) -> socket.socket:
        try:
            addresses = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            number = getattr(error, "errno", None)
            text = getattr(error, "strerror", None) or error
            raise ModbusConnectionError(
                f"cannot resolve host {self.host!r}: {text}", errno=number
            ) from error
        last: OSError | None = None
        for *_, address in addresses:
            left = max(0.001, deadline - time.monotonic())
            try:
                return socket.create_connection((str(address[0]), self.port), left)
            except OSError as error:
                last = error
        assert last is not None  # getaddrinfo gives one address or raises
        number = errno.ETIMEDOUT if isinstance(last, TimeoutError) else last.errno
        text = os.strerror(number) if number else str(last)
        raise ModbusConnectionError(f"cannot connect to {self}: {text}", errno=number) from last

    def interrupt(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.interrupt()
        self.abandon()

    def abandon(self) -> None:
        connection, self._socket, self.descriptor = self._socket, None, -1
        if connection is not None:
            lib.modbus_set_socket(self.context, -1)
            connection.close()

    def discard_input(self) -> None:
        with contextlib.suppress(ModbusConnectionError):
            while self.receive(0):
                pass

    def _write(self, data: bytes) -> int:
        assert self._socket is not None
        return self._socket.send(data)

    def wait_for_silence(self) -> None:
        """TCP may always be sent on."""

    def note_traffic(self) -> None:
        """Nothing depends on it."""
