"""Whom a client over TLS trusts, who refuses it, and what is no TLS: each error says which."""

import contextlib
import hashlib
import os
import re
import socket
import ssl
import struct
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.tools.certificates import Identity
from tests.support import certificates
from tests.support.certificates import Pki, expired, foreign_authority, not_yet_valid, self_signed
from tests.support.clients import Connect
from tests.support.names import NEEDS_IPV6, resolve
from tests.support.peers import until
from tests.support.secured import context_of
from tests.support.tls_clients import LONG, Serving
from tests.support.tls_peers import Peer, Relay, TlsServer, raw


def ask(connect: Connect, url: str, security: Any, until: threading.Event | None = None) -> Any:
    """Connect and ask, or connect, wait, and ask."""
    with connect(url, security=security, timeout=LONG) as plc:
        if until is not None:
            assert until.wait(LONG)
        return plc.read_holding_registers(0, 1)


def refusal(connect: Connect, server: TlsServer, security: Any) -> Any:
    """Fail to connect; no Modbus frame may be sent, and no password asked for."""
    requests: list[bytes] = []
    server.script = lambda peer: requests.append(peer.read())
    with pytest.raises(ModbusConnectionError) as caught:
        ask(connect, server.url, security)
    until(lambda: len(server.errors) + len(server.resumed) == server.connections)
    assert requests in ([], [b""])
    assert server.connections == 1
    return caught.value


