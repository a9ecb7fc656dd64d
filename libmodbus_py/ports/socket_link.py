"""
What a TCP connection and a UDP socket have in common.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
from typing import ClassVar

from ..protocol.checks import integer
from ..protocol.errors import ModbusConnectionError
from .link import Link

__all__ = ["SocketLink"]


class SocketLink(Link):
    """
    A socket that is connected to one host and port.

    Args:
        host: a name, an IPv4 or an IPv6 address.
        port: 1..65535.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    can_die_silently = True
    kind: ClassVar[socket.SocketKind]

    def __init__(self, host: str, port: int) -> None:
        if not isinstance(host, str):
            raise TypeError(f"host must be a string, not {type(host).__name__}")
        if not host.strip() or "\0" in host:
            raise ValueError(f"host must be a name or an address, not {host!r}")
        self.host = host
        self.port = integer("port", port, 1, 65535)
        self._socket: socket.socket | None = None

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def open(self, deadline: float) -> None:
        connection = self._connect(deadline)
        connection.setblocking(False)
        self._socket = connection
        self._watch(connection.fileno())

    def _connect(self, deadline: float) -> socket.socket:
        try:
            found = socket.getaddrinfo(self.host, self.port, type=self.kind)
        except (OSError, UnicodeError) as error:
            number = getattr(error, "errno", None)
            text = getattr(error, "strerror", None) or error
            raise ModbusConnectionError(
                f"cannot resolve host {self.host!r}: {text}", errno=number
            ) from error
        last: OSError | None = None
        for family, kind, protocol, _, address in found:
            try:
                return _connected(socket.socket(family, kind, protocol), address, deadline)
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
            connection.close()

    def discard_input(self) -> None:
        with contextlib.suppress(ModbusConnectionError):
            while self.receive(0):
                pass

    def _write(self, data: bytes) -> int:
        assert self._socket is not None
        return self._socket.send(data)

    def wait_for_silence(self) -> None:
        """A network may always be sent on."""

    def note_traffic(self) -> None:
        """Nothing depends on it."""


def _connected(made: socket.socket, address: tuple[object, ...], deadline: float) -> socket.socket:
    try:
        made.settimeout(max(0.001, deadline - time.monotonic()))
        made.connect(address)
    except BaseException:
        made.close()
        raise
    return made
