"""
Limits of the resources that clients take from a server: for each address, because a client that
opens another connection is still the same client. And statistics of their requests.
"""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import Generic, Literal, Protocol, TypeVar

from ..ports.hosts import host_of_peer
from ..protocol.checks import integer, number, seconds
from ..protocol.mistakes import WrongType, WrongValue, named_arguments
from ..system import most_descriptors

# Descriptors that are reserved for the rest of the process, unless max_connections is given.
SPARE_DESCRIPTORS = 64

# Addresses without a connection that are remembered, so that they cannot evade their limit; on UDP
# as many answers that may come back, and delayed ones. A sender of datagrams can forge any number.
REMEMBERED_MAX = 4096

FULL_POLICIES = ("close-idle", "refuse")


@named_arguments
@dataclass(frozen=True)
class Limits:
    """
    Limits of the resources that clients use.

    All limits except `allow` and `requests_per_second` apply to TCP connections only.

    Args:
        max_connections: the most connections of all endpoints together, 1 or more; None for as
            many as the process's limit of descriptors allows when the server starts.
        when_full: "close-idle" makes room for a new connection by closing another one: one that
            never sent a request if there is any, otherwise the one whose last request is the
            oldest (messaging guide, 4.3.1); "refuse" closes the new connection.
        connections_per_address: the most connections from one address, 1 or more; None for
            a tenth of `max_connections`, but at least 8. For an address that has reached it,
            `when_full` applies among its own connections, so that others are not affected.
        frame_timeout: seconds from the first byte of a frame to its last, 0.001..86400, after
            which the connection is closed; not for RTU and ASCII over TCP, where silence
            ends a frame. It also limits the time that a client has to take its last responses
            from a connection that is being closed.
        handshake_timeout: seconds from the connection to the end of its TLS handshake,
            0.001..86400.
        certificate_interval: seconds between two checks of the certificates of open TLS
            connections, 0.001..86400. A connection whose certificate has expired or was revoked
            is closed.
        idle_timeout: seconds without a request after which a connection is closed,
            0.001..86400; None for never. A client that does not take its responses is idle.
        max_unsent: the most bytes of responses that may wait for one client, besides what the
            system buffers, 0..2^30. A client with more is not read until all of them are sent.
        allow: networks or addresses whose clients are served, such as
            "192.0.2.0/24" or "::1"; empty for all.
        requests_per_second: the average number of requests that are answered for one address,
            0.001..1000000, over all its TCP connections, with bursts of up to one second's
            requests; and as many over UDP. Further requests wait on TCP and are dropped on UDP.
            None for no limit on TCP, and for 1000 on UDP, where senders can be forged, for each
            address of another machine.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    max_connections: int | None = None
    when_full: Literal["close-idle", "refuse"] = "close-idle"
    frame_timeout: float = 5.0
    handshake_timeout: float = 5.0
    idle_timeout: float | None = 3600.0
    max_unsent: int = 65536
    allow: Iterable[str] = ()
    requests_per_second: float | None = None
    connections_per_address: int | None = None
    certificate_interval: float = 60.0
    _networks: tuple[IPv4Network | IPv6Network, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.max_connections is not None:
            integer("max_connections", self.max_connections, 1, 1_000_000)
        if self.connections_per_address is not None:
            integer("connections_per_address", self.connections_per_address, 1, 1_000_000)
        if self.when_full not in FULL_POLICIES:
            raise WrongValue(
                "when_full", f"must be one of {', '.join(FULL_POLICIES)}, not {self.when_full!r}"
            )
        seconds("frame_timeout", self.frame_timeout)
        seconds("handshake_timeout", self.handshake_timeout)
        seconds("certificate_interval", self.certificate_interval)
        if self.idle_timeout is not None:
            seconds("idle_timeout", self.idle_timeout)
        integer("max_unsent", self.max_unsent, 0, 2**30)
        object.__setattr__(self, "_networks", _networks(self.allow))
        # A tuple, because a generator is exhausted now, and its copy would allow every client.
        object.__setattr__(self, "allow", tuple(map(str, self._networks)))
        if self.requests_per_second is not None:
            number("requests_per_second", self.requests_per_second, 0.001, 1_000_000)

    def allows(self, host: str) -> bool:
        """Return True if clients with this address are served; paths are in no network."""
        if not self._networks or host.startswith("/"):
            return True
        address = ip_address(_plain_host(host).partition("%")[0])
        return any(address in network for network in self._networks)

    def connections(self) -> int:
        """Return the number of connections that are allowed now."""
        if self.max_connections is not None:
            return self.max_connections
        return max(1, most_descriptors() - SPARE_DESCRIPTORS)

    def connections_of_address(self) -> int:
        """Return the number of connections that one address may have now."""
        if self.connections_per_address is not None:
            return self.connections_per_address
        return max(8, self.connections() // 10)


def _plain_host(host: str) -> str:
    """Return the IPv4 address that an IPv6 address contains, because one client may use both."""
    if not host.startswith("::ffff:"):
        return host
    return str(IPv6Address(host).ipv4_mapped or host)


@lru_cache(4096)
def counted_host(host: str) -> str:
    """
    Return what counts as one address: an IPv4 address, or the /64 of an IPv6 address, all of which
    a machine may use (RFC 4291, 2.5.4). The machines of a link share the /64 of link-local
    addresses.
    """
    host = _plain_host(host)
    try:
        address = IPv6Address(host)
    except ValueError:
        return host
    if address.is_link_local:
        return host
    return str(IPv6Network((int(address) >> 64 << 64, 64)))


def host_of(address: str) -> str:
    """Return the name under which a client is counted; `address`: as in `Channel`."""
    return counted_host(host_of_peer(address))


def _networks(allow: Iterable[str]) -> tuple[IPv4Network | IPv6Network, ...]:
    if isinstance(allow, str):
        raise WrongType("allow", f"must be a list of networks, not the string {allow!r}")
    try:
        return tuple(ip_network(network, strict=False) for network in allow)
    except ValueError as error:
        raise WrongValue.about("allow", f"{error}") from None
    except TypeError:
        kind = type(allow).__name__
        raise WrongType("allow", f"must be a list of networks, not {kind}") from None


class Allowance:
    """The number of requests that a client may send: `rate` a second, and as many at once."""

    __slots__ = ("_at", "_left", "_most", "_rate")

    def __init__(self, rate: float, now: float) -> None:
        self._rate = rate
        self._left = self._most = max(1.0, rate)
        self._at = now

    def until(self, now: float) -> float:
        """Return the time from which on the client may send again, which is now or later."""
        self._left = min(self._most, self._left + (now - self._at) * self._rate)
        self._at = now
        return now + max(0.0, -self._left / self._rate)

    def spend(self, requests: int) -> None:
        self._left -= requests


class PausedConnection(Protocol):
    """A connection that is not read while its address exceeds its limit of requests."""

    def resume(self) -> None: ...


Each = TypeVar("Each", bound=PausedConnection)


class Address(Generic[Each]):
    """One address, as `counted_host` returns it, and all its connections."""

    __slots__ = (
        *("_allowance", "_due", "_loop", "_paused", "_rate", "_timer"),
        *("connections", "host"),
    )

    def __init__(self, host: str, rate: float, loop: asyncio.AbstractEventLoop) -> None:
        self.host: str = host
        self.connections: dict[Each, None] = {}
        self._rate = rate
        self._loop = loop
        self._allowance = Allowance(rate, loop.time())
        self._paused: OrderedDict[Each, None] = OrderedDict()
        self._timer: asyncio.TimerHandle | None = None
        self._due = -math.inf  # of the last timer that has ended

    def is_overspent(self) -> bool:
        now = self._now()
        return self._allowance.until(now) > now

    def spend(self, requests: int) -> None:
        self._allowance.spend(requests)

    def pause(self, connection: Each) -> None:
        """Resume a connection in its turn, when its address may send requests again."""
        self._paused[connection] = None
        if self._timer is None:
            self._set_timer()

    def forget(self, connection: Each) -> None:
        self.connections.pop(connection, None)
        self._paused.pop(connection, None)
        if not self._paused and self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _now(self) -> float:
        # asyncio ends timers early, if only by the resolution of its clock.
        return max(self._loop.time(), self._due)

    def _set_timer(self) -> None:
        at = self._allowance.until(self._now())
        self._timer = self._loop.call_at(at, self._release, at)

    def _release(self, due: float) -> None:
        """Resume one connection only, because its requests are counted after it is read."""
        self._timer, self._due = None, due
        if not self.is_overspent():
            connection, _ = self._paused.popitem(last=False)
            connection.resume()
        if self._paused:
            self._set_timer()


class Addresses(Generic[Each]):
    """The addresses that are connected, and those that were most recently."""

    def __init__(self, rate: float = math.inf) -> None:
        self._rate = rate
        self._loop = asyncio.get_running_loop()
        self._connected: dict[str, Address[Each]] = {}
        self._others: OrderedDict[str, Address[Each]] = OrderedDict()

    def get(self, host: str) -> Address[Each]:
        """Return an address, which is remembered only after `keep`."""
        host = counted_host(host)
        address = self._connected.get(host) or self._others.get(host)
        return address or Address(host, self._rate, self._loop)

    def keep(self, address: Address[Each]) -> None:
        """Remember an address while it has connections or is one of the latest."""
        if address.connections:
            self._connected[address.host] = address
            self._others.pop(address.host, None)
            return
        self._connected.pop(address.host, None)
        if self._rate == math.inf:  # nothing to remember
            return
        self._others[address.host] = address
        self._others.move_to_end(address.host)
        if len(self._others) > REMEMBERED_MAX:
            self._others.popitem(last=False)


@dataclass(slots=True, weakref_slot=True)
class ServerStatistics:
    """
    Counters of all endpoints of a server since it was made.

    Attributes:
        connections: TCP connections that are open now.
        accepted: TCP connections that were accepted.
        disallowed: connections and datagrams from networks that are not served.
        refused_full: connections closed at once because there were too many.
        refused_address: connections closed at once because their address had too many.
        closed_for_others: idle connections closed to make room for others.
        closed_idle: connections closed after `idle_timeout`.
        closed_slow: connections closed because a frame or a TLS handshake took too long.
        closed_out_of_step: connections closed because of an invalid header.
        closed_untrusted: TLS connections closed because the certificate of their client had expired
            or was not trusted any more.
        paused: how often a client was not read because it did not take its responses.
        throttled: how often a client exceeded `requests_per_second`.
        reflected: datagrams not answered because they were responses of this server that came
            back more than ten times a second.
        echoes: serial ports, and TCP connections with RTU or ASCII frames, that were found to
            return what is sent on them (local echo).
        requests: frames that this server received, those for other units included.
        refused: requests that got an exception response.
        unauthorized: requests that `authorize` of a device did not allow; a broadcast counts once
            for each device.
        bad_frames: runs of bytes that were no frame.
        handshakes: TLS connections on which both sides accepted the other's certificate.
        handshakes_resumed: TLS connections that resumed a session.
        handshakes_refused: TLS connections closed because a certificate was refused or the bytes
            were no TLS.
        certificate_ends: the time at which the certificate of each open TLS endpoint expires,
            in seconds since 1970, by URL. This needs the package cryptography.
    """

    connections: int = 0
    accepted: int = 0
    disallowed: int = 0
    refused_full: int = 0
    refused_address: int = 0
    closed_for_others: int = 0
    closed_idle: int = 0
    closed_slow: int = 0
    closed_out_of_step: int = 0
    closed_untrusted: int = 0
    paused: int = 0
    throttled: int = 0
    reflected: int = 0
    echoes: int = 0
    requests: int = 0
    refused: int = 0
    unauthorized: int = 0
    bad_frames: int = 0
    handshakes: int = 0
    handshakes_resumed: int = 0
    handshakes_refused: int = 0
    certificate_ends: dict[str, float] = field(default_factory=dict)
