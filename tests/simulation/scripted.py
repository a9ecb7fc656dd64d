"""Peers that do what a test says, on a network in memory: over TCP, TLS and UDP, and on a line."""

from collections import deque
from collections.abc import Callable
from typing import Any

from libmodbus_py.ports.endpoint import parse
from tests.support.secured import Sealing, with_certificates

from .lines import Party
from .network import Network
from .sockets import MemorySocket

Write = Callable[..., None]
"""Takes bytes to send, or None to close; and after how many seconds: ``write(data, after=0.5)``."""

OnRequest = Callable[[bytes, Write], object]
"""Called with each request as it came, and what answers it."""


class SecureEnd:
    """The server's end of a connection with TLS, as a `MemorySocket` that has plain bytes only."""

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


class Scripted(Party):
    """
    Hands what comes to `on_request`: over TCP whole MBAP requests, else what arrives together.
    """

    def __init__(self, network: Network, url: str, on_request: OnRequest) -> None:
        self.is_unit: bool = True
        self.on_request: OnRequest = on_request
        self.requests: list[bytes] = []
        self.times: list[float] = []
        self.connections: int = 0
        self.network = network
        self.ends: list[MemorySocket | SecureEnd] = []
        endpoint = parse(url)
        self._has_header = endpoint.framing == "tcp"
        if endpoint.transport == "serial":
            self.url: str = url
            self._line = network.line(endpoint.path)
            self._line.join(self)
        else:
            self._is_secure = endpoint.is_secure
            self.url = with_certificates(network.listen(url, self._accept))

    def drop_all(self) -> None:
        """Reset every connection, as a crash does."""
        for end in self.ends:
            if not end.is_closed:
                end.other.reset()
                end.close()
        self.ends.clear()

    def hear(self, data: bytes) -> None:
        self._note(data, self._write_to_line)

    def _write_to_line(self, data: bytes, after: float = 0.0) -> None:
        self._later(after, self._line.write, self, data)

    def _later(self, after: float, call: Callable[..., object], *args: Any) -> None:
        """Call a function now, or in so many seconds; only writes have an order."""
        if after:
            self.network.events.after(after, call, *args)
        else:
            call(*args)

    def _accept(self, accepted: MemorySocket, address: tuple[str, int]) -> None:
        self.connections += 1
        end = SecureEnd(accepted) if self._is_secure else accepted
        self.ends.append(end)
        pending = bytearray()

        def write(data: bytes | None, after: float = 0.0) -> None:
            self._later(after, _send, end, data)

        def take() -> None:
            while end.is_readable:
                data = _received(end)
                if not data:
                    end.close()
                    return
                if not self._has_header:
                    self._note(data, write)
                    continue
                pending.extend(data)
                while len(pending) >= 6 and len(pending) >= 6 + int.from_bytes(pending[4:6], "big"):
                    size = 6 + int.from_bytes(pending[4:6], "big")
                    request = bytes(pending[:size])
                    del pending[:size]
                    self._note(request, write)

        end.on_input = take

    def _note(self, request: bytes, write: Write) -> None:
        self.requests.append(request)
        self.times.append(self.network.events.now)
        self.on_request(request, write)


def _send(end: MemorySocket | SecureEnd, data: bytes | None) -> None:
    if end.is_closed:
        return
    if data is None:
        end.close()
        return
    try:
        end.send(data)
    except OSError:
        end.close()


def _received(end: MemorySocket | SecureEnd) -> bytes:
    try:
        return end.recv(4096)
    except OSError:
        return b""
