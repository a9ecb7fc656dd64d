"""
The maker of certificates: what it makes is what TLS takes, and what its reader is told.
"""

from __future__ import annotations

import contextlib
import ssl
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from libmodbus_py.tools.certificates import Identity, make, write
from tests.support import certificates

# Set by default from Python 3.13 on: RFC 5280 to the letter.
STRICT = ssl.VERIFY_X509_STRICT | ssl.VERIFY_X509_PARTIAL_CHAIN


def context(purpose: int, identity: Identity, trusted: Identity, directory: Path) -> ssl.SSLContext:
    files = certificates.save(directory, identity, f"own{purpose}")
    made = ssl.SSLContext(purpose)
    made.load_cert_chain(files.cert, files.key)
    made.load_verify_locations(cadata=trusted.der)
    made.verify_mode = ssl.CERT_REQUIRED
    made.verify_flags |= STRICT
    return made


def shake(server: Identity, client: Identity, trusted: Identity, directory: Path) -> bytes:
    """Return the certificate that the server saw; raise what the server raised."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    accepting = context(ssl.PROTOCOL_TLS_SERVER, server, trusted, directory)
    connecting = context(ssl.PROTOCOL_TLS_CLIENT, client, trusted, directory)
    there = accepting.wrap_bio(to_server, to_client, server_side=True)
    here = connecting.wrap_bio(to_client, to_server, server_hostname="localhost")
    for end in (here, there) * 3:
        with contextlib.suppress(ssl.SSLWantReadError):
            end.do_handshake()
    return there.getpeercert(True) or b""


def test_tls_takes_what_is_made(tmp_path: Path) -> None:
    client = certificates.client()
    seen = shake(certificates.server(), client, certificates.authority(), tmp_path)
    assert seen == client.der


def test_keys_are_p_256_unless_told_otherwise(tmp_path: Path) -> None:
    made = certificates.server()
    assert isinstance(made.key, ec.EllipticCurvePrivateKey)
    assert made.key.curve.name == "secp256r1"
    key = certificates.rsa_key()
    server, client = certificates.server(key=key), certificates.client(key=key)
    assert shake(server, client, certificates.authority(), tmp_path) == client.der


def test_a_chain_goes_along(tmp_path: Path) -> None:
    client = certificates.client(issuer=certificates.intermediate())
    assert client.pem.count(b"BEGIN CERTIFICATE") == 2
    assert shake(certificates.server(), client, certificates.authority(), tmp_path) == client.der
    assert certificates.client().pem.count(b"BEGIN CERTIFICATE") == 1


def test_a_self_signed_one_is_trusted_by_who_has_it(tmp_path: Path) -> None:
    device = certificates.self_signed(hosts=certificates.HOSTS)
    assert shake(device, device, device, tmp_path) == device.der


def test_hosts_are_names_and_addresses() -> None:
    made = make("server", hosts=["plc.example", "192.0.2.7", "2001:db8::1"]).certificate
    names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["plc.example"]
    addresses = names.get_values_for_type(x509.IPAddress)
    assert [str(each) for each in addresses] == ["192.0.2.7", "2001:db8::1"]


def test_files_are_their_owners_alone_and_never_overwritten(tmp_path: Path) -> None:
    made = {"ca": certificates.authority(), "client": certificates.client()}
    paths = write(tmp_path / "new", made)
    assert [path.name for path in paths["client"]] == ["client.pem", "client-key.pem"]
    assert {path.stat().st_mode & 0o777 for _, path in paths.values()} == {0o600}
    before = paths["client"][1].read_bytes()
    with pytest.raises(FileExistsError, match=r"ca\.pem"):
        write(tmp_path / "new", made)
    assert paths["client"][1].read_bytes() == before


def test_all_files_or_none(tmp_path: Path) -> None:
    (tmp_path / "client-key.pem").write_text("mine")
    with pytest.raises(FileExistsError, match=r"client-key\.pem"):
        write(tmp_path, {"ca": certificates.authority(), "client": certificates.client()})
    assert [path.name for path in tmp_path.iterdir()] == ["client-key.pem"]
    assert (tmp_path / "client-key.pem").read_text() == "mine"
