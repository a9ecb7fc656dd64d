"""
TCP connections and UDP sockets, made here.

modbus_connect knows no host names, gives wrong errors, and aborts the process on
descriptors of 1024 and above (3.1.6).
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import socket
import struct
import time
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ..protocol.checks import integer
from ..protocol.errors import MAX_RECEIVED, ModbusConnectionError
from .hosts import Resolve, host_and_port, own_address
from .port import RECEIVED_BYTES, Port, Silence, lost
from .waiting import WRITE, Ready, Steps, of_system, timed_out

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions

# Value of SO_LINGER: the end of the connection is a reset.
RESET = struct.pack("ii", 1, 0)

# The size of the first receive; later ones are larger. Python needs no malloc for few bytes.
FIRST_BYTES = 479

# Datagrams received in one turn.
DATAGRAMS = 64


class SocketPort(Port):
    """A socket that is connected to one address; `name` is that, for errors."""

    kind: ClassVar[socket.SocketKind]
    _socket: socket.socket
    _connecting: socket.socket | None = None

    def __init__(self, name: str) -> None:
        self.silence: Silence = Silence()
        self.resume_at: float | None = None  # all is sent at once: read often, never set
        self._name = name

    def __str__(self) -> str:
        return self._name

    def opening(self, deadline: float) -> Steps[None]:
        connection = yield from self._connected(deadline)
        try:
            yield from self._preparing(connection, deadline)
        except BaseException as error:
            connection.close()
            # Of an option, or of the descriptor itself.
            if isinstance(error, OSError) and not isinstance(error, ModbusConnectionError):
                raise self._cannot_connect(of_system(error)) from error
            raise
        self._socket, self._connecting = connection, None
        self._watch(connection.fileno())

    def _preparing(self, connection: socket.socket, deadline: float) -> Steps[None]:
        yield from ()

    def _connected(self, deadline: float) -> Steps[socket.socket]:
        """Connect to one address after the other; each gets its share of the time."""
        addresses = yield from self._addresses(deadline)
        last: OSError | None = None
        for number, (family, kind, protocol, _, address) in enumerate(addresses):
            now = time.monotonic()
            share = now + (deadline - now) / (len(addresses) - number)
            try:
                return (yield from self._reach(family, kind, protocol, address, share))
            except OSError as error:
                last = of_system(error)
        assert last is not None  # getaddrinfo gives one address or raises
        raise self._cannot_connect(last) from last

    def _reach(
        self, family: int, kind: int, protocol: int, address: Any, deadline: float
    ) -> Steps[socket.socket]:
        # A system may lack the family of an address, or have no descriptor left.
        connection = self._connecting = socket.socket(family, kind, protocol)
        try:
            connection.setblocking(False)
            self._bind(connection)
            number = connection.connect_ex(address)
            if number == errno.EINPROGRESS:
                if not (yield Ready(connection.fileno(), WRITE, deadline)):
                    raise timed_out()
                number = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if number:
                raise OSError(number, os.strerror(number))
            refuse_own(connection)
        except BaseException:
            connection.close()
            raise
        return connection

    def _bind(self, connection: socket.socket) -> None:
        """Bind a socket to the address that it is to connect from, if there is one."""

    def _cannot_connect(self, error: OSError) -> ModbusConnectionError:
        reason = os.strerror(error.errno) if error.errno else error
        return ModbusConnectionError(f"cannot connect to {self}: {reason}", errno=error.errno)

    @abstractmethod
    def _addresses(self, deadline: float) -> Steps[list[Any]]:
        """Return the addresses to try, as getaddrinfo returns them, or raise."""

    def close(self) -> None:
        """Close the connection; a process that only inherited it leaves that of its parent open."""
        self._release()

    def _release(self) -> None:
        """Forget the connection, and all bytes received over it."""
        if self.descriptor >= 0:
            self.descriptor = -1
            self._socket.close()

    def abandon(self) -> None:
        self._release()
        if self._connecting is not None:  # the steps of `opening` do not go on in a child
            self._connecting.close()
            self._connecting = None


def keep_alive(connection: socket.socket, seconds: float) -> None:
    """Make the system probe the other side of a TCP connection after so much silence."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (
        (socket.TCP_KEEPIDLE, math.ceil(seconds)),
        (socket.TCP_KEEPINTVL, math.ceil(seconds / 3)),
        (socket.TCP_KEEPCNT, 3),
    ):
        connection.setsockopt(socket.IPPROTO_TCP, option, value)


def refuse_own(connection: socket.socket) -> None:
    """Raise OSError (ECONNREFUSED) for a socket that is connected to itself (RFC 9293, 3.5)."""
    # Nothing listens on a port of this machine, and the system chose that port for the client.
    try:
        is_own = connection.getsockname()[:2] == connection.getpeername()[:2]
    except OSError as error:  # the other side has reset the connection already
        of_system(error)
        return
    if is_own:
        if (
            connection.type == socket.SOCK_STREAM
        ):  # reset: an orderly end keeps the port for a minute
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        raise OSError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))


