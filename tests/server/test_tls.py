"""
Modbus Security at the server: with clients that others wrote.

R-nn are the requirements of MB-TCP-Security-v36.
"""

import hashlib
import logging
import ssl
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest

from libmodbus_py import Access, Device, Mapping, Server
from libmodbus_py.security.certificates import encode_role
from libmodbus_py.tools.certificates import Identity
from libmodbus_py.version import how_to_add
from tests.simulation.lan import Lan
from tests.support import certificates
from tests.support.attacks import PATIENCE
from tests.support.certificates import Pki
from tests.support.events import Events, certificate_fields, identity_fields
from tests.support.tls import ONE, VERSION, VERSIONS, TlsClient, context, serving, talking


@pytest.fixture
def roles() -> list[str | None]:
    """The roles of clients that wrote."""
    return []


@pytest.fixture
def noting(roles: list[str | None]) -> Device:
    """A device that records the roles of clients that read and write."""

    def note(access: Access) -> None:
        roles.append(access.role)

    return Device(Mapping(10, 10, 1000, 1000), before_write=note, before_read=note)


@pytest.fixture
def served(lan: Lan, pki: Pki, noting: Device, events: Events) -> Iterator[tuple[Server, int]]:
    with serving(pki, noting, audit=events.append) as served:
        yield served


def test_an_intermediate_authority_in_the_chain_is_accepted(
    lan: Lan, served: tuple[Server, int], pki: Pki, roles: list[str | None]
) -> None:
    identity = certificates.client("Chief", issuer=certificates.intermediate())
    with TlsClient(served[1], context(pki, identity), lan=lan).handshake() as client:
        assert client.is_answered()
    assert roles == ["Chief"]


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
def test_the_required_suites_are_accepted(
    lan: Lan, pki: Pki, key: str, version: str, ciphers: str | None, negotiated: str
) -> None:
    keys = {"key": certificates.rsa_key()} if key == "rsa" else {}
    security = pki.security(certificates.server(**keys))
    context_ = context(pki, certificates.client(**keys), VERSIONS[version], ciphers)
    with (
        serving(pki, security=security) as (server, port),
        TlsClient(port, context_, lan=lan).handshake() as client,
    ):
        assert client.is_answered()
        assert client.tls.version() == f"TLSv{version}"
        cipher = client.tls.cipher()
        assert cipher is not None
        assert cipher[0] == negotiated
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
def test_weak_suites_are_refused(lan: Lan, pki: Pki, key: str, ciphers: str) -> None:
    keys = {"key": certificates.rsa_key()} if key == "rsa" else {}
    security = pki.security(certificates.server(**keys))
    context_ = context(pki, certificates.client(**keys), VERSIONS["1.2"], f"{ciphers}:@SECLEVEL=0")
    with (
        serving(pki, security=security) as (server, port),
        TlsClient(port, context_, lan=lan) as client,
    ):
        with pytest.raises(ssl.SSLError, match="HANDSHAKE_FAILURE"):
            client.handshake()
        assert lan.until(lambda: server.statistics.connections == 0)
        assert (server.statistics.handshakes, server.statistics.handshakes_refused) == (0, 1)


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1])
def test_older_versions_are_refused(lan: Lan, pki: Pki, served: tuple[Server, int], version):
    context_ = context(pki, certificates.client(), version, "ALL:@SECLEVEL=0")
    with (
        TlsClient(served[1], context_, lan=lan) as client,
        pytest.raises(ssl.SSLError, match="PROTOCOL_VERSION"),
    ):
        client.handshake()
    assert lan.until(lambda: served[0].statistics.handshakes_refused == 1)


