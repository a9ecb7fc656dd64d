"""
Peers that misbehave: one over TCP, one for datagrams and one on a serial line, on the real system.

Each hands its requests to a function of the test, which writes what it likes, when it likes.
`tests.simulation.scripted.Scripted` does the same on a network in memory. `answering` makes such
a function of answers; `mbap`, `echo` and `answer` make the answers.
"""

import contextlib
import heapq
import itertools
import os
import selectors
import socket
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Self, TypeVar

from libmodbus_py import framing
from libmodbus_py.ports.schemes import SCHEMES
from libmodbus_py.tools.testing.wires import open_line, read_what_is_there, write_all

from .secured import Sealing, with_certificates
from .urls import rules_of

T = TypeVar("T")

# A function code that no standard defines.
UNKNOWN_FUNCTION = 0x41

Write = Callable[..., None]
"""Takes bytes to send, or None to close the connection; ``after=`` so many seconds."""

OnRequest = Callable[[bytes, Write], object]
"""Called with each request as it came, and what answers it."""

Answer = Callable[[bytes], Iterable[bytes]]
"""Returns for a request the bytes that answer it, in pieces."""


def answering(*answers: Answer | None) -> OnRequest:
    """Answer as the first says, then as the next; the last goes on. None closes the connection."""
    rest = list(answers)

    def on_request(request: bytes, write: Write) -> None:
        answer = rest[0]
        if len(rest) > 1:
            del rest[0]
        if answer is None:
            write(None)
            return
        for piece in answer(request):
            write(piece)

    return on_request


def ignore(request: bytes, write: Write) -> None:
    """Answer nothing."""


def mbap(request: bytes, pdu: bytes, **changed: int) -> bytes:
    """Answer a TCP request, with fields of the header changed."""
    transaction, _, _, unit = struct.unpack(">HHHB", request[:7])
    header = {"transaction": transaction, "protocol": 0, "length": 1 + len(pdu), "unit": unit}
    header |= changed
    return struct.pack(">HHHB", *header.values()) + pdu


def echo(request: bytes, **changed: int) -> bytes:
    """Answer a read of one register over TCP with its address."""
    return mbap(request, b"\x03\x02" + request[8:10], **changed)


# A table: a peer asks it while a test raises exceptions inside functions of the package.
HAS_HEADER = {scheme: framing in ("tcp", "udp") for scheme, (framing, _) in SCHEMES.items()}


def has_header(scheme: str) -> bool:
    """Return True if the frames of a scheme begin with that of Modbus/TCP."""
    return HAS_HEADER[scheme]


def address_of(request: bytes, scheme: str) -> bytes:
    """Find the address in a request to read registers."""
    if scheme.startswith("ascii"):
        return bytes.fromhex(request[5:9].decode())
    at = 8 if has_header(scheme) else 2
    return request[at : at + 2]


def answer(request: bytes, scheme: str, unit: int | None = None) -> bytes:
    """Answer a read of one register with its address; as that unit, not the one asked."""
    pdu = b"\x03\x02" + address_of(request, scheme)
    if has_header(scheme):
        return mbap(request, pdu) if unit is None else mbap(request, pdu, unit=unit)
    if scheme.startswith("ascii"):
        body = bytes([int(request[1:3], 16) if unit is None else unit]) + pdu
        return b":%s\r\n" % (body + bytes([framing.lrc(body)])).hex().upper().encode()
    body = bytes([request[0] if unit is None else unit]) + pdu
    return body + framing.crc16(body).to_bytes(2, "little")


