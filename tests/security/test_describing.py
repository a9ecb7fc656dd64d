"""Certificates: how they are made, and how they are described."""

import hashlib
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py.security.certificates import describe
from libmodbus_py.tools.certificates import make, write
from libmodbus_py.version import how_to_add
from tests.support import certificates
from tests.support.cases import each_case

BEGIN = datetime(2024, 2, 29, 12, 30, 1, tzinfo=UTC)


def test_a_certificate_is_shown_with_its_names_and_dates() -> None:
    certificate = make("plc 7", certificates.authority(), begin=BEGIN, days=366)
    assert describe(certificate.der) == (
        "'CN=plc 7', issued by 'CN=Test authority', "
        "valid 2024-02-29 12:30:01 to 2025-03-01 12:30:01 UTC, "
        f"SHA-256 {hashlib.sha256(certificate.der).hexdigest()}"
    )


def test_a_self_signed_certificate_is_named() -> None:
    assert "'CN=Test device', self-signed, valid " in describe(certificates.self_signed().der)


@pytest.mark.slow
def test_the_fingerprint_is_that_of_openssl(tmp_path: Path) -> None:
    files = certificates.save(tmp_path, certificates.client(), "client")
    command = ["openssl", "x509", "-in", files.cert, "-noout", "-fingerprint", "-sha256"]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    fingerprint = output.strip().rpartition("=")[2].replace(":", "").lower()
    assert describe(certificates.client().der).endswith(f"SHA-256 {fingerprint}")


def named(*values: str) -> bytes:
    """A certificate with these names."""
    identity = certificates.self_signed()
    name = x509.Name([x509.NameAttribute(NameOID.ORGANIZATION_NAME, value) for value in values])
    builder = x509.CertificateBuilder(
        name, name, identity.key.public_key(), 1, datetime(2024, 1, 1), datetime(2025, 1, 1)
    )
    signed = builder.sign(identity.key, hashes.SHA256())
    return certificates.Identity(signed, identity.key).der


@each_case(
    "values",
    [
        ("\x1b]0;owned\x07",),
        ("a\r\nERROR all is well",),
        ("\u202egnp.exe",),
        ("\0",),
        ("'quoted'\"", "\\"),
        tuple("x" * 64 for _ in range(200)),
        (),
    ],
    ids=["terminal", "line", "right to left", "nul", "quotes", "long", "nameless"],
)
def test_names_of_certificates_are_printable_and_short(values: tuple[str, ...]) -> None:
    text = describe(named(*values))
    assert text.isprintable()
    assert len(text) <= 500
    assert "2024-01-01 00:00:00" in text


@settings(max_examples=200)
@given(st.binary(max_size=200), st.integers(0, 400), st.integers(0, 5))
def test_any_bytes_are_described_in_printable_text(noise: bytes, at: int, cut: int) -> None:
    good = certificates.client().der
    for data in (
        noise,
        good[:at] + noise + good[at + cut :],
        good[:at] + noise[:2] + good[at + 2 :],
    ):
        text = describe(data)
        assert text.isprintable()
        assert len(text) <= 500
        assert hashlib.sha256(data).hexdigest() in text


def test_without_cryptography_the_fingerprint_is_shown() -> None:
    program = (
        "import sys; sys.modules['cryptography'] = None\n"
        "from libmodbus_py.security.certificates import describe; print(describe(b'abc'))"
    )
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    digest = hashlib.sha256(b"abc").hexdigest()
    assert process.stdout == f"SHA-256 {digest} (more with: {how_to_add('security')})\n"


def test_keys_are_p_256() -> None:
    key = certificates.server().key
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    assert key.curve.name == "secp256r1"


def test_a_file_contains_the_chain_of_its_certificate() -> None:
    below = certificates.client(issuer=certificates.intermediate())
    assert below.pem.count(b"BEGIN CERTIFICATE") == 2
    assert certificates.client().pem.count(b"BEGIN CERTIFICATE") == 1


def test_files_are_readable_by_the_owner_only_and_never_overwritten(tmp_path: Path) -> None:
    identities = {"ca": certificates.authority(), "client": certificates.client()}
    paths = write(tmp_path / "new", identities)
    assert [path.name for path in paths["client"]] == ["client.pem", "client-key.pem"]
    assert {path.stat().st_mode & 0o777 for _, path in paths.values()} == {0o600}
    before = paths["client"][1].read_bytes()
    with pytest.raises(FileExistsError, match=r"ca\.pem"):
        write(tmp_path / "new", identities)
    assert paths["client"][1].read_bytes() == before


def test_if_one_file_exists_none_is_written(tmp_path: Path) -> None:
    (tmp_path / "client-key.pem").write_text("mine")
    with pytest.raises(FileExistsError, match=r"client-key\.pem"):
        write(tmp_path, {"ca": certificates.authority(), "client": certificates.client()})
    assert [path.name for path in tmp_path.iterdir()] == ["client-key.pem"]
    assert (tmp_path / "client-key.pem").read_text() == "mine"
