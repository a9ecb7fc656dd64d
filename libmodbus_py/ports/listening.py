"""
Ports at which a client waits for its device, because the device connects: a modem behind a mobile
network has no address that others reach.

The client listens from its first request on until it is closed, for one device. Waiting for the
device is connecting to it. A new connection replaces the one before, which is dead then, though the
network may never tell so.

Such devices send bytes that are no Modbus: a registration packet when one has connected, and
heartbeats. Makers of modems describe both alike: a fixed text, often the number of the SIM card or
the modem (ICCID, IMEI), sent once, or before all data; and a fixed text at intervals. Frames are
passed on whole: a text counts only where a frame may begin or, without a header that tells its end,
where the received bytes end.
"""

from __future__ import annotations

import errno
import select
import socket
from typing import TYPE_CHECKING, Any, Self

from ..protocol.errors import ModbusConnectionError
from ..protocol.frames import UNIT
from .hosts import own_address, reason, tcp_listener
from .options import greeting_of
from .port import Silence
from .sockets import TcpPort
from .waiting import READ, Ready, Steps, of_system

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions


class Greeting:
    """Drops what is no Modbus from the bytes of one device."""

    def __init__(self, count: int, texts: tuple[bytes, ...], *, has_header: bool) -> None:
        self._texts = texts
        self._count = count
        self._has_header = has_header
        self.begin()

    def begin(self) -> None:
        self._first = self._count  # how many bytes are still to be dropped
        self._kept = b""  # what may be the beginning of a text or a header
        self._frame = 0  # how many bytes of the current frame are still to come

    def expect_frame(self) -> None:
        """Note that a frame may begin, because what came before was none."""
        self._frame = 0

    def drop(self, data: bytes) -> bytes:
        """Return the received bytes that belong to frames."""
        count = min(self._first, len(data))
        self._first -= count
        data = self._kept + data[count:]
        if not self._texts:
            return data
        self._kept = b""
        frames = b""
        while data:
            if self._frame:
                frames += data[: self._frame]
                self._frame, data = max(0, self._frame - len(data)), data[self._frame :]
            elif text := next(filter(data.startswith, self._texts), b""):
                data = data[len(text) :]
            elif any(text.startswith(data) for text in self._texts):
                self._kept, data = data, b""
            elif not self._has_header:
                return self._without_end(data)
            elif len(data) < UNIT:
                self._kept, data = data, b""
            else:
                # The length field, before the unit, counts the bytes from the unit on.
                self._frame = UNIT + int.from_bytes(data[4:UNIT])
        return frames

    def _without_end(self, data: bytes) -> bytes:
        while text := next(filter(data.endswith, self._texts), b""):
            data = data[: -len(text)]
        return data


class ListeningPort(TcpPort):
    """A TCP connection that the device has made, and the socket at which it makes the next one."""

    _listener: socket.socket | None = None
    _next: socket.socket | None = None  # a connection that replaces the open one

    @classmethod
    def of(cls, endpoint: Endpoint, settings: ConnectionOptions) -> Self:
        count, texts = greeting_of("greeting", settings["greeting"] or "0 bytes")
        greeting = Greeting(count, texts, has_header=endpoint.framing == "tcp")
        port = cls(endpoint.host, endpoint.port, settings["keepalive"], greeting)
        port.silence = Silence(
            endpoint.options.get("silence") or 0.0
        )  # of the line, if the device is a gateway
        return port

    def __init__(self, host: str, port: int, keepalive: float | None, greeting: Greeting) -> None:
        super().__init__(host, port, keepalive)
        own_address(f"{self}: the host to listen at", host)
        self._greeting = greeting

    def _connected(self, deadline: float) -> Steps[socket.socket]:
        if self._listener is None:
            self._listener = self._listen()
        while (connection := self._newest()) is None:
            if not (yield Ready(self._listener.fileno(), READ, deadline)):
                text = f"no device has connected to {self}"
                raise ModbusConnectionError(text, errno=errno.ETIMEDOUT)
        return connection

    def _listen(self) -> socket.socket:
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            listener = tcp_listener(family, (self.host, self.port))
        except OSError as error:
            text = f"cannot listen at {self}: {reason(of_system(error))}"
            raise ModbusConnectionError(text, errno=error.errno) from error
        listener.setblocking(False)
        return listener

    def _newest(self) -> socket.socket | None:
        """Return the latest connection, and close earlier ones; None without any."""
        newest, self._next = self._next, None
        while self._listener is not None:
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                break
            except ConnectionAbortedError:
                continue
            except OSError as error:
                self._next = newest
                raise self._cannot_connect(of_system(error)) from error
            if newest is not None:
                newest.close()
            connection.setblocking(False)
            newest = connection
        return newest

    def _preparing(self, connection: socket.socket, deadline: float) -> Steps[None]:
        self._greeting.begin()
        self._is_asked = False  # bytes before the first request answer no request
        return super()._preparing(connection, deadline)

    def _watch(self, descriptor: int) -> None:
        super()._watch(descriptor)
        assert self._listener is not None
        self._poll.register(self._listener.fileno(), select.POLLIN)

    def receive(self) -> list[bytes]:
        chunks = super().receive()
        if not chunks:  # no bytes came, so the listener is ready
            self._next = self._newest()
            if self._next is not None:
                text = "the device has connected again"
                raise ModbusConnectionError(text, errno=errno.ECONNRESET)
        frames = self._greeting.drop(b"".join(chunks))
        return [frames] if frames and self._is_asked else []

    def send(self, adus: list[bytes], now: float) -> None:
        if not self._is_asked:
            self._is_asked = True
            self._greeting.expect_frame()
        super().send(adus, now)

    def shut(self) -> None:
        super().shut()
        self._stop_listening()

    def abandon(self) -> None:
        super().abandon()
        self._stop_listening()

    def _stop_listening(self) -> None:
        sockets: list[Any] = [self._listener, self._next]
        self._listener = self._next = None
        for connection in sockets:
            if connection is not None:
                connection.close()
