"""A TLS client that is none of ours: Python's ssl, with a hand on each record."""

import contextlib
import logging
import socket
import ssl
import struct
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Self

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.tools.certificates import Identity
from tests.simulation.lan import Lan, LanClient
from tests.support import certificates
from tests.support.attacks import ANSWER_ONE, PATIENCE, READ_ONE, adu, connect
from tests.support.certificates import Files, Pki
from tests.support.secured import VERSIONS as VERSIONS

VERSION = pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)

ONE = adu(READ_ONE)
ONE_ANSWER = adu(ANSWER_ONE)


@contextlib.contextmanager
def serving(pki: Pki, device: Device | None = None, **options: Any) -> Iterator[tuple[Server, int]]:
    """Serve a device whose items are 0, unless one is given; give the server and its port."""
    options.setdefault("security", pki.server())
    server = Server(device or Device(Mapping(10, 10, 1000, 1000)), **options)
    with server.background("tls://127.0.0.1:0") as running:
        yield server, parse(running.urls[0]).port


def context(
    pki: Pki,
    identity: Identity | None = None,
    version: ssl.TLSVersion | None = None,
    ciphers: str | None = None,
) -> ssl.SSLContext:
    """
    A client's, which trusts the authority. `identity`: what it shows; None for no certificate;
    `version`: the one it speaks; None for what it can; `ciphers`: of TLS 1.2 and older.
    """
    context_ = ssl.create_default_context(cafile=str(pki.ca))
    if ciphers is not None:
        context_.set_ciphers(ciphers)
    if version is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of the old ones
            context_.minimum_version = context_.maximum_version = version
    if identity is not None:
        files: Files = pki.files(identity)
        context_.load_cert_chain(files.cert, files.key)
    return context_


class TlsClient:
    """
    A connection. `source`: the address that it comes from; `lan`: where the server is, in place
    of the system. `socket`: what the records go over; `tls`: the state of TLS.
    """

    def __init__(
        self,
        port: int,
        context: ssl.SSLContext,
        session: ssl.SSLSession | None = None,
        source: str = "",
        lan: Lan | None = None,
    ) -> None:
        self.socket: Any = lan.client(port, source or None) if lan else connect(port, source=source)
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = context.wrap_bio(
            self._incoming, self._outgoing, server_hostname="localhost", session=session
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def handshake(self) -> Self:
        """Raise `ssl.SSLError`: the server refused, or ended the connection."""
        self._until(self.tls.do_handshake)
        return self

    def hello(self) -> bytes:
        """Return the first flight, for tests that send it themselves."""
        with contextlib.suppress(ssl.SSLWantReadError):
            self.tls.do_handshake()
        return self._outgoing.read()

    def encrypt(self, *pieces: bytes) -> bytes:
        """Make a record of each piece, of up to 16 KiB."""
        for piece in pieces:
            self.tls.write(piece)
        return self._outgoing.read()

    def send(self, *pieces: bytes) -> None:
        self.socket.sendall(self.encrypt(*pieces))

    def goodbye(self) -> bytes:
        """Make a close_notify."""
        with contextlib.suppress(ssl.SSLWantReadError):
            self.tls.unwrap()
        return self._outgoing.read()

    def receive(self, size: int) -> bytes:
        """Return so many bytes; fewer if the server said goodbye before."""
        data = b""
        while len(data) < size and (piece := self.read(size - len(data))):
            data += piece
        return data

    def read(self, most: int = 65536) -> bytes:
        """
        Return what comes next; b"" after a close_notify. Raise `ssl.SSLEOFError`: the server ended
        the connection without a goodbye; `ssl.SSLError`: an alert.
        """
        return self._until(lambda: self.tls.read(most))

    def ask(self, request: bytes, size: int) -> bytes:
        self.send(request)
        return self.receive(size)

    def is_answered(self) -> bool:
        """Return True if a read of one register is answered as `serving` answers it."""
        return self.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER

    def _until(self, act: Callable[[], Any]) -> Any:
        while True:
            try:
                return act()
            except ssl.SSLWantReadError:
                self._flush()
                data = self.socket.recv(65536)
                self._incoming.write(data) if data else self._incoming.write_eof()
            except ssl.SSLZeroReturnError:
                return b""
            finally:
                with contextlib.suppress(OSError):
                    self._flush()

    def _flush(self) -> None:
        if data := self._outgoing.read():
            self.socket.sendall(data)


def connected(lan: Lan, pki: Pki, port: int, version: ssl.TLSVersion | None = None) -> TlsClient:
    """Return a client on the LAN that the server trusts, after the handshake."""
    context_ = context(pki, certificates.client(), version)
    return TlsClient(port, context_, lan=lan).handshake()


@contextlib.contextmanager
def talking(
    lan: Lan,
    pki: Pki,
    device: Device | None = None,
    version: ssl.TLSVersion | None = None,
    **options: Any,
) -> Iterator[tuple[Server, TlsClient]]:
    """Serve on the LAN; give the server and a client, after the handshake."""
    with (
        serving(pki, device, **options) as (server, port),
        connected(lan, pki, port, version) as client,
    ):
        yield server, client


def hello(pki: Pki) -> bytes:
    """A ClientHello of Python's."""
    outgoing = ssl.MemoryBIO()
    tls = context(pki).wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        tls.do_handshake()
    return outgoing.read()


def is_served(pki: Pki, port: int, lan: Lan | None = None) -> bool:
    context_ = context(pki, certificates.client())
    with TlsClient(port, context_, lan=lan).handshake() as client:
        return client.is_answered()


@contextlib.contextmanager
def nothing_loud(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Whatever a peer sends is no error, at most a few warnings, and none of asyncio."""
    with caplog.at_level(logging.INFO):
        yield
    loud = [record for record in caplog.records if record.levelno > logging.INFO]
    assert {(record.levelno, record.name) for record in loud} <= {
        (logging.WARNING, "libmodbus_py.server.serving")
    }
    assert len(loud) <= 20


def reset(connection: socket.socket | LanClient) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def wait_until(is_so: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + PATIENCE
    while not is_so():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def closed(connection: socket.socket | LanClient) -> bytes:
    """Return what still comes until the server closes; a reset is a close, too."""
    data = b""
    with contextlib.suppress(ConnectionError):
        while piece := connection.recv(65536):
            data += piece
    return data
