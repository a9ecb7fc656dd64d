"""
Servers that speak TLS as the test says: Python's own ssl at the other end, record by record.

`Sealed` makes the records of TLS 1.3 itself (RFC 8446), for what no library sends: empty
ones, tickets in pieces, one change of keys after the other.
"""

import contextlib
import socket
import ssl
import struct
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Self

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand

from tests.support.peers import Answer, echo

HANDSHAKE, APPLICATION_DATA = 22, 23


class Peer:
    """
    One connection of a server. `sock`: beneath it; `tls`: Python's end; `cut`: how what is sent
    goes out.
    """

    cut: Callable[[bytes], Iterable[bytes]] = staticmethod(lambda data: [data])

    def __init__(self, sock: socket.socket, context: ssl.SSLContext) -> None:
        self.sock = sock
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)

    def shake_hands(self) -> None:
        try:
            self._until_done(self.tls.do_handshake)
        finally:
            self.flush()

    def _until_done(self, do: Callable[[], Any]) -> Any:
        while True:
            try:
                return do()
            except ssl.SSLWantReadError:
                self.flush()
                if not (data := self.sock.recv(16_384)):
                    raise ConnectionResetError from None
                self._incoming.write(data)

    def flush(self) -> None:
        for piece in self.cut(self._outgoing.read()):
            self.sock.sendall(piece)

    def read(self, size: int = 16_384) -> bytes:
        """Return decrypted bytes, or b"" at the end."""
        try:
            data: bytes = self._until_done(lambda: self.tls.read(size))
        except (OSError, ssl.SSLError):
            return b""
        return data

    def request(self) -> bytes:
        """One whole request; b"" at the end."""
        data = b""
        while len(data) < 6 or len(data) < 6 + int.from_bytes(data[4:6], "big"):
            need = 6 if len(data) < 6 else 6 + int.from_bytes(data[4:6], "big")
            if not (piece := self.read(need - len(data))):
                return b""
            data += piece
        return data

    def sealed(self, *pieces: bytes) -> bytes:
        """Each piece in a record of its own, not sent yet."""
        for piece in pieces:
            self.tls.write(piece)
        return self._outgoing.read()

    def write(self, *pieces: bytes) -> None:
        self.sock.sendall(self.sealed(*pieces))

    def end(self) -> bytes:
        """Return a close_notify, which is not sent yet."""
        with contextlib.suppress(ssl.SSLError):
            self.tls.unwrap()
        return self._outgoing.read()

    def answer(self) -> None:
        """Answer one request, if it comes."""
        if request := self.request():
            self.write(echo(request))

    def serve(self, answer: Answer = lambda request: [echo(request)]) -> None:
        """Answer requests to their end."""
        while request := self.request():
            self.write(*answer(request))


Script = Callable[[Peer], object]


class Accepting:
    """
    Talks on one connection after the other, in a thread, and closes each at its end. `connections`:
    how many were accepted.
    """

    def __init__(self, talk: Callable[[socket.socket], object]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.url = f"tls://127.0.0.1:{self.port}"
        self.connections = 0
        self._talk = talk
        self._peers: list[socket.socket] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)

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


class TlsServer(Accepting):
    """
    Shakes hands on one connection after the other, and hands each to a script. `context`: see
    `context_of`; `script`: called with each connection that is through; closes it at its end.
    `resumed`: for each connection that is through, whether it was; `errors`: of handshakes that
    failed; `ended`: how many scripts came to their end, and their connections with them.
    """

    def __init__(self, context: ssl.SSLContext, script: Script = Peer.serve) -> None:
        super().__init__(self._shake_hands)
        self.context = context
        self.script = script
        self.resumed: list[bool] = []
        self.errors: list[Exception] = []
        self.ended = 0

    def _shake_hands(self, peer: socket.socket) -> None:
        sealed = Peer(peer, self.context)
        try:
            sealed.shake_hands()
        except OSError as error:
            self.errors.append(error)
            return
        self.resumed.append(bool(sealed.tls.session_reused))
        try:
            self.script(sealed)
        finally:
            peer.close()
            self.ended += 1


