"""
Frames, the base of the framers that find them in received bytes, and the framers of TCP and UDP.
"""

from __future__ import annotations

import contextlib
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import partial
from typing import Literal, NamedTuple

from . import pdu
from .errors import MAX_RECEIVED, FrameError
from .scan import MAX_PDU

Role = Literal["client", "server"]
Framing = Literal["tcp", "rtu", "ascii", "udp"]
"""The bytes around a PDU."""

# In a row, in one scan: a flood of bytes must not cause a flood of errors.
MOST_ERRORS = 8


class Frame(NamedTuple):
    """
    A request or response with its unit.

    Attributes:
        unit: 0..255; on serial lines 0 is a broadcast, and units are 1..247.
        pdu: the function code and the data, 1..253 bytes.
        transaction: the transaction id, 0..65535, on TCP and UDP; 0 elsewhere.
    """

    unit: int
    pdu: bytes
    transaction: int = 0


# As Frame(unit, pdu, transaction), in half the time: bulk reads do little else.
_new_frame: Callable[[tuple[int, bytes, int]], Frame] = partial(tuple.__new__, Frame)


class OverheardResponse(Frame):
    """
    A response of another unit on the line, which a server receives.

    `scan` and `scan_silence` return it among the frames; `feed` and `silence` do not.
    """

    __slots__ = ()


def checked_frame(frame: Frame) -> Frame:
    unit, pdu, transaction = frame
    if not 0 <= unit <= 0xFF:
        raise ValueError(f"unit must be in 0..255, not {unit}")
    if not 0 <= transaction <= 0xFFFF:
        raise ValueError(f"transaction must be in 0..65535, not {transaction}")
    if not 1 <= len(pdu) <= MAX_PDU:
        raise ValueError(f"pdu must hold 1..{MAX_PDU} bytes, not {len(pdu)}")
    return frame


class Framer(ABC):
    """
    The base of all framers, which keeps frames and errors in the order of their bytes.

    Attributes:
        rest: the bytes that wait for the rest of their frame.
    """

    # True if unit 0 addresses every unit, as on a serial line.
    has_broadcast = True
    # Seconds without a byte after which `silence` should be called; None for never.
    quiet: float | None = None

    def __init__(self) -> None:
        # False once the stream cannot be understood any more and must be closed.
        self.in_step: bool = True
        self.rest: bytearray = bytearray()
        self._results: list[Frame | FrameError] = []
        self._error: FrameError | None = None

    @property
    def pending(self) -> int:
        """The number of bytes that wait for the rest of their frame."""
        return len(self.rest)

    def note_answer(self) -> None:  # noqa: B027  # only RTU has no other marks of frames
        """Note that a server answers, so that what it has received so far is no part of a frame."""

    def end(self) -> bytes:
        """Return the bytes of an incomplete frame whose rest will not come, and forget them."""
        rest = bytes(self.rest)
        self.rest.clear()
        return rest

    def feed(self, data: bytes) -> list[Frame]:
        """
        Receive bytes, and return the frames that they complete.

        Raises:
            FrameError: bytes are not a frame, and there is no frame to return before that.
        """
        return self._frames(self.scan(data))

    def silence(self) -> list[Frame]:
        """
        Note that the line has been quiet for `quiet` seconds.

        Raises:
            FrameError: as in `feed`.
        """
        return self._frames(self.scan_silence())

    def scan(self, data: bytes) -> list[Frame | FrameError]:
        """Take received bytes; return frames and errors, in the order of the bytes."""
        self.rest += data
        self._scan()
        frames, self._results = self._results, []
        return frames

    def scan_silence(self) -> list[Frame | FrameError]:
        """As `scan`, for silence."""
        self._scan_silence()
        frames, self._results = self._results, []
        return frames

    @abstractmethod
    def encode(self, frame: Frame) -> bytes:
        """
        Return the bytes of a frame: its PDU, with the header and check bytes of the framing.

        Raises:
            ValueError: unit, transaction or length out of range.
        """

    @abstractmethod
    def _scan(self) -> None: ...

    def _scan_silence(self) -> None:  # noqa: B027
        """Take silence for the end of a frame; on TCP silence ends no frame."""

    def _report(self, why: str, data: bytes | bytearray, *, overrun: bool = False) -> None:
        error = FrameError(why, received=bytes(data))
        error.overrun = overrun
        add_error(self._results, error)

    def _reject(self, why: str, count: int, *, overrun: bool = False) -> None:
        """Drop the first bytes."""
        self._report(why, self.rest[:count], overrun=overrun)
        del self.rest[:count]

    def _frames(self, results: list[Frame | FrameError]) -> list[Frame]:
        frames = [item for item in results if type(item) is Frame]
        errors = [item for item in results if isinstance(item, FrameError)]
        self._error = self._error or (errors[0] if errors else None)
        if not frames and self._error is not None:
            error, self._error = self._error, None
            raise error
        return frames


def add_error(results: list[Frame | FrameError], error: FrameError) -> None:
    """Keep an error, unless it is one of many in a row: the first few are enough."""
    last = results[-MOST_ERRORS:]
    if len(last) < MOST_ERRORS or set(map(type, last)) != {FrameError}:
        results.append(error)


# --- MBAP headers: transaction, protocol, length, unit ----------------------------------------

UNIT, FUNCTION = 6, 7
"""The positions of unit and function code in a frame with an MBAP header."""

