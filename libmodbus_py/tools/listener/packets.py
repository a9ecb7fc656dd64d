"""
Packets of pcap and pcapng files, of either byte order and any resolution of times.

Formats: draft-ietf-opsawg-pcap (pcap), draft-ietf-opsawg-pcapng, sections 4.1-4.4.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

from ...system import open_file

# Kinds of blocks of pcapng, the mark of the order of bytes, and options of interfaces.
SECTION, INTERFACE, SIMPLE, PACKET = 0x0A0D0D0A, 1, 3, 6
BYTE_ORDER = 0x1A2B3C4D
TSRESOL, TSOFFSET = 9, 14

# The first bytes of pcap -> the order of bytes, and the ticks of a second.
PCAP = {
    struct.pack(order + "I", magic): (order, ticks)
    for order in "<>"
    for magic, ticks in ((0xA1B2C3D4, 10**6), (0xA1B23C4D, 10**9))
}

# The longest block that is read: longer than any written by this package or saved by Wireshark.
MAX_BLOCK = 1 << 20


class CaptureError(ValueError):
    """A file is not a valid capture, or has no Modbus; the message names the error and the byte."""


class Packet(NamedTuple):
    """A packet: its time, the number of its interface, the type of link (tcpdump.org/linktypes)."""

    at: float
    interface: int
    link_type: int
    data: bytes


class PacketReader:
    """Reads the packets of a file, one at a time."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = os.fspath(path)
        self._file: BinaryIO = open_file(path)
        self._at = 0
        self._order = "<"
        self._interfaces: list[tuple[int, float, int]] = []  # link type, ticks, offset in seconds
        try:
            magic = self._exactly(4, may_end=True)
            if magic in PCAP:
                self._order, ticks = PCAP[magic]
                *_, link_type = self._unpack("HHiIII", self._exactly(20))
                self._interfaces.append((link_type & 0xFFFF, ticks, 0))
                self.packets: Iterator[Packet] = self._pcap()
            elif magic == struct.pack("<I", SECTION):
                self._section(self._block(magic)[1])
                self.packets = self._pcapng()
            else:
                raise self.error("no pcapng or pcap file")
        except struct.error:
            self.close()
            raise self.error("a block that ends too early") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; any number of times."""
        self._file.close()

    def error(self, what: str, at: int | None = None) -> CaptureError:
        """Return an error about a byte of the file; None for the present one."""
        where = self._at if at is None else at
        return CaptureError(f"{self._path}: byte {where}: {what}")

    def _unpack(self, form: str, data: bytes) -> tuple[int, ...]:
        return struct.unpack_from(self._order + form, data)

    def _pcap(self) -> Iterator[Packet]:
        ((link_type, ticks, _),) = self._interfaces
        while head := self._exactly(16, may_end=True):
            seconds, fraction, size, _ = self._unpack("IIII", head)
            if size > MAX_BLOCK:
                raise self.error(f"a packet of {size} bytes", self._at - 16)
            yield Packet(seconds + fraction / ticks, 0, link_type, self._exactly(size))

    def _pcapng(self) -> Iterator[Packet]:
        while head := self._exactly(4, may_end=True):
            try:
                kind, body = self._block(head)
                if kind == SECTION:  # of a capture that was appended
                    self._section(body)
                elif kind == INTERFACE:
                    self._interfaces.append(self._interface(body))
                elif kind in (SIMPLE, PACKET):
                    yield self._packet(kind, body)
            except (struct.error, IndexError):
                raise self.error("a block that ends too early") from None

    def _section(self, body: bytes) -> None:
        self._interfaces.clear()
        if body[:4] != struct.pack(self._order + "I", BYTE_ORDER):
            raise self.error("no pcapng file")

    def _block(self, head: bytes) -> tuple[int, bytes]:
        """Return the kind of a block whose first four bytes were read, and what is in it."""
        start = self._at - 4
        head += self._exactly(4)
        first = b""
        if head[:4] == struct.pack("<I", SECTION):  # a section has an order of its own
            first = self._exactly(4)
            self._order = ">" if first == struct.pack(">I", BYTE_ORDER) else "<"
        kind, size = self._unpack("II", head)
        if not 12 <= size - len(first) <= MAX_BLOCK or size % 4:
            raise self.error(f"no pcapng file: a block of {size} bytes", start)
        body = first + self._exactly(size - 12 - len(first))
        if self._exactly(4) != head[4:]:
            raise self.error("a block whose two lengths differ", start)
        return kind, body

    def _exactly(self, size: int, *, may_end: bool = False) -> bytes:
        data = self._file.read(size)
        if len(data) != size and (data or not may_end):
            raise self.error("the file ends inside a block")
        self._at += size
        return data

    def _interface(self, body: bytes) -> tuple[int, float, int]:
        link_type, _, _ = self._unpack("HHI", body)
        options = dict(pairs(body[8:], self._order))
        exponent = options.get(TSRESOL, b"\x06")[0]
        ticks = 2.0 ** (exponent & 0x7F) if exponent & 0x80 else 10.0**exponent
        (offset,) = self._unpack("q", options.get(TSOFFSET, bytes(8)))
        return link_type, ticks, offset

    def _packet(self, kind: int, body: bytes) -> Packet:
        if kind == SIMPLE:  # without a time, on the first interface
            interface, high, low, size, start = 0, 0, 0, *self._unpack("I", body), 4
        else:
            interface, high, low, size, _ = self._unpack("IIIII", body)
            start = 20
        link_type, ticks, offset = self._interfaces[interface]
        at = (high << 32 | low) / ticks + offset
        return Packet(at, interface, link_type, body[start : start + size])


def pairs(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the options of a block, or the tags of a packet; number 0 is the rest behind them."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(order + "HH", data, at)
        start = at + 4
        at = start + size + -size % 4
        if kind == 0:
            yield kind, data[start:]
            return
        yield kind, data[start : start + size]