class Sealed:
    """
    The records that a server sends in TLS 1.3, AES-256-GCM with SHA-384, made here. `log`: the
    context's keylog_filename, of which the last connection counts; `count`: how many records were
    sent with these keys before: the tickets.
    """

    def __init__(self, log: Path, count: int = 0) -> None:
        line = next(
            line
            for line in reversed(log.read_text().splitlines())
            if line.startswith("SERVER_TRAFFIC_SECRET_0 ")
        )
        self._secret = bytes.fromhex(line.split()[2])
        self._derive()
        self._count = count

    def _expand(self, label: str, size: int) -> bytes:
        name = b"tls13 " + label.encode()
        info = struct.pack(">HB", size, len(name)) + name + b"\0"
        return HKDFExpand(hashes.SHA384(), size, info).derive(self._secret)

    def _derive(self) -> None:
        self._cipher = AESGCM(self._expand("key", 32))
        self._iv = int.from_bytes(self._expand("iv", 12), "big")
        self._count = 0

    def record(self, data: bytes, kind: int = APPLICATION_DATA) -> bytes:
        header = b"\x17\x03\x03" + (len(data) + 17).to_bytes(2, "big")
        nonce = (self._iv ^ self._count).to_bytes(12, "big")
        self._count += 1
        return header + self._cipher.encrypt(nonce, data + bytes([kind]), header)

    def change_of_keys(self, *, is_answer_wanted: bool = False) -> bytes:
        """KeyUpdate, and new keys from then on."""
        record = self.record(b"\x18\0\0\x01" + bytes([is_answer_wanted]), HANDSHAKE)
        self._secret = self._expand("traffic upd", 48)
        self._derive()
        return record

    def ticket(self, size: int = 100) -> bytes:
        """NewSessionTicket, in no record yet."""
        body = struct.pack(">IIB", 7200, 1, 1) + b"\x01" + size.to_bytes(2, "big") + bytes(size)
        body += b"\0\0"
        return b"\x04" + len(body).to_bytes(3, "big") + body


class Relay:
    """
    Stands between a client and a server on this machine. `port`: of the server; `alter`: what
    becomes of what the server sends, chunk by chunk; `host`: where the client comes.
    """

    def __init__(
        self,
        port: int,
        alter: Callable[[bytes], Iterable[bytes]] = lambda data: [data],
        host: str = "127.0.0.1",
    ) -> None:
        self._target = port
        self._alter = alter
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, 0), family=family)
        self.port: int = self._listener.getsockname()[1]
        place = f"[{host}]" if ":" in host else host
        self.url = f"tls://{place}:{self.port}"
        self._sockets: list[socket.socket] = []
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Self:
        self._start(self._accept)
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._threads[0].join()
        self._listener.close()
        self.cut()
        for thread in self._threads:
            thread.join()
        for entry in self._sockets:
            entry.close()

    def cut(self) -> None:
        """Drop all connections."""
        for entry in self._sockets:
            with contextlib.suppress(OSError):
                entry.shutdown(socket.SHUT_RDWR)

    def _start(self, target: Callable[..., object], *arguments: object) -> None:
        self._threads.append(threading.Thread(target=target, args=arguments))
        self._threads[-1].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                far = socket.create_connection(("127.0.0.1", self._target))
                self._sockets += [near, far]
                self._start(_copy, near, far, lambda data: [data])
                self._start(_copy, far, near, self._alter)


def _copy(
    source: socket.socket, target: socket.socket, alter: Callable[[bytes], Iterable[bytes]]
) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(16_384):
            for piece in alter(data):
                target.sendall(piece)
    with contextlib.suppress(OSError):
        target.shutdown(socket.SHUT_WR)


@contextlib.contextmanager
def raw(talk: Callable[[socket.socket], object]) -> Iterator[str]:
    """A server beneath TLS; gives its URL."""
    with Accepting(talk) as server:
        yield server.url
