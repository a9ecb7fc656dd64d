"""
A UDP socket that hears one host only.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket

from ..protocol.errors import ModbusConnectionError
from .link import lost
from .socket_link import SocketLink

__all__ = ["UdpLink"]

# Deadlines are looked at in between, however many there are.
MAX_AT_ONCE = 64


class UdpLink(SocketLink):
    """
    A connected UDP socket; the arguments are those of `SocketLink`.

    What others send never arrives, and a port where nobody listens is a
    ModbusConnectionError as soon as its host says so (ICMP).
    """

    gone = ("closed while it was waited on", errno.ESHUTDOWN)
    kind = socket.SOCK_DGRAM
    datagrams = True
    context = None
    _interrupted = False

    def prepare(self, timeout: float) -> None:
        """libmodbus has no part in it."""

    def open(self, deadline: float) -> None:
        self._interrupted = False
        super().open(deadline)

    def interrupt(self) -> None:
        # A socket that was shut down looks readable for ever, with nothing to read.
        self._interrupted = True
        super().interrupt()

    def receive(self, deadline: float) -> bytes:
        """Give one datagram; nothing for an empty one, or if the deadline passes."""
        if not self._wait(select.POLLIN, deadline):
            return b""
        if self._interrupted:
            raise ModbusConnectionError(self.gone[0], errno=self.gone[1])
        try:
            return os.read(self.descriptor, 1 << 16)
        except BlockingIOError:  # a datagram with a wrong checksum
            return b""
        except OSError as error:
            raise lost(error) from error

    def receive_many(self, deadline: float) -> list[bytes]:
        found = [self.receive(deadline)]
        # What was received is worth more than the news that the port is closed now.
        with contextlib.suppress(ModbusConnectionError):
            while found[-1] and len(found) < MAX_AT_ONCE:
                found.append(self.receive(0))
        return [data for data in found if data]

    def send_many(self, adus: list[bytes], deadline: float) -> None:
        for adu in adus:
            self.send(adu, deadline)
