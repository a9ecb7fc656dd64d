"""
Servers that speak TLS as the test says: Python's own ssl at the other end, record by record.

`Sealed` makes the records of TLS 1.3 itself (RFC 8446), for what no library sends: empty
ones, tickets in pieces, one change of keys after the other.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from certificates import Papers
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand
from fake import Answer, FakeServer, echo

from libmodbus_py.security.making import Identity

__all__ = ["VERSIONS", "Peer", "Script", "Sealed", "TlsServer", "context_of", "request_of"]

VERSIONS = {"1.2": ssl.TLSVersion.TLSv1_2, "1.3": ssl.TLSVersion.TLSv1_3}

HANDSHAKE, APPLICATION_DATA = 22, 23


def context_of(
    papers: Papers, identity: Identity, version: str | None = None, **options: Any
) -> ssl.SSLContext:
    """Make a server's context; options are attributes of it."""
    files = papers.files(identity)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files.cert, files.key)
    context.load_verify_locations(papers.ca)
    context.verify_mode = ssl.CERT_REQUIRED
    if version is not None:
        context.minimum_version = context.maximum_version = VERSIONS[version]
    for name, value in options.items():
        setattr(context, name, value)
    return context


class Peer:
    """
    One connection of a server.

    Attributes:
        sock: beneath it.
        tls: Python's end.
    """

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
        self.sock.sendall(self._outgoing.read())

    def read(self, size: int = 16_384) -> bytes:
        """What was decrypted; b"" at the end."""
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
        """What says goodbye (close_notify), not sent yet."""
        with contextlib.suppress(ssl.SSLError):
            self.tls.unwrap()
        return self._outgoing.read()

    def serve(self, answer: Answer = lambda request: [echo(request)]) -> None:
        """Answer requests to their end."""
        while request := self.request():
            self.write(*answer(request))


Script = Callable[[Peer], object]


class TlsServer(FakeServer):
    """
    Shakes hands on one connection after the other, and hands each to a script.

    Args:
        context: see `context_of`.
        script: called with each connection that is through; closes it at its end.

    Attributes:
        resumed: for each connection that is through, whether it was.
        errors: of handshakes that failed.
    """

    def __init__(self, context: ssl.SSLContext, script: Script = Peer.serve) -> None:
        super().__init__(None)
        self.url = self.url.replace("tcp:", "tls:")
        self.context = context
        self.script = script
        self.resumed: list[bool] = []
        self.errors: list[Exception] = []

    def _talk(self, peer: socket.socket) -> None:
        made = Peer(peer, self.context)
        try:
            made.shake_hands()
        except OSError as error:
            self.errors.append(error)
            return
        self.resumed.append(bool(made.tls.session_reused))
        self.script(made)


class Sealed:
    """
    The records that a server sends in TLS 1.3, AES-256-GCM with SHA-384, made here.

    Args:
        log: the context's keylog_filename, of which the last connection counts.
        count: how many records were sent with these keys before: the tickets.
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
        made = self.record(b"\x18\0\0\x01" + bytes([is_answer_wanted]), HANDSHAKE)
        self._secret = self._expand("traffic upd", 48)
        self._derive()
        return made

    def ticket(self, size: int = 100) -> bytes:
        """NewSessionTicket, in no record yet."""
        body = struct.pack(">IIB", 7200, 1, 1) + b"\x01" + size.to_bytes(2, "big") + bytes(size)
        body += b"\0\0"
        return b"\x04" + len(body).to_bytes(3, "big") + body


def request_of(address: int) -> bytes:
    """Nothing but the PDU of a read of one register there."""
    return b"\x03" + address.to_bytes(2, "big") + b"\0\x01"
