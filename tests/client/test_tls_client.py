"""
Modbus Security at the client's end, with servers of Python's ssl that do what the test says.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import socket
import ssl
import struct
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    Device,
    Mapping,
    ModbusConnectionError,
    Server,
    State,
    Traced,
    pdu,
)
from libmodbus_py.tools.certificates import Identity
from tests.support import certificates
from tests.support.certificates import (
    Papers,
    expired,
    foreign_authority,
    not_yet_valid,
    self_signed,
)
from tests.support.clients import Connect, connecting
from tests.support.names import resolve
from tests.support.peers import echo, until
from tests.support.tls_peers import (
    HANDSHAKE,
    Peer,
    Relay,
    Script,
    Sealed,
    TlsServer,
    context_of,
    raw,
)

LONG = 20.0


@pytest.fixture(params=["python", "asyncio"])
def connect(request: pytest.FixtureRequest) -> Iterator[Connect]:
    """Makes clients of both kinds; C carries nothing over TLS."""
    with connecting(request.param) as made:
        yield made


@pytest.fixture(params=["1.2", "1.3"])
def version(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


Serving = Callable[..., Any]


@pytest.fixture
def serving(papers: Papers) -> Serving:
    """Makes a server; options of `context_of`."""

    def make(
        script: Script = Peer.serve,
        identity: Identity | None = None,
        version: str | None = None,
        **options: Any,
    ) -> TlsServer:
        chosen = identity or certificates.server()
        return TlsServer(context_of(papers, chosen, version, **options), script)

    return make


def reads(count: int) -> list[pdu.ReadHoldingRegisters]:
    return [pdu.ReadHoldingRegisters(address, 1) for address in range(count)]


def values(count: int) -> list[list[int]]:
    """The values that `reads` returns with `echo`."""
    return [[address] for address in range(count)]


# --- what goes over it ----------------------------------------------------------------------


@pytest.mark.parametrize("key", ["EC", "RSA"])
def test_both_versions_and_both_kinds_of_keys(
    connect: Connect, papers: Papers, serving: Serving, version: str, key: str
) -> None:
    options = {"key": certificates.rsa_key()} if key == "RSA" else {}
    own = certificates.client(**options)
    with (
        serving(Peer.serve, certificates.server(**options), version) as server,
        connect(server.url, security=papers.security(own), timeout=LONG) as plc,
    ):
        assert [plc.read_holding_registers(each, 1) for each in range(3)] == values(3)
        assert plc.execute_many(reads(300)) == values(300)
    assert server.connections == 1


def test_a_chain_with_an_intermediate(connect: Connect, papers: Papers, serving: Serving) -> None:
    below = certificates.intermediate()
    own = papers.security(certificates.client(issuer=below))
    with (
        serving(identity=certificates.server(issuer=below)) as server,
        connect(server.url, security=own, timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(7, 1) == [7]


def one_byte_records(peer: Peer) -> None:
    peer.serve(lambda request: [bytes([each]) for each in echo(request)])


def one_byte_segments(peer: Peer) -> None:
    while request := peer.request():
        for each in peer.sealed(echo(request)):
            peer.sock.sendall(bytes([each]))


def two_records_apart(peer: Peer) -> None:
    while request := peer.request():
        answer = echo(request)
        peer.write(answer[:5])
        time.sleep(0.02)
        peer.write(answer[5:])


def many_in_one_record(peer: Peer) -> None:
    while request := peer.request():
        answers = echo(request)
        while peer.tls.pending():
            answers += echo(peer.request())
        peer.write(answers)


@pytest.mark.parametrize(
    "script", [one_byte_records, one_byte_segments, two_records_apart, many_in_one_record]
)
def test_records_say_nothing_about_frames(
    connect: Connect, papers: Papers, serving: Serving, version: str, script: Script
) -> None:
    with (
        serving(script, version=version) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        assert [plc.read_holding_registers(each, 1) for each in range(3)] == values(3)
        assert plc.execute_many(reads(40)) == values(40)
    assert server.connections == 1


def test_tickets_changes_of_keys_and_empty_records_between_answers(
    connect: Connect, papers: Papers, serving: Serving, tmp_path: Path
) -> None:
    log = tmp_path / "keys"
    other: list[Callable[[Sealed], bytes]] = [
        lambda sealed: sealed.record(sealed.ticket(), HANDSHAKE),
        lambda sealed: sealed.change_of_keys(),
        lambda sealed: sealed.change_of_keys(is_answer_wanted=True),
        lambda sealed: sealed.record(b""),
    ]

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        turn = 0
        while request := peer.request():
            answer = echo(request)
            make = other[turn % 4]
            before = turn // 4 % 3 == 0
            data = make(sealed) if before else b""
            data += sealed.record(answer[:4])
            data += make(sealed) if turn // 4 % 3 == 1 else b""
            data += sealed.record(answer[4:])
            data += make(sealed) if turn // 4 % 3 == 2 else b""
            peer.sock.sendall(data)
            turn += 1

    with (
        serving(script, version="1.3", keylog_filename=str(log)) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        for each in range(24):
            assert plc.read_holding_registers(each, 1) == [each]
        assert plc.execute_many(reads(100)) == values(100)
    assert server.connections == 1


def test_requests_wait_while_a_ticket_comes_in_pieces(
    connect: Connect, papers: Papers, serving: Serving, tmp_path: Path
) -> None:
    """OpenSSL encrypts nothing in the midst of a message of the handshake's kind."""
    log = tmp_path / "keys"
    halves, asked = threading.Event(), threading.Event()

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        ticket = sealed.ticket()
        peer.sock.sendall(
            sealed.record(echo(peer.request())) + sealed.record(ticket[:20], HANDSHAKE)
        )
        halves.set()
        asked.wait(LONG)
        time.sleep(0.1)
        peer.sock.sendall(sealed.record(ticket[20:], HANDSHAKE))
        while request := peer.request():
            peer.sock.sendall(sealed.record(echo(request)))

    with (
        serving(script, version="1.3", keylog_filename=str(log)) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        assert halves.wait(LONG)
        time.sleep(0.1)
        asked.set()
        assert plc.read_holding_registers(2, 1) == [2]
        assert plc.execute_many(reads(40)) == values(40)
    assert server.connections == 1


def test_the_trace_shows_what_is_inside(connect: Connect, papers: Papers, serving: Serving) -> None:
    seen: list[Traced] = []
    states: list[State] = []
    with (
        serving() as server,
        connect(
            server.url,
            security=papers.client(),
            timeout=LONG,
            trace=seen.append,
            on_state=lambda state, error: states.append(state),
        ) as plc,
    ):
        plc.read_holding_registers(0x0102, 1)
        assert plc.url == server.url
        assert (plc.statistics.requests, plc.statistics.responses) == (1, 1)
        assert plc.statistics.connects == 1
    sent, received = seen
    assert sent.adu[2:].hex() == "0000000601" + "0301020001"
    assert received.adu[2:].hex() == "0000000501" + "03020102"
    assert states == [State.CONNECTING, State.CONNECTED, State.CLOSED]


# --- whom it refuses ------------------------------------------------------------------------


def ask(connect: Connect, url: str, security: Any, until: threading.Event | None = None) -> Any:
    """Connect and ask, or connect, wait, and ask."""
    with connect(url, security=security, timeout=LONG) as plc:
        if until is not None:
            assert until.wait(LONG)
        return plc.read_holding_registers(0, 1)


def refusal(connect: Connect, server: TlsServer, security: Any) -> Any:
    """Connect in vain; nothing of Modbus may go out, and nobody is asked twice."""
    asked: list[bytes] = []
    server.script = lambda peer: asked.append(peer.read())
    with pytest.raises(ModbusConnectionError) as caught:
        ask(connect, server.url, security)
    until(lambda: len(server.errors) + len(server.resumed) == server.connections)
    assert asked in ([], [b""])
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
def test_a_bad_certificate_is_named_with_what_is_wrong(
    connect: Connect, papers: Papers, serving: Serving, version: str, kind: str
) -> None:
    make, reason = BAD[kind]
    identity = make()
    with serving(identity=identity, version=version) as server:
        error = refusal(connect, server, papers.client())
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
        ("[::1]", ("::1",), True),
        ("[::1]", ("127.0.0.1",), False),
        ("[0:0::1]", ("::1",), True),
    ],
)
def test_names_and_addresses(
    monkeypatch: pytest.MonkeyPatch,
    connect: Connect,
    papers: Papers,
    serving: Serving,
    host: str,
    hosts: tuple[str, ...],
    is_good: bool,
) -> None:
    resolve(monkeypatch, "plc.example")
    with (
        serving(identity=certificates.server(hosts=hosts)) as server,
        reachable_at(server.port, host) as url,
        contextlib.nullcontext() if is_good else mismatch(),
        connect(url, security=papers.client(), timeout=LONG) as plc,
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
    if not socket.has_dualstack_ipv6():
        pytest.skip("no IPv6 here")
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
def test_server_name_is_looked_for_instead_of_the_host(
    connect: Connect, papers: Papers, serving: Serving, server_name: str, hosts: tuple[str, ...]
) -> None:
    own = certificates.client()
    with serving(identity=certificates.server(hosts=hosts)) as server:
        security = papers.security(own, server_name=server_name)
        with connect(server.url, security=security, timeout=LONG) as plc:
            assert plc.read_holding_registers(1, 1) == [1]
    with serving() as server:
        error = refusal(connect, server, papers.security(own, server_name=server_name))
    assert "mismatch, certificate is not valid for" in str(error)


@pytest.mark.parametrize("form", ["file", "digits", "colons", "several"])
def test_a_pinned_certificate_is_trusted_whoever_signed_it(
    connect: Connect, papers: Papers, serving: Serving, version: str, form: str
) -> None:
    identity = self_signed(**expired())
    digest = hashlib.sha256(identity.der).hexdigest()
    file = papers.files(identity).cert
    pin: Any = {
        "file": file,
        "digits": digest,
        "colons": ":".join(re.findall("..", digest.upper())),
        "several": [papers.files(self_signed()).cert, digest],
    }[form]
    with serving(identity=identity, version=version) as server:
        security = papers.security(certificates.client(), pin=pin)
        with connect(server.url, security=security, timeout=LONG) as plc:
            assert plc.read_holding_registers(1, 1) == [1]


def test_another_certificate_than_the_pinned_one_is_named(
    connect: Connect, papers: Papers, serving: Serving, version: str
) -> None:
    """Also one that the same authority signed, for the same key."""
    with serving(version=version) as server:
        pin = papers.files(certificates.server(days=7)).cert
        error = refusal(connect, server, papers.security(certificates.client(), pin=pin))
    digest = hashlib.sha256(certificates.server().der).hexdigest()
    assert "it is none of the pins: 'CN=Test server'" in str(error)
    assert f"SHA-256 {digest}" in str(error)


# --- whom the server refuses ----------------------------------------------------------------


@pytest.mark.parametrize("is_abrupt", [False, True])
def test_the_servers_refusal_of_our_certificate_is_told(
    connect: Connect, papers: Papers, serving: Serving, version: str, is_abrupt: bool
) -> None:
    own = certificates.client(issuer=foreign_authority())
    server = serving(version=version)
    server._talk = partial(refusing, server.context, is_abrupt)
    with server, pytest.raises(ModbusConnectionError) as caught:
        ask(connect, server.url, papers.security(own))
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


def test_a_reset_behind_the_refusal_does_not_hide_it(
    connect: Connect, papers: Papers, serving: Serving
) -> None:
    """The request finds the connection gone; what the server said before is still to be read."""
    own = certificates.client(issuer=foreign_authority())
    gone = threading.Event()

    def talk(sock: socket.socket) -> None:
        refusing(server.context, True, sock)
        sock.close()
        gone.set()

    server = serving(version="1.3")
    server._talk = talk
    with server, pytest.raises(ModbusConnectionError, match="refused our certificate"):
        ask(connect, server.url, papers.security(own), until=gone)


# --- what is not a TLS -------------------------------------------------------------------------


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
def test_what_answers_there_is_told(
    connect: Connect, papers: Papers, says: bytes, text: str
) -> None:
    with (
        raw(lambda sock: sock.sendall(says if sock.recv(4096) else b"")) as url,
        pytest.raises(ModbusConnectionError, match=text) as caught,
    ):
        connect(url, security=papers.client(), timeout=LONG).connect()
    assert url.removeprefix("tls://") in str(caught.value)


def test_a_server_of_tls_1_1(connect: Connect, papers: Papers, serving: Serving) -> None:
    context = context_of(papers, certificates.server())
    context.set_ciphers("ALL:@SECLEVEL=0")
    with warnings.catch_warnings(action="ignore"):
        context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
    with (
        TlsServer(context) as server,
        pytest.raises(ModbusConnectionError, match=r"it speaks no TLS 1\.2 or newer"),
    ):
        connect(server.url, security=papers.client(), timeout=LONG).connect()


def test_a_server_without_a_good_cipher(connect: Connect, papers: Papers, serving: Serving) -> None:
    """CBC with SHA-1, as TLS 1.2 asks for (RFC 5246, 9) and R-51 forbids."""
    context = context_of(papers, certificates.server(key=certificates.rsa_key()), "1.2")
    context.set_ciphers("AES128-SHA")
    with (
        TlsServer(context) as server,
        pytest.raises(ModbusConnectionError, match="no cipher in common"),
    ):
        connect(server.url, security=papers.client(), timeout=LONG).connect()
    assert server.errors


# --- sessions -------------------------------------------------------------------------------


def once(peer: Peer) -> None:
    """Answer one request, and say goodbye."""
    peer.answer()
    peer.sock.sendall(peer.end())


def abruptly(peer: Peer) -> None:
    """Answer one request, and go without a word."""
    peer.answer()


def ask_after_each_end(plc: Any, server: TlsServer, times: int) -> None:
    """Ask, and ask again when the server has closed the connection."""
    for each in range(times):
        assert plc.read_holding_registers(each, 1) == [each]
        until(lambda: server.ended == server.connections)


@pytest.mark.parametrize("script", [once, abruptly])
def test_a_new_connection_resumes_the_session(
    connect: Connect, papers: Papers, serving: Serving, version: str, script: Script
) -> None:
    with (
        serving(script, version=version) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        ask_after_each_end(plc, server, 4)
    assert server.resumed == [False, True, True, True]


def test_a_server_that_forgot_the_session(
    connect: Connect, papers: Papers, serving: Serving, version: str
) -> None:
    with (
        serving(once, version=version) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        for _ in range(3):
            ask_after_each_end(plc, server, 1)
            server.context = context_of(papers, certificates.server(), version)
    assert server.resumed == [False] * 3


def alerted(peer: Peer) -> None:
    """Answer one request, and send what cannot be decrypted: bad_record_mac is the answer."""
    peer.answer()
    peer.sock.sendall(b"\x17\x03\x03\0\x20" + bytes(32))
    peer.sock.recv(1000)


def test_no_session_outlives_an_alert(
    connect: Connect, papers: Papers, serving: Serving, version: str
) -> None:
    """R-11."""
    with (
        serving(alerted, version=version) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        for _ in range(3):
            with contextlib.suppress(ModbusConnectionError):
                assert plc.read_holding_registers(0, 1) == [0]
    assert not any(server.resumed)
    assert len(server.resumed) >= 2


def test_no_session_outlives_a_failed_handshake(
    connect: Connect, papers: Papers, serving: Serving, version: str
) -> None:
    with (
        serving(once, version=version) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        ask_after_each_end(plc, server, 1)
        talk, server._talk = server._talk, lambda sock: sock.recv(1)
        with pytest.raises(ModbusConnectionError, match="no TLS handshake"):
            plc.read_holding_registers(1, 1)
        server._talk = talk
        assert asking_again(plc) == [1]
    assert server.resumed == [False, False]


def asking_again(plc: Any) -> Any:
    """Until a connection stands again; the client pauses after failures."""
    end = time.monotonic() + LONG
    while True:
        try:
            return plc.read_holding_registers(1, 1)
        except ModbusConnectionError:
            assert time.monotonic() < end
            time.sleep(0.05)


def test_a_certificate_that_expired_meanwhile_is_not_resumed(
    connect: Connect,
    papers: Papers,
    serving: Serving,
    version: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with (
        serving(once, identity=certificates.server(days=2), version=version) as server,
        connect(server.url, security=papers.client(), timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(1, 1) == [1]
        until(lambda: server.ended)
        now = time.time()
        monkeypatch.setattr(time, "time", lambda: now + 3 * 86_400)
        with pytest.raises(ModbusConnectionError, match="certificate has expired: 'CN=Test"):
            plc.read_holding_registers(1, 1)
        monkeypatch.undo()


def test_our_own_server_knows_who_comes_back(connect: Connect, papers: Papers) -> None:
    roles: list[str | None] = []
    device = Device(
        Mapping(holding_registers=10), before_write=lambda access: roles.append(access.role)
    )
    server = Server(device, security=papers.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        Relay(int(running.urls[0].rpartition(":")[2])) as relay,
        connect(relay.url, security=papers.client(), timeout=LONG) as plc,
    ):
        for each in range(3):
            plc.write_register(0, each)
            relay.cut()
            until(lambda: not server.statistics.connections)
    assert roles == ["Operator"] * 3
    assert (server.statistics.handshakes, server.statistics.handshakes_resumed) == (3, 2)
