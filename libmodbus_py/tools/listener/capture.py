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
from typing import BinaryIO

from ...protocol.framing import Frame, is_one_frame, mbap
from ...system import open_file
from .separator import Candidate, Damage
from .transaction import Heard

__all__ = ["CaptureError", "CaptureReader", "CaptureWriter"]

# The type of link of exported PDUs: LINKTYPE_WIRESHARK_UPPER_PDU.
UPPER_PDU = 252

# Ports that are written for devices, by which Wireshark knows Modbus, and for clients.
MODBUS_PORT = 502
FIRST_CLIENT_PORT = 49152  # the dynamic ports (RFC 6335)

# Numbers of the format: kinds of blocks, the mark of the order of bytes, options of interfaces, and
# the tags and values of exported PDUs.
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_BYTE_ORDER = 0x1A2B3C4D
_IF_NAME, _IF_TSRESOL = 2, 9
_DISSECTOR, _IPV4_SRC, _IPV4_DST, _PORT_TYPE, _SRC_PORT, _DST_PORT = 12, 20, 21, 24, 25, 26
_TCP = 2

CLIENT = bytes([10, 0, 1, 0])

# So long may a program that reads the capture from a pipe take nothing; meanwhile a tap waits.
READER_TIME_S = 1.0

# The longest block that is read: longer than any written by this package or saved by Wireshark.
MAX_BLOCK = 1 << 20


class CaptureError(ValueError):
    """A file is not a valid capture of this package; the message names the error and the byte."""


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
        section = struct.pack("<IHHq", _BYTE_ORDER, 1, 0, -1)
        text = name.encode()[:1000]
        option = struct.pack("<HH", _IF_NAME, len(text)) + _padded(text) + bytes(4)
        interface = struct.pack("<HHI", UPPER_PDU, 0, 0) + option
        try:
            self._write(_block(_SECTION, section) + _block(_INTERFACE, interface))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; any number of times."""
        self._file.close()

    def write(self, heard: Heard, link: int = 0) -> None:
        """Write a frame or damaged bytes of a connection; raise OSError if the disk is full."""
        port = FIRST_CLIENT_PORT + link % (65536 - FIRST_CLIENT_PORT)
        if heard.frame is None:
            # The sender is unknown: both ports are those of the client.
            data = _tag(_DISSECTOR, b"mbrtu") + _ports(port, port) + bytes(4) + heard.data
        else:
            data = self._exported(heard.frame, port, is_request=heard.part == "request")
        time = max(round(heard.ended * 1_000_000), 0)
        head = struct.pack("<IIIII", 0, time >> 32, time & 0xFFFFFFFF, len(data), len(data))
        self._write(_block(_PACKET, head + _padded(data)))

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
                written = self._file.write(rest)
                if not written and not select.select([], [self._file], [], READER_TIME_S)[1]:
                    raise OSError(errno.EAGAIN, "the reader of the pipe has stopped reading")
                rest = rest[written or 0 :]
        except OSError as error:
            # What is left is valid without a part of a block; a pipe cannot be cut.
            if rest != data:
                with contextlib.suppress(OSError):
                    self._file.truncate(self._file.tell() - len(data) + len(rest))
            raise OSError(error.errno, error.strerror, self._path) from error


class CaptureReader:
    """Reads a file of `CaptureWriter`, even if Wireshark has saved it again."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = os.fspath(path)
        self._file: BinaryIO = open_file(path)
        self._at = 0
        self._ticks: list[float] = []  # seconds of a tick of each interface
        self.recorded: Iterator[tuple[int, Candidate | Damage]] = self._read()
        try:
            kind, body = self._next_block() or (0, b"")
            if kind != _SECTION or body[:4] != struct.pack("<I", _BYTE_ORDER):
                raise self._error("no pcapng file")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; any number of times."""
        self._file.close()

    def _read(self) -> Iterator[tuple[int, Candidate | Damage]]:
        while (block := self._next_block()) is not None:
            kind, body = block
            try:
                if kind == _SECTION:  # of a capture that was appended
                    self._ticks.clear()
                elif kind == _INTERFACE:
                    self._ticks.append(self._tick(body))
                elif kind == _PACKET:
                    yield self._packet(body)
            except (struct.error, IndexError):
                raise self._error("a block that ends too early") from None

    def _next_block(self) -> tuple[int, bytes] | None:
        start = self._at
        head = self._exactly(8, may_end=True)
        if not head:
            return None
        kind, size = struct.unpack("<II", head)
        if not 12 <= size <= MAX_BLOCK or size % 4:
            raise self._error(f"no pcapng file: a block of {size} bytes", start)
        body = self._exactly(size - 12)
        if self._exactly(4) != head[4:]:
            raise self._error("a block whose two lengths differ", start)
        return kind, body

    def _exactly(self, size: int, *, may_end: bool = False) -> bytes:
        data = self._file.read(size)
        if len(data) != size and (data or not may_end):
            raise self._error("the file ends inside a block")
        self._at += size
        return data

    def _tick(self, body: bytes) -> float:
        """Return the seconds of a tick of an interface."""
        (link_type,) = struct.unpack_from("<H", body)
        if link_type != UPPER_PDU:
            raise self._error(f"packets of link type {link_type}, not {UPPER_PDU}")
        exponent = dict(_pairs(body[8:], "<")).get(_IF_TSRESOL, b"\x06")[0]
        if exponent > 12:
            raise self._error("the unit of times is not a power of ten")
        return 10.0**-exponent

    def _packet(self, body: bytes) -> tuple[int, Candidate | Damage]:
        """Return the number of the connection, and what it said."""
        interface, high, low, size, _ = struct.unpack_from("<IIIII", body)
        at = (high << 32 | low) * self._ticks[interface]
        tags = dict(_pairs(body[20 : 20 + size], ">"))
        dissector, data = tags.get(_DISSECTOR, b"").rstrip(b"\0"), tags.get(0, b"")
        source, target = (int.from_bytes(tags.get(kind, b"")) for kind in (_SRC_PORT, _DST_PORT))
        asks = target == MODBUS_PORT
        link = interface << 16 | (source if asks else target) & 0xFFFF
        if dissector == b"mbrtu":
            return link, Damage(at, at, data)
        if dissector != b"mbtcp":
            raise self._error("a packet that is for neither mbtcp nor mbrtu")
        if not is_one_frame(data):
            raise self._error("a packet that is not a frame of Modbus/TCP")
        return link, Candidate(at, at, Frame(data[6], data[7:]), asks, not asks)

    def _error(self, what: str, at: int | None = None) -> CaptureError:
        where = self._at if at is None else at
        return CaptureError(f"{self._path}: byte {where}: {what}")


def _pairs(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
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
