"""
Modbus Security at the server: with clients that others wrote.

R-nn are the requirements of MB-TCP-Security-v36.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import logging
import socket
import ssl
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import Access, Context, Device, Fault, Limits, Mapping, Server
from libmodbus_py.protocol.extras import how_to_add
from libmodbus_py.security.role import encode_role
from libmodbus_py.tools.certificates import Identity, make
from tests.simulation.stage import Stage
from tests.support import certificates
from tests.support.attacks import ANSWER_ONE, PATIENCE, READ_MOST, READ_ONE, adu
from tests.support.certificates import Papers
from tests.support.interop import our_tls_server
from tests.support.tls import VERSIONS, TlsClient, context, serving

LOGGER = "libmodbus_py.server.tls"

ONE = adu(READ_ONE)
ONE_ANSWER = adu(ANSWER_ONE)
MOST_ANSWER = adu(bytes([3, 250]) + bytes(250))

VERSION = pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)

# Happens to nobody here, but makes every answer go the way of faults.
NEVER = Fault("no_answer", function=100)

# The server's ways to answer: in C by the chunk, through hooks, with faults.
KINDS: dict[str, tuple[Callable[[], Device], dict[str, Any]]] = {
    "plain": (lambda: Device(Mapping(10, 10, 1000, 1000)), {}),
    "hooked": (lambda: Device(Mapping(10, 10, 1000, 1000), before_read=lambda access: None), {}),
    "faulty": (lambda: Device(Mapping(10, 10, 1000, 1000)), {"faults": {None: [NEVER]}}),
}
KIND = pytest.mark.parametrize("kind", KINDS)


@pytest.fixture
def device() -> Device:
    return Device(Mapping(10, 10, 1000, 1000))


@pytest.fixture
def roles() -> list[str | None]:
    """The roles of those who wrote."""
    return []


@pytest.fixture
def noting(roles: list[str | None]) -> Device:
    """Notes the roles of those who read and write."""

    def note(access: Access) -> None:
        roles.append(access.role)

    return Device(Mapping(10, 10, 1000, 1000), before_write=note, before_read=note)


@pytest.fixture
def served(stage: Stage, papers: Papers, noting: Device) -> Iterator[tuple[Server, int]]:
    with serving(papers, noting) as served:
        yield served


def connect(
    stage: Stage, papers: Papers, port: int, version: ssl.TLSVersion | None = None
) -> TlsClient:
    """Return a client on the stage, after the handshake."""
    told = context(papers, certificates.client(), version)
    return TlsClient(port, told, stage=stage).handshake()


def requests(count: int) -> bytes:
    return b"".join(adu(READ_ONE, number) for number in range(count))


def answers(count: int) -> bytes:
    return b"".join(adu(ANSWER_ONE, number) for number in range(count))


# --- roles --------------------------------------------------------------------------------------


def test_the_role_of_a_certificate_reaches_the_hooks(
    papers: Papers, noting: Device, roles: list[str | None]
) -> None:
    with serving(papers, noting) as (_, port):
        for role in ("Operator", None, "Überwacher"):
            url = f"tls://127.0.0.1:{port}"
            with Context.from_url(url, security=papers.client(role)) as plc:
                plc.write_register(3, 77)
                assert plc.read_holding_registers(3, 1) == [77]
    assert roles == ["Operator"] * 2 + [None] * 2 + ["Überwacher"] * 2


def test_urls_may_say_who_one_is(papers: Papers) -> None:
    device = Device(Mapping(holding_registers=[range(5)]))
    listen = papers.url("tls://127.0.0.1:0", certificates.server())
    with Server(device).background(listen) as running:
        assert "?" not in running.urls[0]
        with Context.from_url(papers.url(running.urls[0], certificates.client())) as plc:
            assert plc.read_holding_registers(0, 5) == [0] * 5


def test_an_authority_below_may_have_signed_if_it_is_shown(
    stage: Stage, served: tuple[Server, int], papers: Papers, roles: list[str | None]
) -> None:
    identity = certificates.client("Chief", issuer=certificates.intermediate())
    with TlsClient(served[1], context(papers, identity), stage=stage).handshake() as client:
        assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
    assert roles == ["Chief"]


# --- versions and suites ------------------------------------------------------------------------

GCM = "AES128-GCM-SHA256"


@pytest.mark.parametrize(
    ("key", "version", "ciphers", "negotiated"),
    [
        ("rsa", "1.2", f"ECDHE-RSA-{GCM}", f"ECDHE-RSA-{GCM}"),
        ("ec", "1.2", f"ECDHE-ECDSA-{GCM}", f"ECDHE-ECDSA-{GCM}"),
        ("rsa", "1.3", None, "TLS_AES_256_GCM_SHA384"),
        ("ec", "1.3", None, "TLS_AES_256_GCM_SHA384"),
    ],
)
def test_the_suites_that_must_be_there_are(
    stage: Stage,
    papers: Papers,
    device: Device,
    key: str,
    version: str,
    ciphers: str | None,
    negotiated: str,
) -> None:
    keys = {"key": certificates.rsa_key()} if key == "rsa" else {}
    security = papers.security(certificates.server(**keys))
    told = context(papers, certificates.client(**keys), VERSIONS[version], ciphers)
    with (
        serving(papers, device, security=security) as (server, port),
        TlsClient(port, told, stage=stage).handshake() as client,
    ):
        assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        assert client.tls.version() == f"TLSv{version}"
        found = client.tls.cipher()
        assert found is not None
        assert found[0] == negotiated
        assert client.tls.compression() is None
        assert server.statistics.handshakes == 1


@pytest.mark.parametrize("key", ["rsa", "ec"])
@pytest.mark.parametrize(
    "ciphers",
    [
        "NULL-SHA256:ECDHE-ECDSA-NULL-SHA:ECDHE-RSA-NULL-SHA",
        "ECDHE-RSA-AES128-SHA:ECDHE-ECDSA-AES128-SHA",
        "AES128-SHA:AES128-SHA256:AES128-GCM-SHA256",  # the server's RSA key as key exchange
        "ECDHE-RSA-AES128-SHA256:ECDHE-ECDSA-AES128-SHA256",  # CBC
        "AECDH-AES128-SHA:ADH-AES128-GCM-SHA256",  # nobody's
    ],
    ids=lambda ciphers: ciphers.partition(":")[0],
)
def test_suites_that_are_weak_are_refused(
    stage: Stage, papers: Papers, device: Device, key: str, ciphers: str
) -> None:
    keys = {"key": certificates.rsa_key()} if key == "rsa" else {}
    security = papers.security(certificates.server(**keys))
    told = context(papers, certificates.client(**keys), VERSIONS["1.2"], f"{ciphers}:@SECLEVEL=0")
    with (
        serving(papers, device, security=security) as (server, port),
        TlsClient(port, told, stage=stage) as client,
    ):
        with pytest.raises(ssl.SSLError, match="HANDSHAKE_FAILURE"):
            client.handshake()
        assert stage.until(lambda: server.statistics.connections == 0)
        assert (server.statistics.handshakes, server.statistics.handshakes_refused) == (0, 1)


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1])
def test_older_versions_are_refused(
    stage: Stage, papers: Papers, served: tuple[Server, int], version: ssl.TLSVersion
) -> None:
    told = context(papers, certificates.client(), version, "ALL:@SECLEVEL=0")
    with (
        TlsClient(served[1], told, stage=stage) as client,
        pytest.raises(ssl.SSLError, match="PROTOCOL_VERSION"),
    ):
        client.handshake()
    assert stage.until(lambda: served[0].statistics.handshakes_refused == 1)


# --- who is refused -----------------------------------------------------------------------------


def tampered() -> Identity:
    """The role of another one under the signature of the authority."""

    class Tampered(Identity):
        @property
        def pem(self) -> bytes:
            changed = self.der.replace(encode_role("Operator"), encode_role("Director"))
            assert changed != self.der
            return ssl.DER_cert_to_PEM_cert(changed).encode()

    good = certificates.client()
    return Tampered(good.certificate, good.key)


def without_its_chain() -> Identity:
    below = certificates.client(issuer=certificates.intermediate())
    return Identity(below.certificate, below.key)


def roles_of(*values: bytes | str) -> Callable[[], Identity]:
    return lambda: certificates.with_roles(certificates.client(), *values)


# Who -> what the log says, and the alert that the client gets; None is a goodbye, for
# Python's ssl cannot send an alert of one's own.
BAD: dict[str, tuple[Callable[[], Identity | None], str, str | None]] = {
    "nobody": (lambda: None, "did not return a certificate", "REQUIRED|HANDSHAKE_FAILURE"),
    "foreign": (
        lambda: certificates.client(issuer=certificates.foreign_authority()),
        "certificate signature failure|self.signed certificate in|unable to get local issuer",
        "UNKNOWN_CA|DECRYPT_ERROR|BAD_CERTIFICATE",
    ),
    "expired": (
        lambda: certificates.client(**certificates.expired()),
        "certificate has expired",
        "CERTIFICATE_EXPIRED",
    ),
    "not yet valid": (
        lambda: certificates.client(**certificates.not_yet_valid()),
        "certificate is not yet valid",
        "BAD_CERTIFICATE",
    ),
    "self-signed": (certificates.self_signed, "self-signed certificate", "UNKNOWN_CA"),
    "server only": (
        lambda: certificates.server_only(),
        "unsuitable certificate purpose",
        "UNSUPPORTED_CERTIFICATE",
    ),
    "tampered": (tampered, "certificate signature failure", "BAD_CERTIFICATE|DECRYPT_ERROR"),
    "no chain": (without_its_chain, "unable to get local issuer certificate", "UNKNOWN_CA"),
    "two roles": (roles_of("Operator", "Admin"), "two roles", None),
    "IA5String": (roles_of(b"\x16\x08Operator"), "the role", None),
    "no DER": (roles_of(b"Operator"), "the role", None),
    "empty": (roles_of(b"\x0c\x00"), "the role", None),
    "overlong": (roles_of(b"\x0c\x82\x01\x00" + b"x" * 256), "the role", None),
    "no UTF-8": (roles_of(b"\x0c\x02\xff\xff"), "the role", None),
}


@VERSION
@pytest.mark.parametrize("who", BAD)
def test_nobody_gets_in_with_a_bad_certificate(
    stage: Stage,
    papers: Papers,
    served: tuple[Server, int],
    roles: list[str | None],
    caplog: pytest.LogCaptureFixture,
    who: str,
    version: ssl.TLSVersion,
) -> None:
    make_identity, logged, alert = BAD[who]
    server, port = served
    identity = make_identity()
    told = context(papers, identity, version)
    with caplog.at_level(logging.INFO, LOGGER):
        for _ in range(2):  # neither at first, nor with the session of the first time
            with TlsClient(port, told, session=None, stage=stage) as client:
                peer = ":".join(map(str, client.socket.getsockname()))
                if alert is None:
                    client.handshake()
                    # It got the goodbye, whatever it sent meanwhile.
                    assert client.ask(ONE, 1) == b""
                else:
                    with pytest.raises(ssl.SSLError, match=alert):
                        client.handshake().ask(ONE, 1)
    statistics = server.statistics
    assert stage.until(lambda: statistics.connections == 0)
    assert (statistics.handshakes, statistics.handshakes_refused) == (0, 2)
    assert statistics.requests == 0
    assert roles == []
    assert len(caplog.records) == 2
    for record in caplog.records:
        assert (record.name, record.levelno) == (LOGGER, logging.INFO)
    message = caplog.messages[-1]
    assert message.startswith(f"{peer}: ")
    assert any(each in message for each in logged.split("|")), message
    if alert is None:  # OpenSSL keeps to itself whose it was that it refused
        assert message.endswith(f"SHA-256 {digest(identity)}")


@VERSION
def test_a_session_of_one_that_was_refused_is_refused(
    stage: Stage, papers: Papers, served: tuple[Server, int], version: ssl.TLSVersion
) -> None:
    """Its role is read when OpenSSL has given the ticket away."""
    told = context(papers, BAD["two roles"][0](), version)
    session = None
    for _ in range(3):
        with TlsClient(served[1], told, session, stage=stage) as client:
            client.handshake()
            assert client.ask(ONE, 1) == b""
            session = client.tls.session
    statistics = served[0].statistics
    assert stage.until(lambda: statistics.handshakes_refused == 3)
    assert (statistics.handshakes, statistics.handshakes_resumed) == (0, 0)


WITHOUT_CRYPTOGRAPHY = """
import sys
sys.modules["cryptography"] = None
import logging
logging.basicConfig(level=logging.INFO, stream=sys.stdout, format="%(message)s")
from libmodbus_py import Device, Mapping, Security, Server
cert, key, trust = sys.argv[1:]
security = Security(cert, key, trust=trust)
with Server(Device(Mapping(1, 1, 1, 1)), security=security).background("tls://127.0.0.1:0"):
    sys.stdout.flush()
    sys.stdin.read()
