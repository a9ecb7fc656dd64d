"""
TLS at the server's end of a connection in memory, for peers that do what a test says.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from tests.support.secured import Sealing

from .sockets import MemorySocket

__all__ = ["SecureEnd"]


class SecureEnd:
    """The end of a connection, as a `MemorySocket` of which only plain bytes are seen."""

    def __init__(self, end: MemorySocket) -> None:
        self.other: MemorySocket = end.other
        self.on_input: Callable[[], object] | None = None
        self._end = end
        self._sealing = Sealing()
        self._inbox: deque[bytes] = deque()
        end.on_input = self._take

    @property
    def is_closed(self) -> bool:
        return self._end.is_closed

    @property
    def is_readable(self) -> bool:
        return bool(self._inbox)

    def recv(self, size: int) -> bytes:
        return self._inbox.popleft()

    def send(self, data: bytes) -> int:
        self._sealing.seal(data)
        self._flush()
        return len(data)

    def close(self) -> None:
        if not self._end.is_closed:
            self._sealing.end()
            self._flush()
        self._end.close()

    def _take(self) -> None:
        while not self._end.is_closed and self._end.is_readable:
            try:
                data = self._end.recv(65_536)
            except OSError:
                data = b""
            plain = self._sealing.take(data) if data else b""
            self._flush()
            if plain:
                self._inbox.append(plain)
            if not data or self._sealing.is_ended:
                self._inbox.append(b"")
                self._end.on_input = None
                break
        if self._inbox and self.on_input is not None:
            self.on_input()

    def _flush(self) -> None:
        data = self._sealing.outgoing()
        if data and not self._end.is_closed:
            try:
                self._end.send(data)
            except OSError:
                self._end.close()
