"""
Modbus/TCP in packets of a network: TCP streams are put together, cut into frames, and responses
are paired with requests by their transaction ids.

Headers: RFC 791 (IPv4), RFC 8200 (IPv6), RFC 9293 (TCP), tcpdump.org/linktypes.html (links).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

from ...protocol.framing import Frame
from .packets import Packet
from .pairing import Pairing
from .transaction import Part, TimedFrame, Transaction, misuse_transaction

TCP = 6  # the number of TCP among the protocols of IP
MODBUS_PORT = 502  # the usual port of servers, by which Wireshark recognizes Modbus
FIN_SYN, SYN, RST, ACK = 0x03, 0x02, 0x04, 0x10  # flags of segments
EXTENSIONS = (0, 43, 60)  # headers of IPv6 before that of TCP: hop by hop, routing, destination
IPV4, IPV6, VLANS = 0x0800, 0x86DD, (0x8100, 0x88A8)  # EtherTypes: IPv4, IPv6, tags of VLANs

# Segments behind a gap after which it is taken to be lost, because nothing may fill it.
MAX_WAITING = 32

OnHeard = Callable[[int, TimedFrame], object]


# --- from packets to segments -----------------------------------------------------------------


def _ethernet(data: bytes) -> bytes:
    at = 12
    while int.from_bytes(data[at : at + 2]) in VLANS:
        at += 4
    return _if_ip(int.from_bytes(data[at : at + 2]), data[at + 2 :])


def _if_ip(kind: int, data: bytes) -> bytes:
    return data if kind in (IPV4, IPV6) else b""


LINKS: dict[int, Callable[[bytes], bytes]] = {
    0: lambda data: data[4:],  # NULL: loopback of BSD
    1: _ethernet,
    12: lambda data: data,  # RAW, as BSD and Linux number it
    101: lambda data: data,
    108: lambda data: data[4:],  # LOOP
    113: lambda data: _if_ip(int.from_bytes(data[14:16]), data[16:]),  # LINUX_SLL
    228: lambda data: data,
    229: lambda data: data,
    276: lambda data: _if_ip(int.from_bytes(data[:2]), data[20:]),  # LINUX_SLL2
}
"""Link type -> function that returns the packet of IP in a packet, or nothing."""

Address = tuple[bytes, int]
"""An address of IP, and a port."""


class Segment(NamedTuple):
    """A segment of TCP."""

    source: Address
    target: Address
    number: int
    acknowledged: int
    flags: int
    data: bytes


def _segment(data: bytes) -> Segment | None:
    """Return the segment of TCP in a packet of IP, unless it has another protocol, or is a part."""
    if data[:1] and data[0] >> 4 == 4:
        size, total = (data[0] & 15) * 4, int.from_bytes(data[2:4])
        is_part = int.from_bytes(data[6:8]) & 0x3FFF
        if is_part or data[9] != TCP:
            return None
        # The length is 0 if the network card cuts what was sent into packets.
        return _of_tcp(data[12:16], data[16:20], data[size : total or None])
    if data[:1] and data[0] >> 4 == 6:
        total, following, at = int.from_bytes(data[4:6]), data[6], 40
        end = 40 + total if total else None
        while following in EXTENSIONS:
            following, at = data[at], at + 8 * (data[at + 1] + 1)
        return _of_tcp(data[8:24], data[24:40], data[at:end]) if following == TCP else None
    return None


def _of_tcp(source: bytes, target: bytes, data: bytes) -> Segment:
    source_port, target_port, number, acknowledgement = struct.unpack_from(">HHII", data)
    start, flags = (data[12] >> 4) * 4, data[13]
    ends = (source, source_port), (target, target_port)
    return Segment(*ends, number, acknowledgement, flags, data[start:])


# --- from segments to transactions ------------------------------------------------------------


class TcpStreams:
    """All connections of a capture; `on_heard` is called with each request and response."""

    def __init__(self, on_heard: OnHeard) -> None:
        self._on_heard = on_heard
        self._connections: dict[frozenset[Address], TcpConnection] = {}
        self._count = 0

    def take(self, packet: Packet) -> list[Transaction]:
        """Return the transactions that a packet ends."""
        try:
            segment = _segment(LINKS[packet.link_type](packet.data))
        except (IndexError, struct.error):  # cut off when it was captured
            return []
        if segment is None:
            return []
        key, transactions = frozenset((segment.source, segment.target)), list[Transaction]()
        is_new = segment.flags & FIN_SYN == SYN and not segment.flags & ACK
        if is_new and key in self._connections and not self._connections[key].is_as(segment):
            transactions = self._connections.pop(key).end()
        if key not in self._connections:
            self._count += 1
            self._connections[key] = TcpConnection(self._count, self._on_heard, segment)
        transactions += self._connections[key].take(segment, packet.at)
        if segment.flags & RST:
            transactions += self._connections.pop(key).end()
        return transactions

    def end(self) -> list[Transaction]:
        """Return the transactions that the end of the capture ends."""
        connections, self._connections = self._connections, {}
        return [row for stream in connections.values() for row in stream.end()]


class TcpConnection:
    """One connection of TCP: two directions, and the requests without a response yet."""

    def __init__(self, number: int, on_heard: OnHeard, first: Segment) -> None:
        self._number = number
        self._on_heard = on_heard
        self._first = first.number
        ends = (first.source, first.target)
        if first.flags & SYN:
            server = first.source if first.flags & ACK else first.target
        else:  # the port of the protocol, or the lower one
            server = min(ends, key=lambda end: (end[1] != MODBUS_PORT, end[1]))
        self._server = server
        self._directions = {end: Direction() for end in ends}
        self._pairing = Pairing(is_line=False)

    def is_as(self, segment: Segment) -> bool:
        """Return True if a first segment is that of this connection, sent again."""
        return segment.number == self._first

    def take(self, segment: Segment, at: float) -> list[Transaction]:
        """Return the transactions that a segment ends."""
        if segment.flags & ACK:
            self._directions[segment.target].acknowledged = segment.acknowledged
        frames = self._directions[segment.source].take(segment, at)
        return self._paired(frames, is_response=segment.source == self._server)

    def end(self) -> list[Transaction]:
        """Return what the last frames end, and the requests without a response."""
        transactions = []
        for end, direction in self._directions.items():
            transactions += self._paired(direction.rest(), is_response=end == self._server)
        self._pairing.tick(math.inf)
        return transactions + self._ended()

    def _paired(
        self, frames: Iterator[tuple[float, Frame]], *, is_response: bool
    ) -> list[Transaction]:
        for at, frame in frames:
            part: Part = "response" if is_response else "request"
            self._on_heard(self._number, TimedFrame(at, at, part, frame))
            if is_response:
                self._pairing.answer(at, at, frame)
            elif 0 < frame.pdu[0] < 0x80:
                self._pairing.ask(at, at, frame)
            else:
                self._pairing.done.append(misuse_transaction(at, frame))
        return self._ended()

    def _ended(self) -> list[Transaction]:
        # TCP repeats what is lost: a request sent again had a response that the capture lacks.
        transactions, self._pairing.done = self._pairing.done, []
        return [replace(transaction, repeats=0) for transaction in transactions]


class Direction:
    """One direction of a connection: segments in order, without what was sent again, to frames."""

    def __init__(self) -> None:
        self.acknowledged: int | None = None  # by the other end
        self._next: int | None = None
        self._segments: dict[int, tuple[float, bytes]] = {}  # segments behind a gap, by number
        self._data = b""

    def take(self, segment: Segment, at: float) -> Iterator[tuple[float, Frame]]:
        """Yield the time and the frame of each whole ADU."""
        number = segment.number
        if segment.flags & SYN:
            number += 1
        if self._next is None:
            self._next = number
        if segment.data:
            self._segments.setdefault(number & 0xFFFFFFFF, (at, segment.data))
            yield from self._in_order()
            while self._segments and self._is_lost():
                yield from self._over_a_gap()

    def rest(self) -> Iterator[tuple[float, Frame]]:
        """Yield the frames behind gaps that nothing has filled."""
        while self._segments:
            yield from self._over_a_gap()

    def _is_lost(self) -> bool:
        """Return True if the capture lacks what is before the segments that wait."""
        if len(self._segments) > MAX_WAITING:
            return True
        first, end = min(map(self._behind, self._segments)), self.acknowledged
        return end is not None and self._behind(end) >= first

    def _behind(self, number: int) -> int:
        """Return how far a number is behind the next one; less than 0 if it was received."""
        assert self._next is not None
        return (number - self._next + 0x80000000 & 0xFFFFFFFF) - 0x80000000

    def _in_order(self) -> Iterator[tuple[float, Frame]]:
        while self._segments and self._behind(number := min(self._segments, key=self._behind)) <= 0:
            at, data = self._segments.pop(number)
            data = data[-self._behind(number) :]
            if data:
                assert self._next is not None
                self._next = self._next + len(data) & 0xFFFFFFFF
                yield from self._frames(at, data)

    def _over_a_gap(self) -> Iterator[tuple[float, Frame]]:
        self._next = min(self._segments, key=self._behind)
        self._data = b""
        yield from self._in_order()

    def _frames(self, at: float, data: bytes) -> Iterator[tuple[float, Frame]]:
        self._data += data
        while len(self._data) >= 8:
            transaction, protocol, size, unit = struct.unpack_from(">HHHB", self._data)
            if protocol or not 2 <= size <= 254:  # no ADU begins here, but one may with a segment
                self._data = data if len(data) < len(self._data) else b""
                continue
            if len(self._data) < 6 + size:
                return
            pdu, self._data = self._data[7 : 6 + size], self._data[6 + size :]
            yield at, Frame(unit, pdu, transaction)