class Peer:
    """
    Runs in a thread of its own between `__enter__` and `__exit__`. `on_request`: called in that
    thread, with each request and what answers it; `requests`: all that came, oldest first; `times`
    when (time.monotonic); `connections`: how many were made; `url`: where the client goes.
    """

    url: str

    def __init__(self, on_request: OnRequest) -> None:
        self.on_request: OnRequest = on_request
        self.requests: list[bytes] = []
        self.times: list[float] = []
        self.connections: int = 0
        self._selector = selectors.DefaultSelector()
        self._wake, self._sleep = socket.socketpair()
        self._selector.register(self._sleep, selectors.EVENT_READ)
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._thread = threading.Thread(target=self._run, name="peer", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wake.close()
        self._shut()
        self._thread.join()
        self._sleep.close()
        self._selector.close()

    def _shut(self) -> None:
        """End whatever the thread may be held up by."""

    def _close(self) -> None:
        """In the thread, as the last thing."""

    def _read(self, key: selectors.SelectorKey) -> None:
        """Read the available bytes."""
        raise NotImplementedError

    def _note(self, request: bytes, write: Write) -> None:
        self.requests.append(request)
        self.times.append(time.monotonic())
        self.on_request(request, write)

    def _later(self, act: Callable[[], None], after: float) -> None:
        """Call a function now, or in so many seconds."""
        if after:
            heapq.heappush(self._due, (time.monotonic() + after, next(self._numbers), act))
        else:
            act()

    def _run(self) -> None:
        try:
            while True:
                pause = max(0.0, self._due[0][0] - time.monotonic()) if self._due else None
                keys = [key for key, _ in self._selector.select(pause)]
                if any(key.fileobj is self._sleep for key in keys):
                    return
                while self._due and self._due[0][0] <= time.monotonic():
                    heapq.heappop(self._due)[2]()
                for key in keys:
                    self._read(key)
        finally:
            self._close()


class TcpPeer(Peer):
    """
    Answers all connections. `scheme`: of the URL. "tcp" and "tls" have each request cut out whole;
    else whatever came together is one.
    """

    def __init__(self, on_request: OnRequest, scheme: str = "tcp") -> None:
        super().__init__(on_request)
        self._is_cut = has_header(scheme)
        self._sealings: dict[socket.socket, Sealing] | None = {} if scheme == "tls" else None
        self._stack = contextlib.ExitStack()
        if rules_of(scheme).has_path:
            path = f"{self._stack.enter_context(tempfile.TemporaryDirectory())}/peer"
            self._listener = socket.socket(socket.AF_UNIX)
            self._listener.bind(path)
            self._listener.listen()
            self.port: int = 0
            self.url = f"{scheme}://{path}"
        else:
            self._listener = socket.create_server(("127.0.0.1", 0))
            self.port = self._listener.getsockname()[1]
            self.url = with_certificates(f"{scheme}://127.0.0.1:{self.port}")
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._peers: dict[socket.socket, bytearray] = {}

    def drop_all(self) -> None:
        """End every connection."""
        for peer in list(self._peers):
            with contextlib.suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)

    _shut = drop_all

    def _close(self) -> None:
        for peer in list(self._peers):
            self._end(peer)
        self._listener.close()
        self._stack.close()

    def _read(self, key: selectors.SelectorKey) -> None:
        if key.fileobj is self._listener:
            peer, _ = self._listener.accept()
            if self.port:
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.connections += 1
            self._peers[peer] = bytearray()
            if self._sealings is not None:
                self._sealings[peer] = Sealing()
            self._selector.register(peer, selectors.EVENT_READ)
            return
        peer = key.fileobj  # type: ignore[assignment]
        if peer not in self._peers:  # closed meanwhile
            return
        try:
            data = peer.recv(65_536)
        except OSError:
            data = b""
        if not data:
            self._end(peer)
            return
        try:
            self._cut(peer, self._decrypted(peer, data))
        except OSError:
            self._end(peer)

    def _decrypted(self, peer: socket.socket, data: bytes) -> bytes:
        if self._sealings is None:
            return data
        sealing = self._sealings[peer]
        plain = sealing.take(data)
        peer.sendall(sealing.outgoing())
        if sealing.is_ended:
            raise ConnectionResetError
        return plain

    def _cut(self, peer: socket.socket, data: bytes) -> None:
        write = partial(self._write, peer)
        if not self._is_cut:
            self._note(data, write)
            return
        pending = self._peers[peer]
        pending += data
        while len(pending) >= 6:
            size = 6 + int.from_bytes(pending[4:6], "big")
            if len(pending) < size or peer not in self._peers:
                return
            request = bytes(pending[:size])
            del pending[:size]
            self._note(request, write)

    def _write(self, peer: socket.socket, data: bytes | None, after: float = 0.0) -> None:
        self._later(partial(self._send, peer, data), after)

    def _send(self, peer: socket.socket, data: bytes | None) -> None:
        if data is None:
            self._end(peer)
        elif peer in self._peers:
            if self._sealings is not None:
                self._sealings[peer].seal(data)
                data = self._sealings[peer].outgoing()
            with contextlib.suppress(OSError):
                peer.sendall(data)

    def _end(self, peer: socket.socket) -> None:
        if self._peers.pop(peer, None) is not None:
            if self._sealings is not None:
                del self._sealings[peer]
            self._selector.unregister(peer)
            peer.close()


