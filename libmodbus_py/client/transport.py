"""
What carries the bytes of the asyncio client: a TCP connection, a UDP socket, a serial port.

A transport is opened and closed any number of times. It never waits except in `open`:
what cannot be sent at once goes out by and by, what has not come is not there yet.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import math
import os
import socket
import time
from collections.abc import Iterator
from typing import Any, Protocol

from ..ports.link import lost
from ..ports.serial import SerialLink
from ..protocol.errors import ModbusConnectionError, ModbusTimeoutError

__all__ = ["SerialTransport", "TcpTransport", "Transport", "UdpTransport"]

# As much as the answers to all requests that are usually in flight.
READ_SIZE = 65536

# Datagrams taken in one turn of the loop.
DATAGRAMS = 64


class Transport(Protocol):
    """
    What the three have in common.

    Attributes:
        descriptor: for the event loop, while open.
        can_die_silently: whether it may seem open when the other side is gone.
    """

    can_die_silently: bool

    @property
    def descriptor(self) -> int: ...

    async def open(self, timeout: float) -> None:
        """Raises ModbusConnectionError."""

    def receive(self) -> list[bytes]:
        """Give what has come. Raises ModbusConnectionError: it is closed or gone."""

    def send(self, adus: list[bytes]) -> None:
        """Raises ModbusConnectionError."""

    def time_to_silence(self) -> float:
        """Give the seconds until the line may be sent on."""

    def close(self) -> None:
        """Any number of times."""


class TcpTransport:
    """
    A TCP connection.

    Args:
        host, port: a name with all its addresses, or an address.
        keepalive: seconds of silence before the system probes the other side; None
            for never.
    """

    can_die_silently = True

    def __init__(self, host: str, port: int, keepalive: float | None) -> None:
        self._host = host
        self._port = port
        self._keepalive = keepalive
        self._socket: socket.socket | None = None
        self._unsent = bytearray()

    def __str__(self) -> str:
        return _place(self._host, self._port)

    @property
    def descriptor(self) -> int:
        return -1 if self._socket is None else self._socket.fileno()

    async def open(self, timeout: float) -> None:
        self._loop = asyncio.get_running_loop()
        deadline = self._loop.time() + timeout
        self._unsent.clear()
        self._socket = await _connect(self._host, self._port, socket.SOCK_STREAM, deadline)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._keepalive is not None:
            interval = math.ceil(self._keepalive / 3)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, value in (
                (socket.TCP_KEEPIDLE, math.ceil(self._keepalive)),
                (socket.TCP_KEEPINTVL, interval),
                (socket.TCP_KEEPCNT, 3),
            ):
                self._socket.setsockopt(socket.IPPROTO_TCP, option, value)

    def receive(self) -> list[bytes]:
        assert self._socket is not None
        try:
            data = self._socket.recv(READ_SIZE)
            # The system falls back to delayed acknowledgements by itself, and a server
            # without TCP_NODELAY, libmodbus's own, holds its next answer until one comes.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except BlockingIOError:
            return []
        except OSError as error:
            raise lost(error) from error
        if not data:
            raise ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
        return [data]

    def send(self, adus: list[bytes]) -> None:
        data = b"".join(adus)
        if self._unsent:
            self._unsent += data
            return
        sent = self._send_now(data)
        if sent < len(data):
            self._unsent += data[sent:]
            self._loop.add_writer(self.descriptor, self._send_unsent)

    def _send_now(self, data: bytes | bytearray) -> int:
        assert self._socket is not None
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise lost(error) from error

    def _send_unsent(self) -> None:
        try:
            del self._unsent[: self._send_now(self._unsent)]
        except ModbusConnectionError:
            self._unsent.clear()  # the loss shows in the next read, too
        if not self._unsent:
            self._loop.remove_writer(self.descriptor)

    def time_to_silence(self) -> float:
        return 0.0

    def close(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            self._loop.remove_writer(connection.fileno())
            connection.close()


class UdpTransport:
    """A UDP socket that knows one peer only; one ADU in each datagram."""

    can_die_silently = False

    def __init__(self, host: str, port: int) -> None:
        self._host = host
        self._port = port
        self._socket: socket.socket | None = None

    def __str__(self) -> str:
        return _place(self._host, self._port)

    @property
    def descriptor(self) -> int:
        return -1 if self._socket is None else self._socket.fileno()

    async def open(self, timeout: float) -> None:
        deadline = asyncio.get_running_loop().time() + timeout
        self._socket = await _connect(self._host, self._port, socket.SOCK_DGRAM, deadline)

    def receive(self) -> list[bytes]:
        assert self._socket is not None
        datagrams: list[bytes] = []
        try:
            while len(datagrams) < DATAGRAMS:
                datagrams.append(self._socket.recv(READ_SIZE))
        except BlockingIOError:
            pass
        except OSError as error:
            raise lost(error) from error
        return datagrams

    def send(self, adus: list[bytes]) -> None:
        assert self._socket is not None
        for adu in adus:
            try:
                self._socket.send(adu)
            except BlockingIOError:
                return  # lost, as any datagram may be
            except OSError as error:
                raise lost(error) from error

    def time_to_silence(self) -> float:
        return 0.0

    def close(self) -> None:
        endpoint, self._socket = self._socket, None
        if endpoint is not None:
            endpoint.close()


class SerialTransport:
    """A serial port; libmodbus opens and configures it."""

    can_die_silently = False

    def __init__(self, link: SerialLink) -> None:
        self._link = link
        self._sending: Iterator[float] | None = None
        self._pause: asyncio.TimerHandle | None = None

    def __str__(self) -> str:
        return str(self._link)

    @property
    def descriptor(self) -> int:
        return self._link.descriptor

    async def open(self, timeout: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._link.open(time.monotonic())

    def receive(self) -> list[bytes]:
        data = self._link.receive(0)
        return [data] if data else []

    def send(self, adus: list[bytes]) -> None:
        self._sending = self._link.sending(b"".join(adus), time.monotonic())
        self._send_on()

    def _send_on(self) -> None:
        """Go on until the next pause: the line is turned round while others run."""
        assert self._sending is not None
        self._pause = None
        # A port that takes no bytes: it is the missing answer that tells.
        with contextlib.suppress(ModbusTimeoutError):
            pause = next(self._sending, None)
            if pause is not None:
                self._pause = self._loop.call_later(pause, self._send_later)

    def _send_later(self) -> None:
        with contextlib.suppress(ModbusConnectionError):  # the next read says so, too
            self._send_on()

    def time_to_silence(self) -> float:
        if self._pause is not None:
            return max(0.0, self._pause.when() - self._loop.time()) + self._link.character
        return self._link.time_to_silence()

    def close(self) -> None:
        if self._pause is not None:
            self._pause.cancel()
        self._sending = self._pause = None  # RTS goes back while the port is still open
        self._link.close()


async def _connect(host: str, port: int, kind: socket.SocketKind, deadline: float) -> socket.socket:
    """Try one address after the other; each gets its share of the time."""
    addresses = await _resolve(host, port, kind)
    loop = asyncio.get_running_loop()
    last: OSError | None = None
    for number, (family, type_, protocol, _, address) in enumerate(addresses):
        share = (deadline - loop.time()) / (len(addresses) - number)
        try:
            async with asyncio.timeout(share):
                return await _connect_one(family, type_, protocol, address)
        except OSError as error:
            last = error
    assert last is not None  # getaddrinfo gives one address or raises
    number = errno.ETIMEDOUT if isinstance(last, TimeoutError) else last.errno or 0
    text = os.strerror(number) if number else str(last)
    raise ModbusConnectionError(
        f"cannot connect to {_place(host, port)}: {text}", errno=number or None
    ) from last


async def _connect_one(family: int, kind: int, protocol: int, address: Any) -> socket.socket:
    connection = socket.socket(family, kind, protocol)
    try:
        connection.setblocking(False)
        await asyncio.get_running_loop().sock_connect(connection, address)
    except BaseException:
        connection.close()
        raise
    return connection


async def _resolve(host: str, port: int, kind: socket.SocketKind) -> list[Any]:
    try:
        # An address needs no look-up, and so no thread.
        return socket.getaddrinfo(host, port, type=kind, flags=socket.AI_NUMERICHOST)
    except (OSError, UnicodeError):
        pass
    try:
        return await asyncio.get_running_loop().getaddrinfo(host, port, type=kind)
    except (OSError, UnicodeError) as error:
        number = getattr(error, "errno", None)
        text = getattr(error, "strerror", None) or error
        raise ModbusConnectionError(
            f"cannot resolve host {host!r}: {text}", errno=number
        ) from error


def _place(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