def tampered() -> Identity:
    """The role of another one under the signature of the authority."""

    class Tampered(Identity):
        @property
        def pem(self) -> bytes:
            der = self.der.replace(encode_role("Operator"), encode_role("Director"))
            assert der != self.der
            return ssl.DER_cert_to_PEM_cert(der).encode()

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
def test_a_bad_certificate_is_refused(
    lan: Lan,
    pki: Pki,
    served: tuple[Server, int],
    roles: list[str | None],
    events: Events,
    caplog: pytest.LogCaptureFixture,
    who: str,
    version: ssl.TLSVersion,
) -> None:
    make_identity, reasons, alert = BAD[who]
    server, port = served
    identity = make_identity()
    context_ = context(pki, identity, version)
    peers = []
    with caplog.at_level(logging.INFO):
        for _ in range(2):  # neither at first, nor with the session of the first time
            with TlsClient(port, context_, session=None, lan=lan) as client:
                peers.append(":".join(map(str, client.socket.getsockname())))
                if alert is None:
                    client.handshake()
                    # The client got the close notify, whatever it sent meanwhile.
                    assert client.ask(ONE, 1) == b""
                else:
                    with pytest.raises(ssl.SSLError, match=alert):
                        client.handshake().ask(ONE, 1)
    statistics = server.statistics
    assert lan.until(lambda: statistics.connections == 0)
    assert (statistics.handshakes, statistics.handshakes_refused) == (0, 2)
    assert statistics.requests == 0
    assert roles == []
    lan.pass_time(61)
    loud = [record for record in caplog.records if record.levelno > logging.INFO]
    assert [record.levelno for record in loud] == [logging.WARNING] * 2
    for peer, record in zip(peers, loud, strict=True):
        assert record.getMessage().startswith(f"{peer}: ")
    message = loud[-1].getMessage()
    assert any(word in message for word in reasons.split("|")), message
    assert [(event.event, identity_fields(event)) for event in events] == [
        ("handshake", certificate_fields(identity))
    ] * 2
    assert any(word in events[-1].result for word in reasons.split("|"))
    if alert is None:  # OpenSSL does not tell whose certificate it refused
        assert message.endswith(f"SHA-256 {digest(identity)}")


@VERSION
def test_a_session_of_a_refused_client_is_refused(
    lan: Lan, pki: Pki, served: tuple[Server, int], version: ssl.TLSVersion
) -> None:
    """The role is read after OpenSSL has sent the ticket."""
    context_ = context(pki, BAD["two roles"][0](), version)
    session = None
    for _ in range(3):
        with TlsClient(served[1], context_, session, lan=lan) as client:
            client.handshake()
            assert client.ask(ONE, 1) == b""
            session = client.tls.session
    statistics = served[0].statistics
    assert lan.until(lambda: statistics.handshakes_refused == 3)
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


def test_without_cryptography_only_roles_are_refused(pki: Pki) -> None:
    files = pki.files(certificates.server())
    command = [sys.executable, "-c", WITHOUT_CRYPTOGRAPHY, files.cert, files.key, pki.ca]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        with TlsClient(port, context(pki, certificates.client(None))).handshake() as client:
            assert client.is_answered()
        with TlsClient(port, context(pki, certificates.client("Chief"))).handshake() as client:
            assert client.ask(ONE, 1) == b""
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert how_to_add("security") in output


@pytest.mark.parametrize("how", ["one", "several", "with a hash"])
def test_only_pinned_certificates_are_accepted(lan: Lan, pki: Pki, how: str) -> None:
    mine = certificates.self_signed(role="Installer")
    files = [pki.files(mine).cert]
    if how != "one":
        files.append(pki.files(certificates.self_signed("another")).cert)
    pin = [*map(str, files), digest(mine)] if how == "with a hash" else files
    security = pki.server(pin=pin if how != "one" else pin[0])
    strangers = [
        certificates.client(),
        certificates.self_signed("a third"),
        certificates.self_signed("Test device", days=2),  # the same name
    ]
    with serving(pki, security=security) as (server, port):
        with TlsClient(port, context(pki, mine), lan=lan).handshake() as client:
            assert client.is_answered()
        for stranger in strangers:
            with (
                TlsClient(port, context(pki, stranger), lan=lan) as client,
                pytest.raises(ssl.SSLError, match=r"UNKNOWN_CA|BAD_CERT|DECRYPT"),
            ):
                client.handshake().ask(ONE, 1)
        assert lan.until(lambda: server.statistics.handshakes_refused == len(strangers))


