"""Contexts over TCP: connections to a slave, and from a master."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import socket
import time
from typing import Any, ClassVar

from ..binding.library import check, ffi, lib, make
from ..ports.hosts import host_and_port
from ..ports.port import RECEIVED_BYTES, lost
from ..ports.sockets import TcpPort
from ..ports.waiting import READ, WaitInterrupted, run
from ..protocol.checks import integer
from ..protocol.errors import ModbusConnectionError, ModbusError
from ..protocol.framing import TcpFramer
from ..protocol.mistakes import named_arguments
from ..protocol.pdu.request import Request
from .context import CLOSED, FOREIGN, READY, closed_meanwhile, too_many_descriptors
from .functions import Slave


class _Opening(TcpPort):
    """A connection that is being opened."""

    @property
    def socket(self) -> socket.socket:
        return self._socket


@named_arguments
class TcpContext(Slave):
    """
    A modbus_t over TCP: each method is one call of libmodbus, which waits without the GIL.

    It connects when it is entered (``with``) or first used. After any failure but an
    ExceptionResponse the connection is closed, and the next call connects again, so that no late
    answer is taken for that of the next request. Nothing is repeated. Calls of other threads wait
    for each other. Ctrl-C takes effect when a call ends, at the latest after `response_timeout`.
    After a fork, the child has to make its own context; its parent's is not affected.

    libmodbus does not check all of an answer: not its unit nor the length in its header, and up
    to 3.1.7 not the echo of a write. It has no retries and no UDP, TLS, or frames of RTU over TCP,
    and takes descriptors below 1024 only. `Client` checks and has all of these.

    Every request can raise:

    * TypeError, ValueError: an argument is wrong; nothing was sent.
    * ExceptionResponse: the server refused the request; the subclass tells why. libmodbus shows
      the codes 0..11; others, which are an InvalidResponse here, only to `execute`.
    * ModbusTimeoutError: no complete answer within `response_timeout`.
    * InvalidResponse: the answer does not fit (EMBBADDATA, EMBBADEXC).
    * ModbusConnectionError: not connected, or the connection was lost; with errno.
    * RuntimeError: in a forked child, or in a signal handler during a call of its thread.

    Args:
        host: a host name, an IPv4 or an IPv6 address; of this machine, for `listen`.
        port: 0..65535; 0 for `listen` only, which then sets `port` to a free one.
        unit: 0..247 or 255.
        timeout: seconds for connecting, and for each answer: `response_timeout`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.

    Source: modbus_new_tcp_pi. This package resolves the name and connects, because modbus_connect
    gives wrong errors, and aborts the process on descriptors of 1024 and above.
    """

    _is_serial: ClassVar = False
    _after: ClassVar = READY
    _connection: socket.socket | None = None
    _listener: socket.socket | None = None

    def __init__(self, host: str, port: int = 502, *, unit: int = 1, timeout: float = 1.0) -> None:
        self.port: int = integer("port", port, 0, 65535)
        TcpPort(host, self.port or 1, None)  # checks the host
        self.host: str = host
        try:
            node = host.encode("ascii" if host.isascii() else "idna")
            modbus = make(lib.modbus_new_tcp_pi(node, str(self.port).encode()))
        except (ModbusError, UnicodeError):
            raise ValueError(f"host must be a name or an address, not {host!r}") from None
        super().__init__(modbus, unit, timeout)

    @property
    def _endpoint(self) -> str:
        return f"tcp://{host_and_port(self.host, self.port)}"

    # --- a slave's connections ------------------------------------------------------------------

    def listen(self, backlog: int = 1) -> None:
        """
        Listen on `host` and `port`, for `accept` (modbus_tcp_pi_listen).

        Args:
            backlog: connections that may wait, 1..4096.

        Raises:
            ModbusConnectionError: it cannot; with errno, such as EADDRINUSE.
        """
        number = integer("backlog", backlog, 1, 4096)
        with self._lock, self._errors():
            if self._state is FOREIGN:
                self._ensure_open()
            self._is_closed = False
            self._close_listener()
            try:
                descriptor = check(lib.modbus_tcp_pi_listen(self._modbus, number))
            except ModbusConnectionError as error:
                reason = f"cannot listen on {host_and_port(self.host, self.port)}: {error}"
                raise ModbusConnectionError(reason, errno=error.errno) from error
            self._listener = socket.socket(fileno=descriptor)
            self._listener.setblocking(False)
            self.port = self._listener.getsockname()[1]

    def accept(self) -> str:
        """
        Wait for a connection of a master, in place of the previous one (modbus_tcp_pi_accept).

        Returns:
            The master, such as "192.0.2.7:51234".

        Raises:
            ModbusConnectionError: the context does not listen, or was closed meanwhile.
        """
        with self._lock, self._errors():
            if self._state not in (READY, CLOSED):
                self._ensure_open()
            self._drop()
            peer = None
            while peer is None:
                if self._listener is None:
                    raise ModbusConnectionError("listen() comes first", errno=errno.EINVAL)
                self._wait(self._listener.fileno(), READ, math.inf)
                peer = self._accept(self._listener)
            return peer

    def _accept(self, listener: socket.socket) -> str | None:
        # libmodbus closes the descriptor when it fails: 3.1.6.
        place = ffi.new("int *", os.dup(listener.fileno()))
        try:
            lib.modbus_tcp_pi_accept(self._modbus, place)
            number = ffi.errno
        finally:
            if place[0] != -1:
                os.close(place[0])
        descriptor = lib.modbus_get_socket(self._modbus)
        if descriptor == -1:
            if number in (errno.EAGAIN, errno.EINTR, errno.ECONNABORTED):
                return None  # the master has closed the connection already
            raise ModbusConnectionError(os.strerror(number), errno=number)
        connection = self._connection = socket.socket(fileno=descriptor)
        if error := too_many_descriptors(descriptor):
            self._drop()
            raise error
        connection.setblocking(False)  # a master that reads nothing must not block the slave
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._state = READY
        try:
            host, port = connection.getpeername()[:2]
        except OSError:
            self._drop()
            return None
        return host_and_port(host, port)

    # --- connections ----------------------------------------------------------------------------

    def _open(self) -> None:
        if self._listener is not None:
            raise ModbusConnectionError("accept() comes first", errno=errno.ENOTCONN)
        self._drop()
        port = _Opening(self.host, self.port, None)
        try:
            run(port.opening(time.monotonic() + self.response_timeout), self._get_waker())
        except WaitInterrupted:
            raise closed_meanwhile() from None
        if error := too_many_descriptors(port.descriptor):
            port.close()
            raise error
        self._connection = port.socket
        check(lib.modbus_set_socket(self._modbus, port.descriptor))

    def _drop(self) -> None:
        self._state = CLOSED
        self._framer = None
        if self._connection is not None:
            self._requests.clear()
            lib.modbus_set_socket(self._modbus, -1)
            self._connection.close()
            self._connection = None

    def _spoil(self) -> None:
        self._drop()

    def _interrupt(self) -> None:
        super()._interrupt()
        if (connection := self._connection) is not None:
            with contextlib.suppress(OSError):  # closed meanwhile
                connection.shutdown(socket.SHUT_RDWR)

    def _release(self) -> None:
        super()._release()
        self._close_listener()

    def _close_listener(self) -> None:
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.close()

    def _abandon(self) -> None:
        self._close_listener()
        lib.modbus_set_socket(self._modbus, -1)
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    # --- frames -----------------------------------------------------------------------------------

    def _read_bytes(self) -> bytes:
        try:
            data = os.read(self.socket, RECEIVED_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise lost(error) from error
        if not data:
            raise ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
        return data

    def _discard_input(self) -> int:
        return check(lib.modbus_flush(self._modbus))

    def _client_framer(self, request: Request[Any]) -> TcpFramer:
        return TcpFramer("client")

    def _server_framer(self) -> TcpFramer:
        return TcpFramer()
