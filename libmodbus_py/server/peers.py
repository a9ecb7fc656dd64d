"""
The TCP connections of a server: how endpoints listen, and which connections are accepted, kept and
closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import select
import socket
from collections.abc import Callable, Iterable
from dataclasses import replace
from select import POLLIN
from typing import TYPE_CHECKING

from ..device.authorization import LimitedLog
from ..ports.endpoint import Endpoint
from ..ports.hosts import Make, Resolve, bind_all, host_and_port, reason, tcp_listener
from ..ports.port import abandoned_in_children
from ..ports.waiting import look_up
from ..protocol.errors import ModbusConnectionError
from ..protocol.logs import HarmlessLogger
from ..system import reserve_descriptors
from .limits import SPARE_DESCRIPTORS, Address, Addresses, Limits, ServerStatistics
from .peer import MakePeerSession, Peer, Turns
from .service import TURN_EVENTS, MakeSession, Service, SessionState

if TYPE_CHECKING:
    from ..ports.unix import UnixListener
    from ..security.security import Security
    from .audit import Audit
    from .tls import Handshakes

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds without accepting when the process has no descriptors left.
RETRY_AFTER = 0.1


class Peers(Turns):
    """The connections of all TCP endpoints, within the limits; `end` closes all endpoints."""

    def __init__(
        self,
        limits: Limits,
        statistics: ServerStatistics,
        end: Callable[[], None] | None = None,
        make_poller: Callable[[], select.epoll] = select.epoll,
        auditor: Audit | None = None,
        log: LimitedLog | None = None,
    ) -> None:
        self._most = limits.connections()
        poller = make_poller()
        # For more, the table grows when they are needed.
        reserve_descriptors(poller.fileno(), min(self._most, 1 << 14) + SPARE_DESCRIPTORS // 2)
        super().__init__(limits, statistics, poller, log or LimitedLog(logger))
        self.auditor = auditor
        self._end = end or self.close
        self._most_of_address = limits.connections_of_address()
        self._connections: dict[Peer, None] = {}
        self._addresses: Addresses[Peer] = Addresses(limits.requests_per_second or math.inf)
        self._make_peer = Peer if limits.requests_per_second is None else LimitedPeer
        self._sweeping: asyncio.TimerHandle | None = None
        timeouts = [limits.frame_timeout, limits.idle_timeout or limits.frame_timeout]
        self._sweep_every = max(0.01, min(1.0, *(timeout / 4 for timeout in timeouts)))
        abandoned_in_children(self)

    def __len__(self) -> int:
        return len(self._connections)

    def end(self) -> None:
        self._end()

    def admit(self, client: socket.socket, host: str, name: str, make: MakePeerSession) -> None:
        """
        Take charge of a new connection, or close it; `host`: what the limits of one address apply
        to.
        """
        if not self.limits.allows(host):
            self.statistics.disallowed += 1
            self.log.warning("%s: refused: not in an allowed network", name)
            if self.auditor is not None:
                self.auditor.note_disallowed(host, name)
            client.close()
            return
        usage = self._addresses.get(host)
        of_address, most = usage.connections, self._most_of_address
        if len(of_address) >= most and not self._make_room(of_address, "connections_per_address"):
            self.statistics.refused_address += 1
            message = "%s: refused: its address has %d connections (connections_per_address)"
            self.log.warning(message, name, len(of_address))
            client.close()
        elif len(self) >= self._most and not self._make_room(self._connections, "max_connections"):
            self.statistics.refused_full += 1
            self.log.warning(
                "%s: refused: %d connections are open (max_connections)", name, len(self)
            )
            client.close()
        else:
            self._add(client, name, usage, make)

    def close(self) -> None:
        for peer in list(self._connections):
            peer.close()
        if self._sweeping is not None:
            self._sweeping.cancel()
        self.stop()

    def _add(
        self, client: socket.socket, address: str, usage: Address[Peer], make: MakePeerSession
    ) -> None:
        with contextlib.suppress(OSError):  # the descriptor may be gone already
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.statistics.accepted += 1
        self.statistics.connections += 1
        peer = self._make_peer(self, client, address, usage, make)
        self._connections[peer] = usage.connections[peer] = None
        self._addresses.keep(usage)
        if self._sweeping is None:
            self._sweeping = self.loop.call_later(self._sweep_every, self._sweep)

    def _make_room(self, among: Iterable[Peer], limit: str) -> bool:
        """Close one that never asked if there is any, otherwise the one that asked first."""
        if self.limits.when_full == "refuse":
            return False
        peer = min(among, key=lambda peer: (peer.has_asked, peer.idle_since))
        self.statistics.closed_for_others += 1
        message = "%s: closed to make room for another connection (%s)"
        self.log.warning(message, peer.address, limit, reason=limit)
        peer.close()
        return True

    def remove(self, peer: Peer) -> None:
        self.statistics.connections -= 1
        self._connections.pop(peer, None)
        self.deadlines.pop(peer, None)
        peer.usage.forget(peer)
        self._addresses.keep(peer.usage)

    def _sweep(self) -> None:
        self._sweeping = None
        now = self.loop.time()
        for peer in [peer for peer, at in self.deadlines.items() if at <= now]:
            self.statistics.closed_slow += 1
            message = "%s: closed: a frame, or taking the last answers, took %g s (frame_timeout)"
            self.log.warning(message, peer.address, self.limits.frame_timeout)
            peer.close()
        if (idle := self.limits.idle_timeout) is not None:
            since = now - idle
            for peer in [peer for peer in self._connections if peer.idle_since <= since]:
                self.statistics.closed_idle += 1
                logger.info("%s: closed: no request for %g s (idle_timeout)", peer.address, idle)
                peer.close()
        if len(self):
            self._sweeping = self.loop.call_later(self._sweep_every, self._sweep)


class LimitedPeer(Peer):
    """A client whose address has a limit of requests."""

    __slots__ = ()

    def act(self, events: int) -> None:
        takes = not events or events & POLLIN
        if takes and self.usage.is_overspent() and self._may_ask(events):
            self._turns.statistics.throttled += 1
            message = "%s: its requests wait: more than %g a second (requests_per_second)"
            self._turns.log.warning(message, self.address, self._turns.limits.requests_per_second)
            self._is_throttled = True
            self.usage.pause(self)
            self.follow()
            events &= ~POLLIN
            if not events:
                return
        super().act(events)

    def _may_ask(self, events: int) -> bool:
        """Return True if requests may be read, which is not so in a handshake or while closing."""
        if self._descriptor < 0 or self._session.state is SessionState.HANDSHAKE:
            return False
        with contextlib.suppress(OSError):
            return not events or self._socket.recv(1, socket.MSG_PEEK) != b""
        return False

    def _take(self, data: bytes | None = None) -> int:
        requests = super()._take(data)
        self.usage.spend(requests)
        return requests


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

            self._handshakes = Handshakes(
                security, peers.limits, peers.statistics, peers.auditor, peers.log
            )
        self._listeners: list[socket.socket] = []
        self._retries: dict[socket.socket, asyncio.TimerHandle] = {}
        self._is_short = False  # mostly a lack of descriptors or memory
        self._endpoint = endpoint
        abandoned_in_children(self)

    async def open(self) -> Endpoint:
        endpoint = self._endpoint
        if self._listener is None:
            self._listeners, endpoint = await bound(endpoint, socket.SOCK_STREAM, tcp_listener)
        else:
            try:
                self._listeners = [await self._listener.open()]
            except OSError as error:  # which may have a text of its own
                text = f"cannot listen on {endpoint}: {error.strerror or error}"
                raise ModbusConnectionError(text, errno=error.errno) from error
        make = self._service.sessions(endpoint, self._peers.statistics, self._peers.later)
        self._make_session = make if self._handshakes is None else _within(self._handshakes, make)
        for listener in self._listeners:
            self._loop.add_reader(listener.fileno(), self._accept, listener)
        if self._handshakes is not None:
            self._handshakes.open(str(endpoint).partition("?")[0])
        return endpoint

    def use(self, security: Security) -> None:
        """Use other certificates, which `check_server` has accepted, for new connections."""
        assert self._handshakes is not None
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
            if self._listener is not None:
                host, name = self._listener.name(client)
            else:
                host, name = address[0], host_and_port(*address[:2])
            self._peers.admit(client, host, name, self._make_session)

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
    question = Resolve(endpoint.host, endpoint.port, kind, math.inf, socket.AI_PASSIVE)
    sockets = bind_all(await look_up(question), endpoint.port, make)
    for listener in sockets:
        listener.setblocking(False)
    return sockets, replace(endpoint, port=sockets[0].getsockname()[1])
