"""
Bytes of devices that are no Modbus: a registration packet when one has connected, and heartbeats.

Makers of modems describe both alike: a fixed text, often the number of the SIM card or the modem
(ICCID, IMEI), sent once, or before all data; and a fixed text at intervals. Frames are passed on
whole: a text counts only where a frame may begin or, without a header that tells its end, where the
received bytes end.
"""

from __future__ import annotations

import re

COUNT = re.compile("([0-9]{1,4}) ?bytes?")
HEADER_LENGTH = 6  # of what a Modbus/TCP frame has before the bytes that its length field counts


def greeting_of(name: str, value: object) -> tuple[int, tuple[bytes, ...]]:
    """
    Return how many bytes a device sends when it has connected, and which texts it sends then or
    between frames. An error names the option.
    """
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, not {type(value).__name__}")
    count, texts = 0, []
    for item in value.split(","):
        if number := COUNT.fullmatch(item):
            count += int(number[1])
        elif item.startswith("0x"):
            try:
                texts.append(bytes.fromhex(item[2:]))
            except ValueError:
                raise ValueError(
                    f"{name} must have pairs of hex digits after 0x, not {item!r}"
                ) from None
        else:
            texts.append(item.encode())
    if b"" in texts:
        raise ValueError(
            f'{name} must be such as "20 bytes", "www.example" or "0x0d0a", not {value!r}'
        )
    return count, tuple(texts)


class Greeting:
    """Drops what is no Modbus from the bytes of one device."""

    def __init__(self, count: int, texts: tuple[bytes, ...], *, has_header: bool) -> None:
        self._texts = texts
        self._count = count
        self._has_header = has_header
        self.begin()

    def begin(self) -> None:
        """Note a new connection."""
        self._first = self._count  # how many bytes are still to be dropped
        self._kept = b""  # what may be the beginning of a text or a header
        self._frame = 0  # how many bytes of the current frame are still to come

    def expect_frame(self) -> None:
        """Note that a frame may begin, because what came before was none."""
        self._frame = 0

    def drop(self, data: bytes) -> bytes:
        """Return the received bytes that belong to frames."""
        dropped = min(self._first, len(data))
        self._first -= dropped
        data = self._kept + data[dropped:]
        if not self._texts:
            return data
        self._kept = b""
        frames = b""
        while data:
            if self._frame:
                frames += data[: self._frame]
                self._frame, data = max(0, self._frame - len(data)), data[self._frame :]
            elif text := next(filter(data.startswith, self._texts), b""):
                data = data[len(text) :]
            elif any(text.startswith(data) for text in self._texts):
                self._kept, data = data, b""
            elif not self._has_header:
                return self._without_end(data)
            elif len(data) < HEADER_LENGTH:
                self._kept, data = data, b""
            else:
                self._frame = HEADER_LENGTH + int.from_bytes(data[4:HEADER_LENGTH])
        return frames

    def _without_end(self, data: bytes) -> bytes:
        while text := next(filter(data.endswith, self._texts), b""):
            data = data[: -len(text)]
        return data
