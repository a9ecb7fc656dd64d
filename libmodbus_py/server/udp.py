"""
A UDP endpoint of a server: a request in one datagram, its answer in another.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable

from ..ports.endpoint import Endpoint
from ..ports.forking import abandoned_in_children
from ..ports.trace import Trace
from ..protocol.framing import Framing, pdu_of
from ..security.describing import CertificateHolder
from .datagrams import bound_datagrams
from .limits import ServerStatistics, peer_name
from .listening import bound
from .service import ENDS, Service, Session, SessionState
from .sources import Sources

__all__ = ["UdpServer"]

# More than a frame has, so that a longer one does not look like one.
READ_SIZE = 512

ANSWERED_AT_ONCE = 16

# The number of delayed answers; further requests are dropped.
WAITING_MAX = 1024


class UdpServer:
    """
    Answers the datagrams to one address.

    Args:
        service: the service that answers.
        sources: the known clients of all UDP endpoints.
        end: closes all endpoints of the server, when a hook ends the program.

    Raises:
        ModbusConnectionError: the address cannot be bound, with errno.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        service: Service,
        sources: Sources,
        statistics: ServerStatistics,
        end: Callable[[], None],
    ) -> None:
        self._endpoint = endpoint
        self._service = service
        self._statistics = statistics
        self._sources = sources
        self._end = end
        self._loop = asyncio.get_running_loop()
        self._sockets: list[socket.socket] = []
        # Datagrams whose answers are delayed.
        self._waiting: set[Session] = set()
        abandoned_in_children(self)

    async def open(self) -> Endpoint:
        """Open the sockets, and return the endpoint with its port."""
        self._sockets, endpoint = await bound(self._endpoint, socket.SOCK_DGRAM, bound_datagrams)
        self._make_session = self._service.sessions(endpoint, self._statistics)
        for made in self._sockets:
            self._loop.add_reader(made.fileno(), self._read, made)
        return endpoint

    def close(self) -> None:
        for session in list(self._waiting):
            session.close()
        self._waiting.clear()
        for made in self._sockets:
            self._loop.remove_reader(made.fileno())
            made.close()
        self._sockets.clear()

    def abandon(self) -> None:
        for made in self._sockets:
            made.close()
        self._sockets.clear()

    def _read(self, local: socket.socket) -> None:
        for _ in range(ANSWERED_AT_ONCE):
            try:
                data, address = local.recvfrom(READ_SIZE)
            except OSError:  # nothing more, or a client that has gone away
                return
            if data and self._sources.admit(data, address) and len(self._waiting) < WAITING_MAX:
                try:
                    self._answer(data, local, address)
                except ENDS:
                    self._end()
                    raise

    def _answer(self, data: bytes, local: socket.socket, address: tuple[str, int]) -> None:
        framing = self._endpoint.framing
        channel = _Datagram(self._sources, framing, self._waiting, local, address)
        session = channel.session = self._make_session(channel)
        session.receive(data)
        if session.state is SessionState.READING:
            session.close()  # the rest of a frame does not come in another datagram
        channel.follow()


class _Datagram:
    """The channel of one datagram."""

    role: str | None = None
    holder: CertificateHolder | None = None
    trace: Trace | None = None

    def __init__(
        self,
        sources: Sources,
        framing: Framing,
        waiting: set[Session],
        local: socket.socket,
        source: tuple[str, int],
    ) -> None:
        self.address = peer_name(*source[:2])
        self.session: Session | None = None
        self._sources = sources
        self._framing: Framing = framing
        self._waiting = waiting
        self._local = local
        self._source = source

    def follow(self) -> None:
        session = self.session
        if session is None:
            return
        if session.state is SessionState.READING:
            self._waiting.discard(session)
        else:
            self._waiting.add(session)

    def hang_up(self) -> bool:
        return False

    def write(self, data: bytes) -> None:
        self._sources.note_answer(data, pdu_of(self._framing, data), self._source)
        # An answer that cannot be sent counts as lost on the way.
        with contextlib.suppress(OSError):
            self._local.sendto(data, self._source)
