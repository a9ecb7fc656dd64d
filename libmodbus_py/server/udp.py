"""
A UDP endpoint of a server: a request in one datagram, its answer in another.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from functools import partial

from ..ports.endpoint import Endpoint
from .by_frame import ByFrame
from .limits import Allowance, Limits, ServerStatistics
from .listening import bound
from .units import TcpUnits, Units

__all__ = ["UdpServer"]

# More than a frame has, so that a longer one does not look like one.
READ_SIZE = 512

ANSWERED_AT_ONCE = 16

# How many answers faults may keep back; what comes meanwhile is lost.
WAITING_MAX = 1024

# How many addresses' rates are remembered: a sender can pretend to be as many as it likes.
ADDRESSES_MAX = 4096


class UdpServer:
    """
    Answers the datagrams to one address.

    Raises:
        ModbusConnectionError: it cannot, with errno.
    """

    def __init__(
        self, endpoint: Endpoint, units: Units, limits: Limits, statistics: ServerStatistics
    ) -> None:
        self._endpoint = endpoint
        self._units = TcpUnits(units)
        self._limits = limits
        self._statistics = statistics
        self._loop = asyncio.get_running_loop()
        self._sockets: list[socket.socket] = []
        # Those whose answer a fault keeps back.
        self._waiting: set[ByFrame] = set()
        self._allowances: dict[str, Allowance] = {}

    async def open(self) -> Endpoint:
        """Give the endpoint with the port it got."""
        self._sockets, endpoint = await bound(self._endpoint, socket.SOCK_DGRAM, _bound)
        for made in self._sockets:
            self._loop.add_reader(made.fileno(), self._read, made)
        return endpoint

    def close(self) -> None:
        for session in self._waiting:
            session.close()
        for made in self._sockets:
            self._loop.remove_reader(made.fileno())
            made.close()
        self._sockets.clear()

    def _read(self, local: socket.socket) -> None:
        for _ in range(ANSWERED_AT_ONCE):
            try:
                data, address = local.recvfrom(READ_SIZE)
            except OSError:  # nothing more, or a client that has gone away
                return
            if not self._limits.allows(address[0]):
                self._statistics.disallowed += 1
            elif self._is_too_fast(address[0]):
                self._statistics.throttled += 1
            elif len(self._waiting) < WAITING_MAX:
                self._answer(data, local, address)

    def _answer(self, data: bytes, local: socket.socket, address: tuple[str, int]) -> None:
        def follow() -> None:
            if session.is_waiting:
                self._waiting.add(session)
            else:
                self._waiting.discard(session)

        session = ByFrame(
            self._units,
            "udp",
            f"{address[0]}:{address[1]}",
            self._statistics,
            partial(_send, local, address),
            follow,
        )
        session.receive(data)

    def _is_too_fast(self, host: str) -> bool:
        rate = self._limits.requests_per_second
        if rate is None:
            return False
        now = self._loop.time()
        allowance = self._allowances.pop(host, None) or Allowance(rate, now)
        self._allowances[host] = allowance
        if len(self._allowances) > ADDRESSES_MAX:
            del self._allowances[next(iter(self._allowances))]
        if allowance.wait(now) > 0:
            return True
        allowance.spend(1)
        return False


def _bound(family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        made.bind(address)
    except OSError:
        made.close()
        raise
    return made


def _send(local: socket.socket, address: tuple[str, int], answer: bytes) -> None:
    # An answer that does not get away is one that got lost on the way.
    with contextlib.suppress(OSError):
        local.sendto(answer, address)
