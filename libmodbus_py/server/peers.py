"""
The TCP connections of a server: which are accepted, kept and closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
from collections.abc import Callable, Iterable
from select import POLLIN
from typing import TYPE_CHECKING

from ..ports.port import abandoned_in_children
from ..system import DescriptorPoller, make_poller, reserve_descriptors
from .limits import SPARE_DESCRIPTORS, Address, Addresses, Limits, ServerStatistics
from .peer import MakePeerSession, Peer, Turns
from .service import SessionState

if TYPE_CHECKING:
    from .audit import Audit

__all__ = ["Peers"]

# Room for more descriptors is made when they are needed.
ROOM_AT_MOST = 16_384


class Peers(Turns):
    """The connections of all TCP endpoints, within the limits; `end` closes all endpoints."""

    def __init__(
        self,
        limits: Limits,
        statistics: ServerStatistics,
        end: Callable[[], None] | None = None,
        make_poller: Callable[[], DescriptorPoller] = make_poller,
        auditor: Audit | None = None,
    ) -> None:
        self._most = limits.connections()
        poller = make_poller()
        reserve_descriptors(poller.fileno(), min(self._most, ROOM_AT_MOST) + SPARE_DESCRIPTORS // 2)
        super().__init__(limits, statistics, poller)
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
            if self.auditor is not None:
                self.auditor.note_disallowed(host, name)
            client.close()
            return
        shared = self._addresses.get(host)
        if len(shared.connections) >= self._most_of_address and not self._make_room(
            shared.connections
        ):
            self.statistics.refused_address += 1
            client.close()
        elif len(self) >= self._most and not self._make_room(self._connections):
            self.statistics.refused_full += 1
            client.close()
        else:
            self._add(client, name, shared, make)

    def close(self) -> None:
        """Close all connections; may be called any number of times."""
        for peer in list(self._connections):
            peer.close()
        if self._sweeping is not None:
            self._sweeping.cancel()
        self.stop()

    def _add(
        self, client: socket.socket, address: str, shared: Address[Peer], make: MakePeerSession
    ) -> None:
        with contextlib.suppress(OSError):  # the descriptor may be gone already
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.statistics.accepted += 1
        self.statistics.connections += 1
        peer = self._make_peer(self, client, address, shared, make)
        self._connections[peer] = shared.connections[peer] = None
        self._addresses.keep(shared)
        if self._sweeping is None:
            self._sweeping = self.loop.call_later(self._sweep_every, self._sweep)

    def _make_room(self, among: Iterable[Peer]) -> bool:
        """Close one that never asked if there is any, otherwise the one that asked first."""
        if self.limits.when_full == "refuse":
            return False
        self.statistics.closed_for_others += 1
        min(among, key=lambda peer: (peer.has_asked, peer.idle_since)).close()
        return True

    def remove(self, peer: Peer) -> None:
        self.statistics.connections -= 1
        self._connections.pop(peer, None)
        self.deadlines.pop(peer, None)
        peer.shared.forget(peer)
        self._addresses.keep(peer.shared)

    def _sweep(self) -> None:
        self._sweeping = None
        now = self.loop.time()
        for peer in [each for each, at in self.deadlines.items() if at <= now]:
            self.statistics.closed_slow += 1
            peer.close()
        if self.limits.idle_timeout is not None:
            since = now - self.limits.idle_timeout
            for peer in [each for each in self._connections if each.idle_since <= since]:
                self.statistics.closed_idle += 1
                peer.close()
        if len(self):
            self._sweeping = self.loop.call_later(self._sweep_every, self._sweep)


class LimitedPeer(Peer):
    """A client whose address has a limit of requests."""

    __slots__ = ()

    def act(self, events: int) -> None:
        takes = not events or events & POLLIN
        if takes and self.shared.is_overspent() and self._may_ask(events):
            self._turns.statistics.throttled += 1
            self._is_throttled = True
            self.shared.pause(self)
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
        self.shared.spend(requests)
        return requests
