"""
A TCP endpoint of a server: it listens, and passes on new connections.
"""

from __future__ import annotations

import asyncio
import math
import socket
from dataclasses import replace
from typing import TYPE_CHECKING

from ..ports.endpoint import Endpoint
from ..ports.hosts import Make, Resolve, bind_all, host_and_port, reason, tcp_listener
from ..ports.port import abandoned_in_children
from ..ports.waiting_async import look_up
from ..protocol.errors import ModbusConnectionError
from ..protocol.logs import HarmlessLogger
from .peer import MakePeerSession
from .peers import Peers
from .service import TURN_EVENTS, MakeSession, Service

if TYPE_CHECKING:
    from ..ports.unix import UnixListener
    from ..security.security import Security
    from .tls import Handshakes

__all__ = ["TcpServer", "bound"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds without accepting when the process has no descriptors left.
RETRY_AFTER = 0.1


class TcpServer:
    """Listens on all addresses of a host, or at a path, for connections; with `security` in TLS."""

    def __init__(
        self,
        endpoint: Endpoint,
        service: Service,
        peers: Peers,
        security: Security | None = None,
        listener: UnixListener | None = None,
    ) -> None:
        self._listener = listener
        self._service = service
        self._peers = peers
        self._loop = asyncio.get_running_loop()
        self._handshakes: Handshakes | None = None
        if security is not None:
            from .tls import Handshakes

            self._handshakes = Handshakes(security, peers.limits, peers.statistics, peers.auditor)
        self._listeners: list[socket.socket] = []
        self._retries: dict[socket.socket, asyncio.TimerHandle] = {}
        self._is_short = False  # mostly a lack of descriptors or memory
        self._endpoint = endpoint
        abandoned_in_children(self)

    async def open(self) -> Endpoint:
        """Open the sockets, and return the endpoint with its port."""
        endpoint = self._endpoint
        if self._listener is None:
            self._listeners, endpoint = await bound(endpoint, socket.SOCK_STREAM, tcp_listener)
        else:
            try:
                self._listeners = [await self._listener.open()]
            except OSError as error:
                raise ModbusConnectionError(
                    f"cannot listen on {endpoint}: {error.strerror or error}", errno=error.errno
                ) from error
        make = self._service.sessions(endpoint, self._peers.statistics, self._peers.later)
        self._make_session = make if self._handshakes is None else _within(self._handshakes, make)
        for listener in self._listeners:
            self._loop.add_reader(listener.fileno(), self._accept, listener)
        if self._handshakes is not None:
            self._handshakes.open(str(endpoint).partition("?")[0])
        return endpoint

    def use(self, security: Security) -> None:
        """
        Use other certificates for new connections; raise ValueError if they cannot be a server's.
        """
        assert self._handshakes is not None
        security.check_server()
        self._handshakes.security = security

    def close(self) -> None:
        for retry in self._retries.values():
            retry.cancel()
        for listener in self._listeners:
            self._loop.remove_reader(listener.fileno())
            listener.close()
        if self._listeners and self._listener is not None:
            self._listener.close()
        self._listeners.clear()
        if self._handshakes is not None:
            self._handshakes.close()

    def abandon(self) -> None:
        for listener in self._listeners:
            listener.close()
        self._listeners.clear()

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(TURN_EVENTS):
            try:
                client, address = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(listener, error)
                return
            self._is_short = False
            client.setblocking(False)
            host, name = self._name(client, address)
            self._peers.admit(client, host, name, self._make_session)

    def _name(self, client: socket.socket, address: tuple[str, int]) -> tuple[str, str]:
        """Return the host of a client, and its name."""
        if self._listener is not None:
            return self._listener.name(client)
        return address[0], host_and_port(*address[:2])

    def _pause(self, listener: socket.socket, error: OSError) -> None:
        """Stop accepting for a while, because connections not accepted keep waking the loop."""
        if not self._is_short:
            logger.warning("%s: cannot accept: %s", self._endpoint, reason(error))
        self._is_short = True
        self._loop.remove_reader(listener.fileno())
        self._retries[listener] = self._loop.call_later(RETRY_AFTER, self._resume, listener)

    def _resume(self, listener: socket.socket) -> None:
        del self._retries[listener]
        self._loop.add_reader(listener.fileno(), self._accept, listener)


def _within(handshakes: Handshakes, make: MakeSession) -> MakePeerSession:
    from .tls import TlsSession

    return lambda peer: TlsSession(peer, handshakes, make)


async def bound(
    endpoint: Endpoint, kind: socket.SocketKind, make: Make
) -> tuple[list[socket.socket], Endpoint]:
    """Return a socket for each address of an endpoint's host, and the endpoint with its port."""
    try:
        wanted = Resolve(endpoint.host, endpoint.port, kind, math.inf, socket.AI_PASSIVE)
        sockets = bind_all(await look_up(wanted), endpoint.port, make)
    except OSError as error:
        raise ModbusConnectionError(
            f"cannot listen on {endpoint}: {reason(error)}", errno=error.errno
        ) from error
    for each in sockets:
        each.setblocking(False)
    return sockets, replace(endpoint, port=sockets[0].getsockname()[1])