def digest(identity: Identity | None) -> str:
    assert identity is not None
    return hashlib.sha256(identity.der).hexdigest()


def test_certificates_signed_by_a_pinned_certificate_are_refused(lan: Lan, pki: Pki, caplog):
    """OpenSSL takes it, for the pinned one is what it trusts."""
    security = pki.server(pin=pki.authority(certificates.authority()))
    with caplog.at_level(logging.INFO), talking(lan, pki, security=security) as (server, client):
        assert client.ask(ONE, 1) == b""
        assert (server.statistics.handshakes, server.statistics.handshakes_refused) == (0, 1)
    assert "none of the pins" in caplog.text


def test_a_pinned_certificate_must_be_for_clients(lan: Lan, pki: Pki) -> None:
    """OpenSSL looks at the extended key usage, and cannot be told not to."""
    mine = certificates.server_only()
    security = pki.server(pin=pki.files(mine).cert)
    with serving(pki, security=security) as (_, port):
        context_ = context(pki, mine)
        with (
            TlsClient(port, context_, lan=lan) as client,
            pytest.raises(ssl.SSLError, match="UNSUPPORTED"),
        ):
            client.handshake().ask(ONE, 1)


@VERSION
def test_a_pinned_certificate_may_be_expired(lan: Lan, pki: Pki, version: ssl.TLSVersion) -> None:
    mine = certificates.self_signed(**certificates.expired())
    context_ = context(pki, mine, version)
    security = pki.server(pin=pki.files(mine).cert)
    session = None
    with serving(pki, security=security) as (server, port):
        for _ in range(2):
            with TlsClient(port, context_, session, lan=lan).handshake() as client:
                assert client.is_answered()
                session = client.tls.session
        assert server.statistics.handshakes_resumed == 1


@pytest.mark.parametrize("how", ["1.2", "1.2 without tickets", "1.3"])
def test_a_resumed_session_keeps_its_role(
    lan: Lan, pki: Pki, served: tuple[Server, int], roles: list[str | None], how: str
) -> None:
    server, port = served
    context_ = context(pki, certificates.client("Chief"), VERSIONS[how[:3]])
    if how.endswith("tickets"):
        context_.options |= ssl.OP_NO_TICKET
    session = None
    for turn in range(3):
        with TlsClient(port, context_, session, lan=lan).handshake() as client:
            assert client.is_answered()
            assert client.tls.session_reused == (turn > 0)
            session = client.tls.session
    assert (server.statistics.handshakes, server.statistics.handshakes_resumed) == (3, 2)
    assert roles == ["Chief"] * 3


@VERSION
def test_the_session_of_a_certificate_that_expired_is_not_resumed(
    lan: Lan, pki: Pki, served: tuple[Server, int], caplog, monkeypatch, version: ssl.TLSVersion
) -> None:
    """OpenSSL looks at the dates when a session begins, and not again."""
    server, port = served
    end = datetime.now(UTC) + timedelta(hours=1)
    identity = certificates.client(begin=end - timedelta(hours=2), days=1 / 12)
    context_ = context(pki, identity, version)
    with TlsClient(port, context_, lan=lan).handshake() as client:
        assert client.is_answered()
        session = client.tls.session
    later = SimpleNamespace(time=lambda: end.timestamp() + 1)
    monkeypatch.setattr("libmodbus_py.security.tunnel.time", later)
    with caplog.at_level(logging.INFO), TlsClient(port, context_, session, lan=lan) as client:
        client.handshake()
        assert client.tls.session_reused
        assert client.ask(ONE, 1) == b""
    assert "certificate has expired" in caplog.text
    assert server.statistics.handshakes_refused == 1