_HEADER = struct.Struct(">HHH")
_MBAP = struct.Struct(">HHHB")  # with the unit


def mbap(transaction: int, unit: int, pdu: bytes) -> bytes:
    """Return a PDU with an MBAP header; nothing is checked."""
    return _MBAP.pack(transaction, 0, 1 + len(pdu), unit) + pdu


def cut(data: bytes, start: int, results: list[Frame | FrameError], most: int) -> int:
    """
    Cut out up to `most` frames with MBAP headers, of which the first begins at `start`.

    Args:
        results: takes the frames, and a FrameError for one with a protocol other than 0.

    Returns:
        The index at which the next frame begins; `start` if not even the first one is complete.

    Raises:
        FrameError: a length is not in 2..254, so that the start of the next frame is unknown.
            Frames that `results` has taken before are valid.

    Source: MODBUS Messaging on TCP/IP V1.0b, 3.1.3.
    """
    size = len(data)
    while most and size - start >= 6:
        transaction, protocol, length = _HEADER.unpack_from(data, start)
        end = start + 6 + length
        if not 2 <= length <= 1 + MAX_PDU:
            chunk = data[start : start + MAX_RECEIVED]
            raise FrameError(f"header with length {length}, not 2..254", received=chunk)
        if size < end:
            break
        if protocol != 0:
            chunk = data[start:end]
            error = FrameError(f"header with protocol {protocol}, not 0", received=chunk)
            add_error(results, error)
        else:
            frame = data[start + UNIT], data[start + FUNCTION : end], transaction
            results.append(_new_frame(frame))
        start = end
        most -= 1
    return start


def is_one_frame(data: bytes) -> bool:
    """Return True if the bytes are one whole frame with an MBAP header, and nothing else."""
    size = len(data)
    return (
        8 <= size <= FUNCTION + MAX_PDU
        and size == _HEADER.size + (data[4] << 8 | data[5])
        and not (data[2] or data[3])
    )


def split(data: bytes) -> Iterator[bytes]:
    """Yield the frames of a chunk in which whole frames with MBAP headers follow each other."""
    start, size = 0, len(data)
    while start < size:
        end = start + _HEADER.size + (data[start + 4] << 8 | data[start + 5])
        yield data[start:end]
        start = end


class TcpFramer(Framer):
    """
    The framer of Modbus/TCP: an MBAP header (transaction, protocol, length, unit) before the PDU.

    A frame with a protocol other than 0 is an error. After a length outside 2..254 the start of
    the next frame is unknown, so that every later call raises a FrameError.

    Args:
        role: "client" if it receives responses: one is then taken without the byte that some
            devices count too much in its header, if nothing more has come.
    """

    has_broadcast = False

    def __init__(self, role: Role = "server") -> None:
        super().__init__()
        self._is_client = role == "client"

    def encode(self, frame: Frame) -> bytes:
        unit, pdu, transaction = checked_frame(frame)
        return mbap(transaction, unit, pdu)

    def whole(self, data: bytes) -> tuple[int, bytes, int] | None:
        """
        Return what a `Frame` holds if a chunk is one whole frame, as most are; None if it is not.

        This takes a quarter of the time of `scan`.
        """
        size = len(data)
        if FUNCTION < size <= FUNCTION + MAX_PDU and not self.rest and self.in_step:
            transaction, protocol, length, unit = _MBAP.unpack_from(data)
            if length == size - UNIT and not protocol:
                return unit, data[FUNCTION:], transaction
        return None

    def scan(self, data: bytes) -> list[Frame | FrameError]:
        frame = self.whole(data)
        return super().scan(data) if frame is None else [_new_frame(frame)]

    def _scan(self) -> None:
        if not self.in_step:
            self._reject("stream out of step", len(self.rest))
            return
        try:
            del self.rest[: cut(bytes(self.rest), 0, self._results, len(self.rest))]
        except FrameError as error:
            self.in_step = False
            add_error(self._results, error)
            self.rest.clear()
        if self._is_client and _is_whole_response(self.rest):
            self._results.append(_frame(self.rest))
            self.rest.clear()


class UdpFramer(TcpFramer):
    """
    The framer of Modbus over UDP: one frame of Modbus/TCP in each datagram.

    Every call of ``feed`` or ``scan`` takes one datagram. A datagram that is not exactly one frame
    is an error, and does not affect later ones.
    """

    def _scan(self) -> None:
        datagram = bytes(self.rest)
        self.rest.clear()
        results: list[Frame | FrameError] = []
        with contextlib.suppress(FrameError):
            if cut(datagram, 0, results, 1) == len(datagram):
                self._results += results
                return
        if self._is_client and _is_whole_response(datagram):
            self._results.append(_frame(datagram))
            return
        self._results.append(FrameError("a datagram that is not one frame", received=datagram))


def _is_whole_response(data: bytes | bytearray) -> bool:
    """Return True for a response that lacks one byte by its header, and is complete by its data."""
    count = len(data) - FUNCTION
    if count < 2 or data[2 : FUNCTION - 1] != (count + 2).to_bytes(4):
        return False
    return pdu.response_length(bytes(data[FUNCTION:])) == count


def _frame(data: bytes | bytearray) -> Frame:
    return Frame(data[UNIT], bytes(data[FUNCTION:]), int.from_bytes(data[:2]))
