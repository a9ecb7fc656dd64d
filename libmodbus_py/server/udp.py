"""
A UDP endpoint of a server: a request in one datagram, its answer in another.

Any source of a datagram can be forged; `Sources` decides which are answered. Each is answered from
the address that was asked: the clients of a machine with several addresses, of this package and of
others, take datagrams only from the address to which they sent.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
from collections import OrderedDict
from collections.abc import Callable
from functools import lru_cache
from ipaddress import IPv6Address, ip_address
from typing import TYPE_CHECKING, Any

from ..device.authorization import LimitedLog
from ..ports.endpoint import Endpoint
from ..ports.hosts import host_and_port, is_loopback
from ..ports.port import abandoned_in_children
from ..ports.trace import Trace
from ..protocol.errors import MAX_RECEIVED
from ..protocol.framing import Framing, pdu_of
from ..protocol.logs import HarmlessLogger
from ..protocol.pdu import request_length
from ..system import IP_PKTINFO
from .limits import (
    REMEMBERED_MAX,
    Address,
    Addresses,
    Allowance,
    Limits,
    PausedConnection,
    ServerStatistics,
)
from .peers import bound
from .service import ENDS, TURN_EVENTS, Service, Session, SessionState

if TYPE_CHECKING:
    from ..security.certificates import CertificateHolder
    from .audit import Audit

logger: HarmlessLogger = HarmlessLogger(__name__)

# An answer may be a valid request, as for function 8; so a forged source lets two servers, or one
# and itself, answer each other for ever. An answer that comes back from where it was sent more
# than ten times a second is dropped once, which ends the circle; its port says nothing, because a
# client may use any.
RETURNS_PER_SECOND = 10


class UdpServer:
    """Answers the datagrams to one address."""

    def __init__(
        self,
        endpoint: Endpoint,
        service: Service,
        sources: Sources,
        statistics: ServerStatistics,
        end: Callable[[], None],
    ) -> None:
        self.framing: Framing = endpoint.framing
        self.sources = sources
        self.waiting: set[Session] = set()  # of datagrams whose answers are delayed
        self._endpoint = endpoint
        self._service = service
        self._statistics = statistics
        self._end = end
        self._loop = asyncio.get_running_loop()
        self._sockets: list[socket.socket] = []
        abandoned_in_children(self)

    async def open(self) -> Endpoint:
        self._sockets, endpoint = await bound(self._endpoint, socket.SOCK_DGRAM, bound_datagrams)
        self._make_session = self._service.sessions(endpoint, self._statistics)
        for listener in self._sockets:
            self._loop.add_reader(listener.fileno(), self._read, listener)
        return endpoint

    def close(self) -> None:
        for session in list(self.waiting):
            session.close()
        self.waiting.clear()
        for listener in self._sockets:
            self._loop.remove_reader(listener.fileno())
            listener.close()
        self._sockets.clear()

    def abandon(self) -> None:
        for listener in self._sockets:
            listener.close()
        self._sockets.clear()

    def _read(self, local: socket.socket) -> None:
        for _ in range(TURN_EVENTS):
            try:
                data, address = local.recvfrom(MAX_RECEIVED)
            except OSError:  # nothing more, or a client that has gone away
                return
            if not data or not self.sources.admit(data, address):
                continue
            if len(self.waiting) >= REMEMBERED_MAX:
                message = "%s: datagrams are dropped: %d requests wait for their answers"
                name = host_and_port(*address[:2])
                self.sources.log.warning(message, name, len(self.waiting))
            else:
                try:
                    self._answer(data, local, address)
                except ENDS:
                    self._end()
                    raise

    def _answer(self, data: bytes, local: socket.socket, address: tuple[str, int]) -> None:
        channel = _Datagram(self, local, address)
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

    session: Session | None = None

    def __init__(self, server: UdpServer, local: socket.socket, source: tuple[str, int]) -> None:
        self.address = host_and_port(*source[:2])
        self._server = server
        self._local = local
        self._source = source

    def follow(self) -> None:
        if (session := self.session) is None:
            return
        if session.state is SessionState.READING:
            self._server.waiting.discard(session)
        else:
            self._server.waiting.add(session)

    def hang_up(self) -> bool:
        return False

    def write(self, data: bytes) -> None:
        server = self._server
        server.sources.note_answer(data, pdu_of(server.framing, data), self._source)
        # An answer that cannot be sent counts as lost on the way.
        with contextlib.suppress(OSError):
            self._local.sendto(data, self._source)


class Sources:
    """The clients at all UDP endpoints of a server."""

    def __init__(
        self,
        limits: Limits,
        statistics: ServerStatistics,
        auditor: Audit | None = None,
        log: LimitedLog | None = None,
    ) -> None:
        self.log: LimitedLog = log or LimitedLog(logger)
        self._limits = limits
        self._statistics = statistics
        self._auditor = auditor
        self._loop = asyncio.get_running_loop()
        # An answer can be seven times as long as its request, and go to a host that never asked.
        self._rate = limits.requests_per_second or 1000.0
        self._addresses: Addresses[PausedConnection] = Addresses(self._rate)
        self._returns: OrderedDict[int, Allowance] = OrderedDict()

    def admit(self, datagram: bytes, source: tuple[str, int]) -> bool:
        """Return True if a datagram is to be answered; count it if not."""
        host, name = source[0], host_and_port(*source[:2])
        if not self._limits.allows(host):
            self._statistics.disallowed += 1
            self.log.warning("%s: refused: not in an allowed network", name)
            if self._auditor is not None:
                self._auditor.note_disallowed(host, name)
        elif self._returns_too_often(datagram, source):
            self._statistics.reflected += 1
            message = "%s: datagrams are dropped: they are answers that came back"
            self.log.warning(message, name)
        elif self._is_too_fast(host):
            self._statistics.throttled += 1
            message = "%s: datagrams are dropped: more than %g a second (requests_per_second)"
            self.log.warning(message, name, self._rate)
        else:
            return True
        return False

    def note_answer(self, datagram: bytes, pdu: bytes, source: tuple[str, int]) -> None:
        """Remember an answer that would be answered if it came back."""
        if not pdu or pdu[0] & 0x80 or request_length(pdu) not in (0, len(pdu)):
            return
        key = hash((source, datagram))
        allowance = self._returns.pop(key, None)
        self._returns[key] = allowance or Allowance(RETURNS_PER_SECOND, self._loop.time())
        if len(self._returns) > REMEMBERED_MAX:
            self._returns.popitem(last=False)

    def _returns_too_often(self, datagram: bytes, source: tuple[str, int]) -> bool:
        key = hash((source, datagram))
        allowance = self._returns.get(key)
        if allowance is None:
            return False
        now = self._loop.time()
        if allowance.until(now) > now:
            del self._returns[key]
            return True
        allowance.spend(1)
        return False

    def _is_too_fast(self, host: str) -> bool:
        if self._limits.requests_per_second is None and is_loopback(host):
            return False
        address: Address[PausedConnection] = self._addresses.get(host)
        self._addresses.keep(address)
        if address.is_overspent():
            return True
        address.spend(1)
        return False


# --- sockets -----------------------------------------------------------------------------------

# struct in_pktinfo: interface, the own address, the target; struct in6_pktinfo: target, interface.
IN_PKTINFO = struct.Struct("=i4s4s")
IN6_PKTINFO = struct.Struct("=16si")

ROOM = socket.CMSG_SPACE(max(IN_PKTINFO.size, IN6_PKTINFO.size))


class DatagramSource(tuple[Any, ...]):
    """
    The address that a datagram came from, and control data that choose the address it was sent to.
    """

    control: list[tuple[int, int, bytes]]


class AllAddresses(socket.socket):
    """A UDP socket that is bound to all addresses of this machine."""

    def recvfrom(self, *arguments: int) -> tuple[bytes, DatagramSource]:
        data, control, _, address = self.recvmsg(arguments[0], ROOM)
        source = DatagramSource(address)
        source.control = [_choice(*item) for item in control]
        return data, source

    def sendto(self, data: Any, *arguments: Any) -> int:
        (source,) = arguments
        return self.sendmsg([data], source.control, 0, source)


@lru_cache(64)
def _choice(level: int, kind: int, info: bytes) -> tuple[int, int, bytes]:
    """Return the control data that answer what came with these."""
    # Interface 0 is any. Another one overrides the routes, though the client may be elsewhere.
    if level == socket.IPPROTO_IP:
        _, own, target = IN_PKTINFO.unpack(info)
        return level, kind, IN_PKTINFO.pack(0, own, target)
    own, interface = IN6_PKTINFO.unpack(info)
    address = IPv6Address(own)
    if address.is_multicast:  # no address of this machine: the system chooses one
        own = bytes(16)
    return level, kind, IN6_PKTINFO.pack(own, interface if address.is_link_local else 0)


def bound_datagrams(family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
    """Return a UDP socket that is bound to an address, or raise OSError."""
    has_all = ip_address(address[0].partition("%")[0]).is_unspecified
    listener = (AllAddresses if has_all else socket.socket)(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        if has_all and family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_RECVPKTINFO, 1)
        elif has_all:
            listener.setsockopt(socket.IPPROTO_IP, IP_PKTINFO, 1)
        listener.bind(address)
    except OSError:
        listener.close()
        raise
    return listener
