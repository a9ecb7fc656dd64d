"""
Captures: writes traffic as pcapng, which Wireshark decodes without options, and reads it again.

A frame is an exported PDU (link type 252) for the dissector "mbtcp": the PDU after a made-up MBAP
header, from or to port 502 of 10.0.0.UNIT. Bytes that are not a frame are for the dissector
"mbrtu". Each port that was listened to is an interface.

Blocks: draft-ietf-opsawg-pcapng, sections 4.1-4.3. Tags: epan/exported_pdu.h of Wireshark.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import struct
from collections.abc import Iterator

from ...protocol.frames import Frame, is_one_frame, mbap
from .packets import (
    BYTE_ORDER,
    INTERFACE,
    PACKET,
    SECTION,
    Packet,
    PacketReader,
    pairs,
)
from .separator import Candidate, Damage
from .streams import LINKS, MODBUS_PORT
from .transaction import TimedFrame

# The type of link of exported PDUs: LINKTYPE_WIRESHARK_UPPER_PDU.
UPPER_PDU = 252

# The first port that is written for clients.
FIRST_CLIENT_PORT = 49152  # the dynamic ports (RFC 6335)

# Numbers of the format: an option of interfaces, and the tags and values of exported PDUs.
_IF_NAME = 2
_DISSECTOR, _IPV4_SRC, _IPV4_DST, _PORT_TYPE, _SRC_PORT, _DST_PORT = 12, 20, 21, 24, 25, 26
_TCP = 2

CLIENT = bytes([10, 0, 1, 0])

# So long may a program that reads the capture from a pipe take nothing; meanwhile a tap waits.
READER_TIME_S = 1.0

# What an error says of other links.
KNOWN = f"not {', '.join(map(str, sorted({*LINKS, UPPER_PDU})))}"


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _block(kind: int, body: bytes) -> bytes:
    size = 12 + len(body)
    return struct.pack("<II", kind, size) + body + struct.pack("<I", size)


def _tag(kind: int, value: bytes | int) -> bytes:
    value = struct.pack(">I", value) if isinstance(value, int) else _padded(value)
    return struct.pack(">HH", kind, len(value)) + value


def _ports(source: int, target: int) -> bytes:
    return _tag(_PORT_TYPE, _TCP) + _tag(_SRC_PORT, source) + _tag(_DST_PORT, target)


def _opened(path: str) -> io.FileIO:
    """Open a new file, or a pipe or device; raise ValueError if an existing file would be lost."""
    try:
        return open(path, "xb", buffering=0)
    except FileExistsError:
        if os.path.isfile(path):
            raise ValueError(f"{path} exists, and would be overwritten") from None
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno != errno.ENXIO:
            raise
        raise ValueError(f"{path} is a pipe, and no program reads it") from None
    return io.FileIO(descriptor, "wb")


class CaptureWriter:
    """Writes a capture to a new file, a pipe or a device, each frame at once."""

    def __init__(self, path: str | os.PathLike[str], name: str) -> None:
        self._path = os.fspath(path)
        self._file = _opened(self._path)
        self._ids: dict[tuple[int, int], int] = {}
        self._last_id = 0
        section = struct.pack("<IHHq", BYTE_ORDER, 1, 0, -1)
        text = name.encode()[:1000]
        option = struct.pack("<HH", _IF_NAME, len(text)) + _padded(text) + bytes(4)
        interface = struct.pack("<HHI", UPPER_PDU, 0, 0) + option
        try:
            self._write(_block(SECTION, section) + _block(INTERFACE, interface))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; any number of times."""
        self._file.close()

    def write(self, event: TimedFrame, link: int = 0) -> None:
        """Write a frame or damaged bytes of a connection; raise OSError if the disk is full."""
        port = FIRST_CLIENT_PORT + link % (65536 - FIRST_CLIENT_PORT)
        if event.frame is None:
            # The sender is unknown: both ports are those of the client.
            data = _tag(_DISSECTOR, b"mbrtu") + _ports(port, port) + bytes(4) + event.data
        else:
            data = self._exported(event.frame, port, is_request=event.part == "request")
        time = max(round(event.ended * 1_000_000), 0)
        head = struct.pack("<IIIII", 0, time >> 32, time & 0xFFFFFFFF, len(data), len(data))
        self._write(_block(PACKET, head + _padded(data)))

    def _exported(self, frame: Frame, port: int, *, is_request: bool) -> bytes:
        # Responses carry the number of the last request to their unit.
        key = port, frame.unit
        if is_request or key not in self._ids:
            self._last_id = self._last_id % 0xFFFF + 1
            self._ids[key] = self._last_id
        client, unit = (CLIENT, port), (bytes([10, 0, 0, frame.unit]), MODBUS_PORT)
        source, target = (client, unit) if is_request else (unit, client)
        head = _tag(_DISSECTOR, b"mbtcp") + _tag(_IPV4_SRC, source[0]) + _tag(_IPV4_DST, target[0])
        adu = mbap(self._ids[key], frame.unit, frame.pdu)
        if len(self._ids) > 4096:  # connections that are closed
            self._ids.clear()
        return head + _ports(source[1], target[1]) + bytes(4) + adu

    def _write(self, data: bytes) -> None:
        rest = data
        try:
            while rest:  # a pipe may take less, or nothing until its reader goes on
                count = self._file.write(rest)
                if not count and not select.select([], [self._file], [], READER_TIME_S)[1]:
                    raise OSError(errno.EAGAIN, "the reader of the pipe has stopped reading")
                rest = rest[count or 0 :]
        except OSError as error:
            # What is left is valid without a part of a block; a pipe cannot be cut.
            if rest != data:
                with contextlib.suppress(OSError):
                    self._file.truncate(self._file.tell() - len(data) + len(rest))
            raise OSError(error.errno, error.strerror, self._path) from error


class CaptureReader:
    """
    Reads a file of `CaptureWriter`, even if Wireshark has saved it again, or the Modbus/TCP in a
    capture of a network. `events` yields what each packet says, and the number of its connection.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._packets = PacketReader(path)
        self.events: Iterator[tuple[int, Candidate | Damage] | Packet] = self._read()

    def close(self) -> None:
        """Close the file; any number of times."""
        self._packets.close()

    def _read(self) -> Iterator[tuple[int, Candidate | Damage] | Packet]:
        for packet in self._packets.packets:
            if packet.link_type in LINKS:
                yield packet
            elif packet.link_type == UPPER_PDU:
                try:
                    yield self._exported(packet)
                except struct.error:
                    raise self._packets.error("a block that ends too early") from None
            else:
                raise self._packets.error(f"packets of link type {packet.link_type}, {KNOWN}")

    def _exported(self, packet: Packet) -> tuple[int, Candidate | Damage]:
        """Return the number of the connection, and what it said."""
        at = packet.at
        tags = dict(pairs(packet.data, ">"))
        dissector, data = tags.get(_DISSECTOR, b"").rstrip(b"\0"), tags.get(0, b"")
        source, target = (int.from_bytes(tags.get(kind, b"")) for kind in (_SRC_PORT, _DST_PORT))
        asks = target == MODBUS_PORT
        link = packet.interface << 16 | (source if asks else target) & 0xFFFF
        if dissector == b"mbrtu":
            return link, Damage(at, at, data)
        if dissector != b"mbtcp":
            raise self._packets.error("a packet that is for neither mbtcp nor mbrtu")
        if not is_one_frame(data):
            raise self._packets.error("a packet that is not a frame of Modbus/TCP")
        return link, Candidate(at, at, Frame(data[6], data[7:]), asks, not asks)
