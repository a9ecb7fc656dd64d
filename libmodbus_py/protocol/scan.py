"""
The only import of scan.c: CRCs, and the limits of RTU frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

NOT_BUILT = (
    "libmodbus_py is not built: apt install libmodbus-dev gcc python3-dev,"
    " then pip install the package again"
)

try:
    from ._scan import ffi, lib
except ImportError as error:
    raise ImportError(f"{NOT_BUILT} ({error})") from error

MAX_PDU = 253
"""Bytes of a PDU, function code included (application protocol, section 4.1)."""

__all__ = ["MAX_PDU", "NOT_BUILT", "FrameScanner", "crc16", "lib"]


def crc16(data: bytes | bytearray) -> int:
    """
    Compute the CRC of an RTU frame: polynomial A001h reflected, preset FFFFh.

    On the wire its low byte comes first; over a frame with its CRC it is 0
    (serial line, appendix B).
    """
    crc: int = lib.crc16(ffi.from_buffer(data), len(data))
    return crc


class FrameScanner:
    """
    Finds the frames of one direction of a line.

    Args:
        is_client: whether responses come in.
        rules: function code -> how the length of its PDU is told: a constant of
            scan.h, `base` and `at`; other codes end where their CRC fits.
        ask: the length rule for what is told BY_PYTHON.

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
        for code, (told, base, at) in rules.items():
            self._scan.rules[code] = (True, told, base, at)

    def next(self, data: bytes, start: int = 0, at_end: bool = False) -> int:
        """
        Return the end of the first frame from `start` on; negative if none is complete.

        Args:
            at_end: find the first one that ends with the data, past all that may still be
                completed.
        """
        scan = self._scan
        end: int = lib.next_frame(scan, data, len(data), start, self.fresh, at_end)
        while end == lib.ASK_PYTHON:
            at = scan.start
            length = self._ask(data[at + 1 : at + 1 + MAX_PDU])
            scan.length = lib.UNFINISHED if length is None else min(length, MAX_PDU + 1)
            scan.asked = at
            end = lib.next_frame(scan, data, len(data), at, self.fresh, at_end)
        self.start = scan.start
        return end
