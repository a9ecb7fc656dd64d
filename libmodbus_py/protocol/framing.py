"""
Frames: a unit and a PDU as bytes on TCP, UDP, an RTU line or an ASCII line.

There are no sockets or clocks here, only bytes. A framer handles one direction of one
connection:

* ``encode(frame)`` returns the bytes to send;
* ``feed(data)`` takes received bytes, cut anywhere, and returns the frames that are complete,
  oldest first. Bytes that are not a frame raise a FrameError after the frames before them were
  returned: the next call raises it, which can be ``feed(b"")``;
* ``silence()`` tells the framer that the line has been quiet for `quiet` seconds;
* ``pending`` is the number of bytes that wait for the rest of their frame.

TCP: MODBUS Messaging on TCP/IP V1.0b, section 3. RTU and ASCII: MODBUS over
Serial Line V1.02, sections 2.5.1 and 2.5.2.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .frames import (
    Frame,
    Framer,
    Framing,
    OverheardResponse,
    Role,
    TcpFramer,
    UdpFramer,
    checked_frame,
    cut,
    is_one_frame,
    split,
)
from .scan import ALLOWANCE, MAX_ADU, crc16, lib

if TYPE_CHECKING:
    from .pdu import Request

# fmt: off
__all__ = [
    "LINE_FEED", "AsciiFramer", "Frame", "Framer", "Framing", "OverheardResponse", "RtuFramer",
    "TcpFramer", "UdpFramer", "crc16", "cut", "delimiter_after", "is_delimiter", "is_one_frame",
    "lrc", "make_framer", "pdu_of", "split", "transaction_of",
]
# fmt: on

_CRC = struct.Struct("<H")


def rtu(_transaction: int, unit: int, pdu: bytes) -> bytes:
    """Return a PDU between a unit and a CRC; nothing is checked."""
    body = bytes([unit]) + pdu
    return body + _CRC.pack(lib.crc16(body, len(body)))


class RtuFramer(Framer):
    """
    The framer of RTU: unit, PDU, CRC.

    `rtu` has the rules by which it finds frames. A server also receives the responses of other
    units, which are not taken for requests.

    Args:
        role: "server" if it receives requests, "client" if it receives responses.
        pause: seconds between two frames on the line, as `pause_between_frames` returns; 0 if
            bytes do not arrive at the pace of a serial line, as over TCP.
        own: the request of a client whose class has its own rule for the length of the response.

    Attributes:
        is_ours: for a server, a function that returns True for the units that it answers itself,
            and False for units that may be others on the line; by default True for all units.
    """

    quiet: float
    max_size = MAX_ADU

    def __init__(self, role: Role, pause: float = 0.0, own: Request[Any] | None = None) -> None:
        if role not in ("client", "server"):
            raise ValueError(f'role must be "client" or "server", not {role!r}')
        super().__init__()
        from .rtu import RtuCutter  # with all function codes, which no client of TCP needs

        self.quiet = pause + ALLOWANCE
        self._cutter = RtuCutter(role, own)
        self.find_response: Callable[..., bytes | None] = self._cutter.find_response
        self._usual = "request" if role == "server" else "response"
        self._in_run = False  # True if the bytes before the buffer were no frame

    @property
    def is_ours(self) -> Callable[[int], bool]:
        return self._cutter.is_ours

    @is_ours.setter
    def is_ours(self, is_ours: Callable[[int], bool]) -> None:
        if self._usual == "request":
            self._cutter.is_ours = is_ours

    def note_answer(self) -> None:
        self._cutter.begin_anew(len(self.rest))

    def encode(self, frame: Frame) -> bytes:
        unit, pdu, number = checked_frame(frame)
        return rtu(number, unit, pdu)

    def _scan(self) -> None:
        data = bytes(self.rest)
        if self._cutter.is_one_frame(data):
            self._results.append(tuple.__new__(Frame, (data[0], data[1:-2], 0)))
            self._in_run = False
            self.rest.clear()
        else:
            self._cut(data, is_silent=False)

    def _scan_silence(self) -> None:
        self._cut(bytes(self.rest), is_silent=True)
        if not self.rest:  # otherwise the byte belongs to the damage before
            self._in_run = False

    def _cut(self, data: bytes, *, is_silent: bool) -> None:
        pieces, count = self._cutter.cut(data, is_silent=is_silent)
        for start, end, kind in pieces:
            if kind != "damage":
                frame_class = Frame if kind == self._usual else OverheardResponse
                self._results.append(frame_class(data[start], data[start + 1 : end - 2]))
            elif not self._in_run:
                self._report("bytes without a fitting CRC", data[start:end])
            self._in_run = kind == "damage"
        del self.rest[:count]


LINE_FEED = ord("\n")
"""The last byte of ASCII frames, unless the device was set to another one."""

QUIET, QUIET_AFTER_CR = 1.0, 0.1
"""Seconds of silence that end an ASCII frame which is unfinished, and one without a delimiter."""

_DIGITS = re.compile(rb"(?:[0-9A-Fa-f]{2})*")
_RESTART_COMMUNICATIONS = b"\x08\0\x01"
_CHANGE_DELIMITER = b"\x08\0\x03"


def is_delimiter(value: int) -> bool:
    """Return True if a byte may end ASCII frames: below 80h, and no colon, CR or hex digit."""
    return 0 <= value <= 0x7F and chr(value) not in ":\r0123456789ABCDEFabcdef"


def delimiter_after(pdu: bytes, delimiter: int) -> int:
    """
    Return the delimiter of ASCII frames after a device has answered with a PDU.

    Function 8, sub-function 3 changes it, if its data are a valid delimiter and 00;
    sub-function 1 (restart) sets it to LF.

    Args:
        pdu: the response, which is equal to the request.
        delimiter: the previous delimiter.
    """
    if pdu[:3] == _RESTART_COMMUNICATIONS:
        return LINE_FEED
    if pdu[:3] == _CHANGE_DELIMITER and pdu[4:] == b"\0" and is_delimiter(pdu[3]):
        return pdu[3]
    return delimiter


def lrc(data: bytes) -> int:
    """
    Compute the LRC of an ASCII frame: two's complement of the sum of its bytes.

    The bytes are the decoded ones, not the characters (serial line, 2.5.2.2).
    """
    return -sum(data) & 0xFF


class AsciiFramer(Framer):
    """
    The framer of ASCII: a colon; unit, PDU and LRC in hexadecimal digits; CR; a delimiter.

    Digits are sent in upper case, and accepted in both. Everything before a colon is skipped, and a
    colon inside a frame starts a new one. A frame may also end with the delimiter alone, or with a
    CR alone, behind which a colon or 0.1 seconds of silence follow.

    Attributes:
        delimiter: the byte after CR, which is LF unless it is changed (function 8,
            sub-function 3); it applies to frames sent and received from then on.
        quiet: the longest gap in a frame (2.5.2.1); 0.1 behind a CR.
    """

    max_size = 513

    def __init__(self) -> None:
        super().__init__()
        self.delimiter = LINE_FEED
        self.quiet: float = QUIET

    @property
    def delimiter(self) -> int:
        return self._delimiter

    @delimiter.setter
    def delimiter(self, value: int) -> None:
        if not is_delimiter(value):
            raise ValueError(f"delimiter must be an ASCII code with no other use, not {value}")
        self._delimiter = value
        self._end = re.compile(b"[\r" + re.escape(bytes([value])) + b"]")

    def encode(self, frame: Frame) -> bytes:
        unit, pdu, _ = checked_frame(frame)
        body = bytes([unit]) + pdu
        digits = (body + bytes([lrc(body)])).hex().upper()
        return b":%s\r%c" % (digits.encode(), self._delimiter)

    def _scan(self) -> None:
        while True:
            self._skip_to_colon()
            end = self._find_end()
            if end < 0 or self.rest[end:] == b"\r":
                break
            self._take(end)
        self.quiet = QUIET_AFTER_CR if self.rest[-1:] == b"\r" else QUIET
        if len(self.rest) >= self.max_size:
            why = f"a frame of more than {self.max_size} characters"
            self._reject(why, len(self.rest), overrun=True)

    def _scan_silence(self) -> None:
        """Take a frame that ends with CR alone, and drop one that is unfinished."""
        if self.rest[-1:] == b"\r":
            self._take(len(self.rest) - 1)
        elif self.rest:
            self._reject("an unfinished frame", len(self.rest))

    def _find_end(self) -> int:
        """Return the place of the first CR or delimiter; negative if there is none."""
        end = self._end.search(self.rest)
        return -1 if end is None else end.start()

    def _skip_to_colon(self) -> None:
        """Begin the buffer with the last colon before its first end that has one."""
        end = self._find_end()
        while end >= 0 and self.rest.find(b":", 0, end) < 0:
            del self.rest[: end + 1]
            end = self._find_end()
        last = end if end >= 0 else len(self.rest)
        first = self.rest.find(b":", 0, last)
        if first < 0:
            self.rest.clear()
            return
        del self.rest[:first]
        if colon := self.rest.rfind(b":", 0, last - first):
            self._reject("a colon inside a frame", colon, overrun=colon > self.max_size)

    def _take(self, end: int) -> None:
        digits = bytes(self.rest[1:end])
        is_cr, behind = self.rest[end] == ord("\r"), bytes(self.rest[end + 1 : end + 2])
        count = end + 1 + (is_cr and behind == bytes([self._delimiter]))
        if is_cr and count == end + 1 and behind not in (b"", b":"):
            self._reject("a frame without its delimiter", count)
        elif not _DIGITS.fullmatch(digits):
            self._reject("a frame with other characters than pairs of digits", count)
        elif not 6 <= len(digits) <= self.max_size - 3:
            why = f"a frame of {len(digits)} digits, not 6..510"
            self._reject(why, count, overrun=len(digits) > 6)
        elif sum(body := bytes.fromhex(digits.decode())) & 0xFF:
            self._reject("a frame with a wrong LRC", count)
        else:
            self._results.append(Frame(body[0], body[1:-1]))
            del self.rest[:count]


_FRAMERS: dict[str, Callable[[Role], Framer]] = {
    "tcp": TcpFramer,
    "udp": UdpFramer,
    "ascii": lambda role: AsciiFramer(),
}


def make_framer(
    framing: Framing, role: Role, pause: float = 0.0, own: Request[Any] | None = None
) -> Framer:
    """
    Return a framer for one direction of one connection.

    Args:
        framing: "tcp", "rtu", "ascii" or "udp".
        role: "server" if it receives requests, "client" if it receives responses.
        pause, own: as for `RtuFramer`; without effect on other framings.

    Raises:
        ValueError: there is no such framing or role.
    """
    if framing == "rtu":
        return RtuFramer(role, pause, own)
    if framing not in _FRAMERS:
        raise ValueError(f'framing must be "tcp", "rtu", "ascii" or "udp", not {framing!r}')
    return _FRAMERS[framing](role)


_PDUS: dict[str, Callable[[bytes], bytes]] = {
    "tcp": lambda adu: adu[7:],
    "udp": lambda adu: adu[7:],
    "rtu": lambda adu: adu[1:-2],
    "ascii": lambda adu: bytes.fromhex(adu[3:-4].decode()),
}


def pdu_of(framing: Framing, adu: bytes) -> bytes:
    """
    Return the PDU of one whole frame that a framer has found or made; nothing is checked.

    Args:
        framing: "tcp", "rtu", "ascii" or "udp".
    """
    return _PDUS[framing](adu)


def transaction_of(framing: Framing, adu: bytes) -> int | None:
    """Return the transaction id of a frame, 0..65535; None for frames without ids."""
    return int.from_bytes(adu[:2]) if framing in ("tcp", "udp") else None
