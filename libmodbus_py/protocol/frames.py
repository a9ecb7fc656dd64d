"""
Frames, and the base of the framers that find them in received bytes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from .errors import FrameError
from .scan import MAX_PDU

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


class Overheard(Frame):
    """
    A response of another unit on the line, which a server hears.

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
        Take received bytes, and return the frames that they complete.

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

    @abstractmethod
    def _scan_silence(self) -> None: ...

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