class UdpPeer(Peer):
    """
    Answers datagrams. `scheme`: of the URL; `family`: AF_INET or AF_INET6, on the loopback address;
    `port`: 0 for any that is free. `clients`: the address of each request's sender.
    """

    def __init__(
        self,
        on_request: OnRequest,
        scheme: str = "udp",
        family: int = socket.AF_INET,
        port: int = 0,
    ) -> None:
        super().__init__(on_request)
        host = "::1" if family == socket.AF_INET6 else "127.0.0.1"
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self.clients: list[Any] = []
        self._selector.register(self._socket, selectors.EVENT_READ)
        self.port: int = self._socket.getsockname()[1]
        self.url = f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}"

    def shut(self) -> None:
        """Close the port; to be called by `on_request`."""
        if self._socket.fileno() >= 0:
            self._selector.unregister(self._socket)
            self._socket.close()

    _close = shut

    def _read(self, key: selectors.SelectorKey) -> None:
        request, client = self._socket.recvfrom(65_536)
        self.clients.append(client)
        self._note(request, partial(self._write, client))

    def _write(self, client: Any, data: bytes, after: float = 0.0) -> None:
        self._later(partial(self._socket.sendto, data, client), after)  # type: ignore[arg-type]


class LinePeer(Peer):
    """A unit on a pseudo-terminal. `path`: of the device."""

    def __init__(self, on_request: OnRequest, scheme: str = "rtu") -> None:
        super().__init__(on_request)
        self._master, self._slave, self.path = open_line()
        self._selector.register(self._master, selectors.EVENT_READ)
        self.url = f"{scheme}://{self.path}?baudrate=115200"

    def write(self, data: bytes) -> None:
        """Send without having been asked."""
        write_all(self._master, data)

    def _close(self) -> None:
        os.close(self._master)
        os.close(self._slave)

    def _read(self, key: selectors.SelectorKey) -> None:
        if request := read_what_is_there(self._master):
            self._note(request, self._write)

    def _write(self, data: bytes, after: float = 0.0) -> None:
        self._later(partial(write_all, self._master, data), after)


def peer_at(scheme: str, on_request: OnRequest) -> Peer:
    """Return the peer that a scheme's carrier needs."""
    if rules_of(scheme).is_serial:
        return LinePeer(on_request, scheme)
    if rules_of(scheme).is_datagram:
        return UdpPeer(on_request, scheme)
    return TcpPeer(on_request, scheme)


class FakeServer(TcpPeer):
    """A `TcpPeer` that takes answers: see `answering`. What comes together is one request."""

    def __init__(self, *answers: Answer | None) -> None:
        super().__init__(answering(*answers))
        self._is_cut = False


class FakeUnit(LinePeer):
    """A `LinePeer` that takes answers: see `answering`."""

    def __init__(self, *answers: Answer) -> None:
        super().__init__(answering(*answers))


@contextlib.contextmanager
def mute_port() -> Iterator[int]:
    """A port that answers nothing at all, as a dead host: its backlog is full."""
    with socket.socket() as listener, contextlib.ExitStack() as stack:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(3):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(listener.getsockname())
        yield listener.getsockname()[1]


@contextlib.contextmanager
def refusing() -> Iterator[socket.socket]:
    """A port that refuses connections until it listens, and that nobody else can take."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound


def url_of(bound: socket.socket) -> str:
    return f"tcp://127.0.0.1:{bound.getsockname()[1]}"


def until(condition: Callable[[], T]) -> T:
    """Wait for another thread or process; return what the condition gives when that is true."""
    end = time.monotonic() + 30
    while not (result := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.001)
    return result