"""


def test_without_cryptography_only_roles_are_refused(papers: Papers) -> None:
    files = papers.files(certificates.server())
    command = [sys.executable, "-c", WITHOUT_CRYPTOGRAPHY, files.cert, files.key, papers.ca]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        with TlsClient(port, context(papers, certificates.client(None))).handshake() as client:
            assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        with TlsClient(port, context(papers, certificates.client("Chief"))).handshake() as client:
            assert client.ask(ONE, 1) == b""
        logged, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert how_to_add("security") in logged


# --- pins ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["one", "several", "with a hash"])
def test_only_those_that_are_pinned_get_in(
    stage: Stage, papers: Papers, device: Device, how: str
) -> None:
    mine = certificates.self_signed(role="Installer")
    files = [papers.files(mine).cert]
    if how != "one":
        files.append(papers.files(certificates.self_signed("another")).cert)
    pin = [*map(str, files), digest(mine)] if how == "with a hash" else files
    security = papers.server(pin=pin if how != "one" else pin[0])
    strangers = [
        certificates.client(),
        certificates.self_signed("a third"),
        certificates.self_signed("Test device", days=2),  # the same name
    ]
    with serving(papers, device, security=security) as (server, port):
        with TlsClient(port, context(papers, mine), stage=stage).handshake() as client:
            assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        for stranger in strangers:
            with (
                TlsClient(port, context(papers, stranger), stage=stage) as client,
                pytest.raises(ssl.SSLError, match=r"UNKNOWN_CA|BAD_CERT|DECRYPT"),
            ):
                client.handshake().ask(ONE, 1)
        assert stage.until(lambda: server.statistics.handshakes_refused == len(strangers))


def digest(identity: Identity | None) -> str:
    assert identity is not None
    return hashlib.sha256(identity.der).hexdigest()


def test_what_a_pinned_one_has_signed_is_not_pinned(
    stage: Stage, papers: Papers, device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    """OpenSSL takes it, for the pinned one is what it trusts."""
    security = papers.server(pin=papers.authority(certificates.authority()))
    with (
        caplog.at_level(logging.INFO, LOGGER),
        serving(papers, device, security=security) as (server, port),
        connect(stage, papers, port) as client,
    ):
        assert client.ask(ONE, 1) == b""
        assert (server.statistics.handshakes, server.statistics.handshakes_refused) == (0, 1)
    assert "none of the pins" in caplog.text


def test_a_pinned_one_must_be_good_for_clients(
    stage: Stage, papers: Papers, device: Device
) -> None:
    """OpenSSL looks at the extended key usage, and cannot be told not to."""
    mine = certificates.server_only()
    security = papers.server(pin=papers.files(mine).cert)
    with serving(papers, device, security=security) as (_, port):
        told = context(papers, mine)
        with (
            TlsClient(port, told, stage=stage) as client,
            pytest.raises(ssl.SSLError, match="UNSUPPORTED"),
        ):
            client.handshake().ask(ONE, 1)


@VERSION
def test_a_pinned_one_may_be_old_also_when_it_resumes(
    stage: Stage, papers: Papers, device: Device, version: ssl.TLSVersion
) -> None:
    mine = certificates.self_signed(**certificates.expired())
    told = context(papers, mine, version)
    security = papers.server(pin=papers.files(mine).cert)
    session = None
    with serving(papers, device, security=security) as (server, port):
        for _ in range(2):
            with TlsClient(port, told, session, stage=stage).handshake() as client:
                assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
                session = client.tls.session
        assert server.statistics.handshakes_resumed == 1


# --- sessions resumed ---------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["1.2", "1.2 without tickets", "1.3"])
def test_a_session_that_is_resumed_keeps_its_role(
    stage: Stage, papers: Papers, served: tuple[Server, int], roles: list[str | None], how: str
) -> None:
    server, port = served
    told = context(papers, certificates.client("Chief"), VERSIONS[how[:3]])
    if how.endswith("tickets"):
        told.options |= ssl.OP_NO_TICKET
    session = None
    for turn in range(3):
        with TlsClient(port, told, session, stage=stage).handshake() as client:
            assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
            assert client.tls.session_reused == (turn > 0)
            session = client.tls.session
    assert (server.statistics.handshakes, server.statistics.handshakes_resumed) == (3, 2)
    assert roles == ["Chief"] * 3


@VERSION
def test_a_certificate_that_expired_meanwhile_resumes_nothing(
    stage: Stage,
    papers: Papers,
    served: tuple[Server, int],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    version: ssl.TLSVersion,
) -> None:
    """OpenSSL looks at the dates when a session begins, and not again."""
    server, port = served
    end = datetime.now(UTC) + timedelta(hours=1)
    begin = end - timedelta(hours=2)
    told = context(papers, make_client(begin, end), version)
    with TlsClient(port, told, stage=stage).handshake() as client:
        assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        session = client.tls.session
    later = SimpleNamespace(time=lambda: end.timestamp() + 1)
    monkeypatch.setattr("libmodbus_py.security.tunnel.time", later)
    with (
        caplog.at_level(logging.INFO, LOGGER),
        TlsClient(port, told, session, stage=stage) as client,
    ):
        client.handshake()
        assert client.tls.session_reused
        assert client.ask(ONE, 1) == b""
    assert "certificate has expired" in caplog.text
    assert server.statistics.handshakes_refused == 1


def make_client(begin: datetime, end: datetime) -> Identity:
    days = (end - begin) / timedelta(days=1)
    return make("Test client", certificates.authority(), role="Chief", begin=begin, days=days)


# --- requests and records -----------------------------------------------------------------------


@VERSION
@KIND
@pytest.mark.parametrize(
    "cut",
    ["a record", "a byte in a record", "a record in bytes", "two records", "one and a half"],
)
def test_records_may_cut_requests_anywhere(
    stage: Stage, papers: Papers, kind: str, cut: str, version: ssl.TLSVersion
) -> None:
    make_device, options = KINDS[kind]
    sent = requests(50)
    with (
        serving(papers, make_device(), **options) as (server, port),
        connect(stage, papers, port, version) as client,
    ):
        if cut == "a record":
            client.send(sent)
        elif cut == "a byte in a record":
            client.send(*(bytes([byte]) for byte in sent))
        elif cut == "a record in bytes":
            for byte in client.encrypt(sent):
                client.socket.send(bytes([byte]))
        else:
            end = 7 if cut == "two records" else 18
            client.send(sent[:end])
            stage.pass_time(1)
            client.send(sent[end:])
        assert client.receive(len(answers(50))) == answers(50)
        assert server.statistics.requests == 50


@KIND
@pytest.mark.parametrize("rate", [None, 1000])
@pytest.mark.parametrize("cuts", [[12], [12, 24], [12, 30], [12, 36, 40]], ids=repr)
def test_records_read_together_are_carried_out_in_order(
    stage: Stage, papers: Papers, kind: str, cuts: list[int], rate: int | None
) -> None:
    """The first holds one request and nothing else; what follows does not overtake it."""
    pdus = ("06 0000 0005", "03 0000 0001", "06 0000 0006", "03 0000 0001")
    answers = ("06 0000 0005", "03 02 0005", "06 0000 0006", "03 02 0006")
    requests, expected = (
        b"".join(adu(bytes.fromhex(pdu), number) for number, pdu in enumerate(each))
        for each in (pdus, answers)
    )
    edges = [0, *cuts, len(requests)]
    pieces = [requests[start:end] for start, end in itertools.pairwise(edges)]
    make_device, options = KINDS[kind]
    with (
        serving(papers, make_device(), **options, limits=Limits(requests_per_second=rate)) as (
            server,
            port,
        ),
        connect(stage, papers, port) as client,
    ):
        client.send(*pieces)
        assert client.receive(len(expected)) == expected
        assert server.statistics.requests == 4


def test_a_record_full_of_requests_is_answered_in_slices(stage: Stage, papers: Papers) -> None:
    """Others have their turns between: what one record carries is up to 1365 requests."""
    turns: list[str] = []
    device = Device(
        Mapping(10, 10, 1000, 1000), before_read=lambda access: turns.append(access.peer)
    )
    count = 16_384 // 12
    with (
        serving(papers, device) as (_, port),
        connect(stage, papers, port) as greedy,
        connect(stage, papers, port) as modest,
    ):
        *begin, end = (greedy.encrypt(requests(count)) for _ in range(1))
        assert not begin
        greedy.socket.sendall(end[:-1])
        stage.pass_time(1)  # all but the last byte is with the server
        modest.send(ONE)
        greedy.socket.sendall(end[-1:])
        modest.send(ONE)
        assert modest.receive(2 * len(ONE_ANSWER)) == 2 * ONE_ANSWER
        assert greedy.receive(len(answers(count))) == answers(count)
    modest_name = min(set(turns), key=turns.count)
    runs = "".join("m" if name == modest_name else "g" for name in turns).split("m")
    assert turns.count(modest_name) == 2
    assert len(runs[-1]) > count // 2, [len(run) for run in runs]  # it did not have to wait for all


@VERSION
def test_requests_in_the_last_flight_of_the_handshake_are_answered(
    stage: Stage, papers: Papers, served: tuple[Server, int], version: ssl.TLSVersion
) -> None:
    told = context(papers, certificates.client(), version)
    with TlsClient(served[1], told, stage=stage) as client:
        client.socket.sendall(client.hello())
        # The client's own end of the handshake, and 50 requests behind it, in one segment.
        while True:
            client._incoming.write(client.socket.recv(65536))
            try:
                client.tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                if version == VERSIONS["1.2"]:
                    client._flush()
        client.send(requests(50))
        assert client.receive(len(answers(50))) == answers(50)


@KIND
@VERSION
def test_who_says_goodbye_behind_a_request_gets_the_answer_and_a_goodbye(
    stage: Stage, papers: Papers, kind: str, version: ssl.TLSVersion
) -> None:
    make_device, options = KINDS[kind]
    with serving(papers, make_device(), **options) as (server, port):
        with connect(stage, papers, port, version) as other:
            for count in (1, 2, 1365):
                with connect(stage, papers, port, version) as client:
                    sent = client.encrypt(requests(count))
                    # In one segment, if it is short: both are received in one turn.
                    client.socket.sendall(sent + client.goodbye())
                    other.send(ONE)
                    received = raw_records(client)
                    assert len(received) > len(answers(count))
                    assert other.receive(len(ONE_ANSWER)) == ONE_ANSWER
        assert stage.until(lambda: server.statistics.connections == 0)
        assert server.statistics.requests == 1 + 2 + 1365 + 3
        assert server.statistics.closed_out_of_step == 0


def raw_records(client: TlsClient) -> bytes:
    """Return what the server sends until it closes; ssl reads nothing after its own goodbye."""
    data = b""
    while piece := client.socket.recv(65536):
        data += piece
    return data


def test_what_comes_behind_a_goodbye_is_not_looked_at(
    stage: Stage, papers: Papers, device: Device
) -> None:
    with (
        serving(papers, device) as (server, port),
        connect(stage, papers, port) as client,
    ):
        late = client.encrypt(ONE)
        client.socket.sendall(client.goodbye() + late * 3)
        raw_records(client)
        assert server.statistics.requests == 0


def test_who_closes_his_half_of_tcp_still_gets_his_answers(
    stage: Stage, papers: Papers, device: Device
) -> None:
    with (
        serving(papers, device) as (_, port),
        connect(stage, papers, port) as client,
    ):
        client.send(requests(50))
        client.socket.shutdown(socket.SHUT_WR)
        assert client.receive(len(answers(50))) == answers(50)
        assert client.read() == b""


def test_answers_that_are_kept_back_come_in_order(
    stage: Stage, papers: Papers, device: Device
) -> None:
    late = {None: [Fault("delay", seconds=200, every=3)]}
    with (
        serving(papers, device, faults=late) as (_, port),
        connect(stage, papers, port) as client,
    ):
        client.send(requests(4), *(adu(READ_ONE, number) for number in range(4, 8)))
        assert client.receive(len(answers(8))) == answers(8)


def test_a_header_that_makes_no_sense_closes_after_what_came_before(
    stage: Stage, papers: Papers, device: Device
) -> None:
    with serving(papers, device) as (server, port):
        with connect(stage, papers, port) as client:
            client.send(ONE, b"\0\1\0\0\xff\xff\1\3")
            assert client.receive(len(ONE_ANSWER)) == ONE_ANSWER
            assert client.read() == b""  # with a goodbye
        assert server.statistics.closed_out_of_step == 1


# --- limits -------------------------------------------------------------------------------------


@KIND
def test_who_does_not_read_is_not_answered_for_ever(
    stage: Stage, papers: Papers, kind: str
) -> None:
    make_device, options = KINDS[kind]
    count, limits = 1365, Limits(max_unsent=10_000)
    block = b"".join(adu(READ_MOST, number) for number in range(count))
    told = context(papers, certificates.client())
    with (
        serving(papers, make_device(), limits=limits, **options) as (server, port),
        TlsClient(port, told, stage=stage) as client,
    ):
        client.handshake()
        statistics = server.statistics
        client.socket.settimeout(600)
        sent = 0
        with contextlib.suppress(TimeoutError):
            for _ in range(50):
                client.send(block)
                sent += count
        assert sent < 50 * count
        assert stage.until(lambda: statistics.paused > 0)
        # And a slice at a time: a record has 350 kB of answers.
        before = statistics.requests
        stage.pass_time(600)
        assert statistics.requests == before < sent


def test_who_does_not_read_gets_all_when_he_does(
    stage: Stage, papers: Papers, device: Device
) -> None:
    count, limits = 1365, Limits(max_unsent=1000)
    with (
        serving(papers, device, limits=limits) as (server, port),
        connect(stage, papers, port) as client,
    ):
        block = b"".join(adu(READ_MOST, number) for number in range(count))
        for _ in range(2):  # more answers than the network in memory carries
            client.send(block)
        assert stage.until(lambda: server.statistics.paused > 0)
        for _ in range(2):
            for number in range(count):
                answer = client.receive(len(MOST_ANSWER))
                assert answer[:2] == struct.pack(">H", number)
                assert answer[2:] == MOST_ANSWER[2:]


def test_who_says_goodbye_and_does_not_read_is_not_waited_for(
    stage: Stage, papers: Papers, device: Device
) -> None:
    limits = Limits(frame_timeout=50, max_unsent=2**30)
    block = b"".join(adu(READ_MOST, number) for number in range(1365))
    with (
        serving(papers, device, limits=limits) as (server, port),
        connect(stage, papers, port) as client,
    ):
        sent = client.encrypt(*[block] * 2)  # 700 kB of answers
        client.socket.sendall(sent + client.goodbye())
        begun = stage.now
        assert stage.until(lambda: server.statistics.connections == 0)
        assert server.statistics.requests == 2 * 1365
        assert 50 <= stage.now - begun <= 51.1
        assert server.statistics.closed_slow == 1


@KIND
def test_requests_per_second_hold_within_a_record(stage: Stage, papers: Papers, kind: str) -> None:
    make_device, options = KINDS[kind]
    limits = Limits(requests_per_second=200)
    with (
        serving(papers, make_device(), limits=limits, **options) as (server, port),
        connect(stage, papers, port) as client,
    ):
        begin = stage.now
        client.send(requests(800))
        assert client.receive(len(answers(800))) == answers(800)
        # 200 at once, the rest at 200 a second; the last slice is not waited for.
        assert 2.0 < stage.now - begin <= 3.01
        assert server.statistics.throttled > 1


@pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)
def test_who_is_idle_after_the_handshake_stays(
    stage: Stage, papers: Papers, device: Device, version: ssl.TLSVersion
) -> None:
    """Only a frame, or a record, that has begun must end in time."""
    limits = Limits(frame_timeout=0.2, handshake_timeout=5)
    with (
        serving(papers, device, limits=limits) as (server, port),
        connect(stage, papers, port, version) as client,
    ):
        for _ in range(2):
            stage.pass_time(30)
            assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        client.send(b"")
        assert server.statistics.closed_slow == 0


@pytest.mark.parametrize("half", ["frame", "record", "header"])
def test_what_has_begun_must_end_in_time(
    stage: Stage, papers: Papers, device: Device, half: str
) -> None:
    limits = Limits(frame_timeout=30)
    with (
        serving(papers, device, limits=limits) as (server, port),
        connect(stage, papers, port) as client,
    ):
        assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        if half == "frame":
            client.send(ONE[:9])
        else:
            client.socket.sendall(client.encrypt(ONE)[: 3 if half == "header" else 20])
        begun = stage.now
        assert client.read() == b""  # with a goodbye
        assert 30 <= stage.now - begun <= 31.01
        assert server.statistics.closed_slow == 1


@pytest.mark.parametrize("most", [512, 1024])
def test_a_client_may_ask_for_short_records(papers: Papers, most: int) -> None:
    """R-57, R-58; Python has no API to ask for them, so openssl asks."""
    with our_tls_server(papers, Device(Mapping(10, 10, 1000, 1000))) as wire:
        files = papers.files(certificates.client())
        command = (
            *("openssl", "s_client", "-connect", f"127.0.0.1:{wire.port}", "-CAfile", papers.ca),
            *("-cert", files.cert, "-key", files.key, "-quiet", "-maxfraglen", str(most)),
            "-tls1_2",
        )
        with subprocess.Popen(
            [*map(str, command)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(b"".join(adu(READ_MOST, number) for number in range(20)))
            process.stdin.flush()
            received = process.stdout.read(20 * len(MOST_ANSWER))
            process.kill()
        expected = b"".join(struct.pack(">H", number) + MOST_ANSWER[2:] for number in range(20))
        assert received == expected
        sizes = [size for kind, size in records(wire.sent_by("server")) if kind == 23]
    assert len(sizes) >= 20 * len(MOST_ANSWER) // most
    # 8 bytes of nonce and 16 of tag.
    assert max(sizes) <= most + 24


def records(stream: bytes) -> Iterator[tuple[int, int]]:
    """Types and lengths."""
    while len(stream) >= 5:
        kind, _, size = struct.unpack_from(">BHH", stream)
        yield kind, size
        stream = stream[5 + size :]


# --- the end ------------------------------------------------------------------------------------


@VERSION
def test_the_server_says_goodbye_when_it_ends(
    stage: Stage, papers: Papers, device: Device, version: ssl.TLSVersion
) -> None:
    with serving(papers, device) as (_, port):
        client = connect(stage, papers, port, version)
        assert client.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
    with client:
        assert client.read() == b""


def test_the_server_says_goodbye_to_whom_it_closes_for_others(
    stage: Stage, papers: Papers, device: Device
) -> None:
    with (
        serving(papers, device, limits=Limits(max_connections=1)) as (server, port),
        connect(stage, papers, port) as first,
    ):
        assert first.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        with connect(stage, papers, port) as second:
            assert first.read() == b""
            assert second.ask(ONE, len(ONE_ANSWER)) == ONE_ANSWER
        assert server.statistics.closed_for_others == 1


def test_the_server_says_goodbye_to_the_idle(stage: Stage, papers: Papers, device: Device) -> None:
    limits = Limits(idle_timeout=300)
    with (
        serving(papers, device, limits=limits) as (server, port),
        connect(stage, papers, port) as client,
    ):
        begun = stage.now
        assert client.read() == b""
        assert stage.now - begun == pytest.approx(300, abs=1.01)
        assert server.statistics.closed_idle == 1
