"""
Peers that misbehave: a TCP server and a serial unit that answer what they are told.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Self

from libmodbus_py.testing.line_ends import open_line, read_what_is_there, write_all

# A request as it came in -> the bytes to answer, in pieces.
Answer = Callable[[bytes], list[bytes]]


class FakeServer:
    """
    Takes one connection after the other, and answers each request as told.

    Args:
        answers: one for each request, in order; the last one goes on. None
            closes the connection.
    """

    def __init__(self, *answers: Answer | None) -> None:
        self._answers = list(answers)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.url = f"tcp://127.0.0.1:{self.port}"
        self.connections = 0
        self.requests: list[bytes] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._peers: list[socket.socket] = []

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        for peer in self._peers:
            with contextlib.suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._listener.close()

    def _serve(self) -> None:
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._peers.append(peer)
            with peer, contextlib.suppress(OSError):
                self._talk(peer)

    def _talk(self, peer: socket.socket) -> None:
        while request := peer.recv(260):
            self.requests.append(request)
            answer = self._answers[0]
            if len(self._answers) > 1:
                del self._answers[0]
            if answer is None:
                return
            for piece in answer(request):
                peer.sendall(piece)


class FakeUnit:
    """The same on a pseudo-terminal; `path` is where the client goes."""

    def __init__(self, *answers: Answer) -> None:
        self._answers = list(answers)
        self._master, self._slave, self.path = open_line()
        self.requests: list[bytes] = []
        self._wake, self._sleep = socket.socketpair()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wake.close()
        self._thread.join()
        self._sleep.close()
        os.close(self._master)
        os.close(self._slave)

    def write(self, data: bytes) -> None:
        """Send without having been asked."""
        write_all(self._master, data)

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._master, self._sleep], [], [])
            if self._sleep in ready:
                return
            if not (request := read_what_is_there(self._master)):
                continue
            self.requests.append(request)
            answer = self._answers[0]
            if len(self._answers) > 1:
                del self._answers[0]
            for piece in answer(request):
                write_all(self._master, piece)


def mbap(request: bytes, pdu: bytes, **changed: int) -> bytes:
    """Answer a TCP request, with fields of the header changed."""
    transaction, _, _, unit = struct.unpack(">HHHB", request[:7])
    header = {"transaction": transaction, "protocol": 0, "length": 1 + len(pdu), "unit": unit}
    header |= changed
    return struct.pack(">HHHB", *header.values()) + pdu


def echo(request: bytes, **changed: int) -> bytes:
    """Answer a read of one register over TCP with its address."""
    return mbap(request, b"\x03\x02" + request[8:10], **changed)


@contextlib.contextmanager
def dead() -> Iterator[int]:
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


def until(condition: Callable[[], object]) -> None:
    """Wait for another thread."""
    end = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)
