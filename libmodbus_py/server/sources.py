"""
Sources of datagrams that are answered: any source can be forged.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from ..ports.hosts import is_loopback
from ..protocol.pdu import request_length
from .addresses import Address, Addresses, Paused
from .audit import Audit
from .limits import Allowance, Limits, ServerStatistics

__all__ = ["Sources"]

# An answer may be a valid request, as for function 8; so a forged source lets two servers, or one
# and itself, answer each other for ever. An answer that comes back from where it was sent more
# than ten times a second is dropped once, which ends the circle; its port says nothing, because a
# client may use any.
RETURNS_PER_SECOND = 10
RETURNS_REMEMBERED = 16_384

# An answer can be seven times as long as its request, and go to a host that never asked.
USUAL_RATE = 1000.0


class Sources:
    """The clients at all UDP endpoints of a server."""

    def __init__(
        self, limits: Limits, statistics: ServerStatistics, auditor: Audit | None = None
    ) -> None:
        self._limits = limits
        self._statistics = statistics
        self._auditor = auditor
        self._loop = asyncio.get_running_loop()
        self._addresses: Addresses[Paused] = Addresses(limits.requests_per_second or USUAL_RATE)
        self._returns: OrderedDict[int, Allowance] = OrderedDict()

    def admit(self, datagram: bytes, source: tuple[str, int]) -> bool:
        """Return True if a datagram is to be answered; count it if not."""
        host, port = source[:2]
        if not self._limits.allows(host):
            self._statistics.disallowed += 1
            if self._auditor is not None:
                self._auditor.note_disallowed(host, port)
        elif self._returns_too_often(datagram, source):
            self._statistics.reflected += 1
        elif self._is_too_fast(host):
            self._statistics.throttled += 1
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
        if len(self._returns) > RETURNS_REMEMBERED:
            self._returns.popitem(last=False)

    def _returns_too_often(self, datagram: bytes, source: tuple[str, int]) -> bool:
        key = hash((source, datagram))
        allowance = self._returns.get(key)
        if allowance is None:
            return False
        if allowance.wait(self._loop.time()) > 0:
            del self._returns[key]
            return True
        allowance.spend(1)
        return False

    def _is_too_fast(self, host: str) -> bool:
        if self._limits.requests_per_second is None and is_loopback(host):
            return False
        address: Address[Paused] = self._addresses.get(host)
        self._addresses.keep(address)
        if address.is_overspent():
            return True
        address.spend(1)
        return False