BAD: dict[str, tuple[Callable[[], Identity], str]] = {
    "foreign": (
        lambda: certificates.server(issuer=foreign_authority()),
        "certificate signature failure|unable to get local issuer certificate",
    ),
    "expired": (lambda: certificates.server(**expired()), "certificate has expired"),
    "too early": (
        lambda: certificates.server(**not_yet_valid()),
        "certificate is not yet valid( or the system clock is incorrect)?",  # OpenSSL 3.6
    ),
    "wrong address": (
        lambda: certificates.server(hosts=("192.0.2.1", "localhost")),
        "IP address mismatch, certificate is not valid for '127.0.0.1'",
    ),
    "a name like the address": (
        lambda: certificates.server(hosts=("127.0.0.1.example",)),
        "IP address mismatch, certificate is not valid for '127.0.0.1'",
    ),
    "self-signed": (lambda: self_signed(hosts=certificates.HOSTS), "self-signed certificate"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_certificate_is_named_with_its_fault(
    connect: Connect, pki: Pki, serving: Serving, version: str, kind: str
) -> None:
    make, reason = BAD[kind]
    identity = make()
    with serving(identity=identity, version=version) as server:
        error = refusal(connect, server, pki.client())
    place = server.url.removeprefix("tls://")
    assert re.match(f"cannot trust {place}: ({reason}): ", error.args[0])
    self = "self-signed" if kind == "self-signed" else "issued by 'CN=Test authority'"
    begin = f"{identity.certificate.not_valid_before_utc:%Y-%m-%d %H:%M:%S}"
    end = f"{identity.certificate.not_valid_after_utc:%Y-%m-%d %H:%M:%S}"
    name = identity.certificate.subject.rfc4514_string()
    assert f"'{name}', {self}, valid {begin} to {end} UTC" in str(error)
    assert f"SHA-256 {hashlib.sha256(identity.der).hexdigest()}" in str(error)
    assert error.errno is not None
    assert os.strerror(error.errno) == "Key was rejected by service"
    assert isinstance(error.__cause__, ssl.SSLCertVerificationError)
    assert error.endpoint == server.url


@pytest.mark.parametrize(
    ("host", "hosts", "is_good"),
    [
        ("plc.example", ("plc.example",), True),
        ("plc.example", ("other.example",), False),
        ("plc.example", ("*.plc.example",), False),
        ("127.0.0.1", ("127.0.0.1",), True),
        pytest.param("[::1]", ("::1",), True, marks=NEEDS_IPV6),
        pytest.param("[::1]", ("127.0.0.1",), False, marks=NEEDS_IPV6),
        pytest.param("[0:0::1]", ("::1",), True, marks=NEEDS_IPV6),
    ],
)
def test_certificates_must_name_the_host_or_its_address(
    monkeypatch, connect: Connect, pki: Pki, serving: Serving, host, hosts, is_good
) -> None:
    resolve(monkeypatch, "plc.example")
    with (
        serving(identity=certificates.server(hosts=hosts)) as server,
        reachable_at(server.port, host) as url,
        contextlib.nullcontext() if is_good else mismatch(),
        connect(url, security=pki.client(), timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]


def mismatch() -> Any:
    return pytest.raises(ModbusConnectionError, match="mismatch, certificate is not valid for")


@contextlib.contextmanager
def reachable_at(port: int, host: str) -> Iterator[str]:
    """A URL for the host; what comes to IPv6 goes to the server on IPv4."""
    if ":" not in host:
        yield f"tls://{host}:{port}"
        return
    with Relay(port, host="::1") as relay:
        yield f"tls://{host}:{relay.port}"


@pytest.mark.parametrize(
    ("server_name", "hosts"),
    [
        ("plc.example", ("plc.example",)),
        ("plc.plant.example", ("*.plant.example",)),
        ("bücher.example", ("xn--bcher-kva.example",)),
        ("192.0.2.7", ("192.0.2.7",)),
        ("fe80::7%eth0", ("fe80::7",)),
    ],
)
def test_the_server_name_is_compared_instead_of_the_host(
    connect: Connect, pki: Pki, serving: Serving, server_name: str, hosts: tuple[str, ...]
) -> None:
    own = certificates.client()
    with serving(identity=certificates.server(hosts=hosts)) as server:
        security = pki.security(own, server_name=server_name)
        with connect(server.url, security=security, timeout=LONG) as plc:
            assert plc.read_holding_registers(1, 1) == [1]
    with serving() as server:
        error = refusal(connect, server, pki.security(own, server_name=server_name))
    assert "mismatch, certificate is not valid for" in str(error)


@pytest.mark.parametrize("form", ["file", "digits", "colons", "several"])
def test_a_pinned_certificate_is_trusted_whoever_signed_it(
    connect: Connect, pki: Pki, serving: Serving, version: str, form: str
) -> None:
    identity = self_signed(**expired())
    digest = hashlib.sha256(identity.der).hexdigest()
    file = pki.files(identity).cert
    pin: Any = {
        "file": file,
        "digits": digest,
        "colons": ":".join(re.findall("..", digest.upper())),
        "several": [pki.files(self_signed()).cert, digest],
    }[form]
    with serving(identity=identity, version=version) as server:
        security = pki.security(certificates.client(), pin=pin)
        with connect(server.url, security=security, timeout=LONG) as plc:
            assert plc.read_holding_registers(1, 1) == [1]


def test_another_certificate_than_the_pinned_one_is_named(
    connect: Connect, pki: Pki, serving: Serving, version: str
) -> None:
    """Also one that the same authority signed, for the same key."""
    with serving(version=version) as server:
        pin = pki.files(certificates.server(days=7)).cert
        error = refusal(connect, server, pki.security(certificates.client(), pin=pin))
    digest = hashlib.sha256(certificates.server().der).hexdigest()
    assert "it is none of the pins: 'CN=Test server'" in str(error)
    assert f"SHA-256 {digest}" in str(error)


@pytest.mark.parametrize("is_abrupt", [False, True])
def test_the_servers_refusal_of_our_certificate_is_named(
    connect: Connect, pki: Pki, serving: Serving, version: str, is_abrupt: bool
) -> None:
    own = certificates.client(issuer=foreign_authority())
    server = serving(version=version)
    server._talk = partial(refusing, server.context, is_abrupt)
    with server, pytest.raises(ModbusConnectionError) as caught:
        ask(connect, server.url, pki.security(own))
    error = caught.value
    place = server.url.removeprefix("tls://")
    assert f"{place} refused our certificate (tlsv1 alert unknown ca): 'CN=Test client'" in str(
        error
    )
    assert f"SHA-256 {hashlib.sha256(own.der).hexdigest()}" in str(error)
    assert error.errno is not None
    assert os.strerror(error.errno) == "Key was rejected by service"
    assert isinstance(error.__cause__, ssl.SSLError)


def refusing(context: ssl.SSLContext, is_abrupt: bool, sock: socket.socket) -> None:
    """Send the alert and go away; or reset the connection right behind it."""
    with contextlib.suppress(ssl.SSLError):
        Peer(sock, context).shake_hands()
    if is_abrupt:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def test_a_refusal_before_a_reset_is_named(connect: Connect, pki: Pki, serving: Serving):
    """The connection is gone at the request; the server's earlier message is still to be read."""
    own = certificates.client(issuer=foreign_authority())
    event = threading.Event()

    def talk(sock: socket.socket) -> None:
        refusing(server.context, True, sock)
        sock.close()
        event.set()

    server = serving(version="1.3")
    server._talk = talk
    with server, pytest.raises(ModbusConnectionError, match="refused our certificate"):
        ask(connect, server.url, pki.security(own), until=event)


HINT = "it may have refused our certificate"


def closing_behind(flights: int, context: ssl.SSLContext, sock: socket.socket) -> None:
    """Take so many flights of a client, answer those before the last, and close."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    tls = context.wrap_bio(incoming, outgoing, server_side=True)
    for flight in range(flights):
        incoming.write(sock.recv(65_536))
        if flight == flights - 1:
            return
        with pytest.raises(ssl.SSLWantReadError):
            tls.do_handshake()
        sock.sendall(outgoing.read())


@pytest.mark.parametrize(("flights", "is_suspected"), [(1, False), (2, True)])
def test_a_tls_1_2_server_that_closes_after_our_certificate_is_named(
    connect: Connect, tmp_path: Path, flights: int, is_suspected: bool
) -> None:
    pki = Pki(tmp_path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    files = pki.files(certificates.server())
    context.load_cert_chain(files.cert, files.key)
    context.load_verify_locations(pki.ca)
    context.verify_mode = ssl.CERT_REQUIRED
    own = pki.security(certificates.client(issuer=foreign_authority()))
    with (
        raw(partial(closing_behind, flights, context)) as url,
        pytest.raises(ModbusConnectionError, match="no TLS handshake") as caught,
        connect(url, security=own, timeout=30) as plc,
    ):
        plc.read_holding_registers(0, 1)
    assert (HINT in str(caught.value)) is is_suspected


@pytest.mark.parametrize(
    ("says", "text"),
    [
        (bytes.fromhex("0001 0000 0003 01 83 02"), "what answers there is no TLS"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "what answers there is no TLS"),
        (b"SSH-2.0-OpenSSH_9.2p1\r\n", "what answers there is no TLS"),
        (b"\x15\x03\x01\0\x02\x02\x46", "it speaks no TLS 1.2 or newer"),  # protocol_version
        (b"\x15\x03\x03\0\x02\x02\x28", "no cipher in common"),  # handshake_failure
        (b"", "closed by the other side"),
    ],
)
def test_another_protocol_is_named(connect: Connect, pki: Pki, says: bytes, text: str) -> None:
    with (
        raw(lambda sock: sock.sendall(says if sock.recv(4096) else b"")) as url,
        pytest.raises(ModbusConnectionError, match=text) as caught,
    ):
        connect(url, security=pki.client(), timeout=LONG).connect()
    assert url.removeprefix("tls://") in str(caught.value)


@pytest.mark.parametrize(
    ("version", "ciphers", "text"),
    [
        (ssl.TLSVersion.TLSv1_1, "ALL:@SECLEVEL=0", r"it speaks no TLS 1\.2 or newer"),
        # CBC with SHA-1, as TLS 1.2 asks for (RFC 5246, 9) and R-51 forbids.
        (ssl.TLSVersion.TLSv1_2, "AES128-SHA", "no cipher in common"),
    ],
)
def test_a_server_with_too_old_a_version_or_cipher_is_named(
    connect: Connect, pki: Pki, version: ssl.TLSVersion, ciphers: str, text: str
) -> None:
    context = context_of(pki, certificates.server(key=certificates.rsa_key()))
    context.set_ciphers(ciphers)
    with warnings.catch_warnings(action="ignore"):
        context.minimum_version = context.maximum_version = version
    with TlsServer(context) as server, pytest.raises(ModbusConnectionError, match=text):
        connect(server.url, security=pki.client(), timeout=LONG).connect()
    assert server.errors