class StreamPort(SocketPort):
    """A connection that carries a stream of bytes."""

    kind = socket.SOCK_STREAM

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._unsent = bytearray()

    def _preparing(self, connection: socket.socket, deadline: float) -> Steps[None]:
        self._unsent.clear()
        self.has_unsent: bool = False
        yield from ()

    def receive(self) -> list[bytes]:
        try:
            data = self._socket.recv(FIRST_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise lost(error) from error
        if not data:
            raise ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
        if len(data) == FIRST_BYTES:
            with contextlib.suppress(OSError):  # the next call reports the error again
                data += self._socket.recv(RECEIVED_BYTES)
        return [data]

    def send(self, adus: list[bytes], now: float) -> None:
        data = adus[0] if len(adus) == 1 else b"".join(adus)
        if self.has_unsent:
            self._unsent += data
            return
        try:
            count = self._socket.send(data)
        except BlockingIOError:
            count = 0
        except OSError as error:
            raise lost(error) from error
        if count < len(data):
            self._unsent += data[count:]
            self.has_unsent = True

    def go_on(self, now: float) -> None:
        unsent = bytes(self._unsent)
        self._unsent.clear()
        self.has_unsent = False
        StreamPort.send(self, [unsent], now)  # TLS has encrypted it


class HostPort(SocketPort):
    """A socket connected to one host and port, from a given source address or from any."""

    def __init__(self, host: str, port: int, source: str | None = None) -> None:
        if not isinstance(host, str):
            raise TypeError(f"host must be a string, not {type(host).__name__}")
        if not host.strip() or "\0" in host or "//" in host:
            raise ValueError(f"host must be a name or an address, not {host!r}")
        self.host = host
        self.port: int = integer("port", port, 1, 65535)
        super().__init__(host_and_port(host, port))
        self._source = None if source is None else own_address("source", source)

    def _bind(self, connection: socket.socket) -> None:
        if self._source is None:
            return
        _, address = self._source
        if self.kind == socket.SOCK_STREAM and address[1]:
            # Reset at its end: after an orderly one, its port could not connect for a minute.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        connection.bind(address)

    def _cannot_connect(self, error: OSError) -> ModbusConnectionError:
        cannot = super()._cannot_connect(error)
        if self._source is not None:
            cannot.args = (f"{cannot.args[0]} (from {host_and_port(*self._source[1])})",)
        return cannot

    def _addresses(self, deadline: float) -> Steps[list[Any]]:
        try:
            addresses: list[Any] = yield Resolve(self.host, self.port, self.kind, deadline)
        except OSError as error:
            late = isinstance(error, TimeoutError)
            reason = "it takes too long" if late else error.strerror or error
            raise ModbusConnectionError(
                f"cannot resolve host {self.host!r}: {reason}",
                errno=errno.ETIMEDOUT if late else error.errno,
            ) from error
        if self._source is not None:
            addresses = [address for address in addresses if address[0] == self._source[0]]
            if not addresses:
                raise self._cannot_connect(OSError(errno.EAFNOSUPPORT, ""))
        return addresses


class TcpPort(HostPort, StreamPort):
    """A TCP connection."""

    @classmethod
    def of(cls, endpoint: Endpoint, settings: ConnectionOptions) -> Self:
        port = cls(endpoint.host, endpoint.port, settings["keepalive"], settings["source"])
        port.silence = Silence(endpoint.options.get("silence") or 0.0)  # of a line behind it
        return port

    def __init__(
        self, host: str, port: int, keepalive: float | None, source: str | None = None
    ) -> None:
        super().__init__(host, port, source)
        self._keepalive = keepalive

    def _preparing(self, connection: socket.socket, deadline: float) -> Steps[None]:
        yield from super()._preparing(connection, deadline)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._keepalive is not None:
            keep_alive(connection, self._keepalive)

    def acknowledge(self) -> None:
        # A server that leaves Nagle's algorithm on, as libmodbus's own does, sends its next
        # answer only when this one is acknowledged: after 40 ms, unless told to do it at once.
        # The system forgets this setting, so it is made each time.
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except OSError as error:
            of_system(error)


class UdpPort(HostPort):
    """A UDP socket that receives from one host only; one ADU in each datagram."""

    kind = socket.SOCK_DGRAM

    @classmethod
    def of(cls, endpoint: Endpoint, settings: ConnectionOptions) -> Self:
        return cls(endpoint.host, endpoint.port, settings["source"])

    def _preparing(self, connection: socket.socket, deadline: float) -> Steps[None]:
        yield from super()._preparing(connection, deadline)
        self._refusal = 0  # the errno of the last refusal

    def receive(self) -> list[bytes]:
        datagrams: list[bytes] = []
        for _ in range(DATAGRAMS):
            try:
                datagram = self._socket.recv(MAX_RECEIVED)
            except BlockingIOError:
                break
            except OSError as error:  # ICMP reported a closed port
                if self._refusal:
                    break
                self._refusal = of_system(error).errno or errno.EIO
            else:
                if datagram:  # an empty datagram is ignored
                    datagrams.append(datagram)
        if self._refusal:
            # The system tells it once, and before what was received earlier, which is worth
            # more: the news that the port is closed now comes with the next look.
            if not datagrams:
                raise lost(OSError(self._refusal, os.strerror(self._refusal)))
            self._socket.shutdown(socket.SHUT_RD)  # wakes a program that waits for the socket
        return datagrams

    def send(self, adus: list[bytes], now: float) -> None:
        for adu in adus:
            try:
                self._send_now(adu)
            except BlockingIOError:
                return  # lost, as any datagram may be
            except OSError as error:
                raise lost(error) from error

    def _send_now(self, adu: bytes) -> None:
        try:
            self._socket.send(adu)
        except ConnectionRefusedError:
            # Of an earlier one; answers to others may still wait to be read. If the port is
            # closed now, the next look says so.
            self._socket.send(adu)
