"""The only import of scan.c: CRCs, the limits of RTU frames, and the silence between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

NOT_BUILT = (
    "libmodbus_py is not built: apt install libmodbus-dev gcc python3-dev,"
    " then pip install the package again"
)

try:
    from ._scan import ffi
    from ._scan import lib as lib
except ImportError as error:
    raise ImportError(f"{NOT_BUILT} ({error})") from error

MAX_PDU = 253
"""Bytes of a PDU, function code included (application protocol, section 4.1)."""

# Bytes of the longest RTU frame, with unit and CRC, and of the shortest, with a function alone.
MAX_ADU, MIN_ADU = MAX_PDU + 3, 4

GOES_ON: int = lib.GOES_ON
SILENT: int = lib.SILENT
AT_END: int = lib.AT_END
NO_FRAME: int = lib.NO_FRAME
UNFINISHED: int = lib.UNFINISHED

ALLOWANCE = 0.02
"""Seconds after which a byte that was received is here: USB adapters keep bytes for 16 ms."""


def crc16(data: bytes | bytearray) -> int:
    """
    Compute the CRC of an RTU frame: polynomial A001h reflected, preset FFFFh.

    On the wire its low byte comes first; over a frame with its CRC it is 0 (serial line, B).
    """
    crc: int = lib.crc16(data if type(data) is bytes else ffi.from_buffer(data), len(data))
    return crc


def is_one_adu(data: bytes) -> bool:
    """Return True if the bytes are one RTU frame by their CRC, whatever its function says."""
    return MIN_ADU <= len(data) <= MAX_ADU and not crc16(data)


def pause_between_frames(baudrate: int, bits: int = 11) -> float:
    """Return the seconds of silence between two frames (serial line, 2.5.1.1)."""
    return 0.00175 if baudrate > 19_200 else 3.5 * max(bits, 11) / baudrate


class FrameScanner:
    """
    Finds the frames of one direction of a line; responses for `is_client`.

    `rules` are function code -> length rule of its PDU: a constant of scan.h, `base` and `at`;
    frames of other codes end with silence, where their CRC fits. `ask` is the rule of those
    BY_PYTHON.

    Attributes:
        fresh: the place in the next data where a frame should begin; negative if it is past.
        start: the place where the last frame began; where one may begin if there was none.
    """

    def __init__(
        self,
        is_client: bool,
        rules: Mapping[int, tuple[int, int, int]],
        ask: Callable[[bytes], int | None],
    ) -> None:
        self._scan: Any = ffi.new("struct scan *", {"is_client": is_client, "asked": -1})
        self._ask = ask
        self.start: int = 0
        self.fresh: int = 0
        for code, (byte_count_at, base, at) in rules.items():
            self._scan.rules[code] = (True, byte_count_at, base, at)

    def next(self, data: bytes, start: int = 0, state: int = GOES_ON) -> int:
        """Return the end of the first frame from `start` on; negative if none is complete."""
        return self._call(lib.next_frame, data, start, state)

    def at(self, data: bytes, start: int, fresh: int, state: int = GOES_ON) -> int:
        """Return the end of the frame that begins at `start`; `NO_FRAME` or `UNFINISHED`."""
        self.fresh = fresh
        end: int = lib.frame_at(self._scan, data, len(data), start, fresh, state)
        return end if end != lib.ASK_PYTHON else self._call(lib.frame_at, data, start, state)

    @property
    def fits(self) -> int:
        """The number of places where the last frame of `at` can end, by its CRC."""
        count: int = self._scan.fits
        return count

    def _call(self, look: Callable[..., int], data: bytes, start: int, state: int) -> int:
        scan = self._scan
        end = look(scan, data, len(data), start, self.fresh, state)
        while end == lib.ASK_PYTHON:
            at = scan.start
            length = self._ask(data[at + 1 : at + 1 + MAX_PDU])
            scan.length = lib.UNFINISHED if length is None else min(length, MAX_PDU + 1)
            scan.asked = at
            end = look(scan, data, len(data), at, self.fresh, state)
        self.start = scan.start
        return end
