"""Own files and those of others: what is wrong with them is said at once, by name."""

import hashlib
import os
import pty
import re
import ssl
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa

from libmodbus_py import Device, Mapping, Security, Server
from libmodbus_py.tools.certificates import make
from tests.support import certificates
from tests.support.cases import each_case
from tests.support.certificates import Files, Pki

DIGEST = "ab" * 32


@pytest.fixture
def files(pki: Pki) -> Files:
    return pki.files(certificates.client())


def exactly(text: str) -> str:
    return f"^{re.escape(text)}$"


def pem(kind: str, body: str = "AAAA") -> bytes:
    return f"-----BEGIN {kind}-----\n{body}\n-----END {kind}-----\n".encode()


NO_CERTIFICATE: list[Callable[[], bytes]] = [
    lambda: b"",
    lambda: certificates.client().der,
    lambda: "Schlüssel".encode() * 100,
    lambda: certificates.client().key_pem(),
    lambda: certificates.client().pem[:300],
    lambda: pem("CERTIFICATE", "!!!!"),
    lambda: pem("CERTIFICATE"),
    lambda: certificates.client().pem + pem("CERTIFICATE"),
]

# The content of a key file, and the text of the error.
NO_KEY: list[tuple[Callable[[], bytes], str]] = [
    (lambda: b"", "no key in PEM format"),
    (lambda: certificates.client().pem, "no key in PEM format"),
    (
        lambda: certificates.client().key.private_bytes(
            serialization.Encoding.DER,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
        "no key in PEM format",
    ),
    (lambda: pem("PRIVATE KEY"), "cannot be read"),
    (lambda: certificates.client(None).key_pem(), "not the key of the certificate"),
    (
        lambda: certificates.client(key=certificates.rsa_key()).key_pem(),
        "not the key of the certificate",
    ),
]


@each_case(
    ("argument", "content", "reason"),
    [
        *(
            (argument, content, "no certificate in PEM format")
            for argument in ("certificate", "trust", "pin")
            for content in NO_CERTIFICATE
        ),
        *(("key", content, reason) for content, reason in NO_KEY),
    ],
)
def test_a_file_without_a_certificate_or_without_a_key_is_named(
    pki: Pki, files: Files, argument: str, content: Callable[[], bytes], reason: str
) -> None:
    file = pki.ca.parent / "file.pem"
    file.write_bytes(content())
    options: dict[str, Any] = {"certificate": files.cert, "key": files.key}
    options |= {argument: file} if argument == "pin" else {"trust": pki.ca, argument: file}
    with pytest.raises(ValueError, match=exactly(f"{argument} {str(file)!r}: {reason}")):
        Security(**options)


@each_case(("wrong", "right"), [("cert", "certificate"), ("ca", "trust")])
def test_the_names_of_urls_are_refused_with_those_of_arguments(wrong: str, right: str) -> None:
    with pytest.raises(TypeError, match=f"'{wrong}' must be one of .*; did you mean {right}"):
        Security("own.pem", **{wrong: "x"})  # type: ignore[arg-type]


def test_a_certificate_is_needed(pki: Pki, files: Files) -> None:
    with pytest.raises(TypeError, match="security needs certificate, a PEM file"):
        Security(key=files.key, trust=pki.ca)


def test_the_key_is_searched_for_in_the_file_of_the_certificate_by_default(
    tmp_path: Path, pki: Pki, files: Files
) -> None:
    with pytest.raises(ValueError, match=r"^key '.*': no key in PEM format; name its file as key$"):
        Security(files.cert, trust=pki.ca)
    both = tmp_path / "both.pem"
    both.write_bytes(files.key.read_bytes() + files.cert.read_bytes())
    assert Security(both, trust=pki.ca).own == certificates.client().der


def test_a_short_key_is_reported_as_a_fault_of_the_certificate(pki: Pki) -> None:
    short = pki.files(make("short", key=rsa.generate_private_key(65537, 1024)))
    with pytest.raises(ValueError, match=r"^certificate '.*': ee key too small$"):
        Security(short.cert, short.key, trust=pki.ca)


@each_case("argument", ["certificate", "key", "trust", "pin"])
def test_a_path_that_is_no_file_is_named(pki: Pki, files: Files, argument: str) -> None:
    good: dict[str, Any] = {"certificate": files.cert, "key": files.key}
    if argument != "pin":
        good["trust"] = pki.ca
    directory = pki.ca.parent
    for wrong, error, reason in (
        (directory, ValueError, f"{argument} {str(directory)!r}: Is a directory"),
        ("a\0b", ValueError, f"{argument} 'a\\x00b': no file can have this name"),
        ("", ValueError, f"{argument} '': No such file or directory"),
        (5, TypeError, f"{argument} must be a file.*, not int"),
        (b"x", TypeError, f"{argument} must be a file.*, not (bytes|int)"),
    ):
        with pytest.raises(error, match=f"^{reason}$".replace("\\x", "\\\\x")):
            Security(**good | {argument: wrong})


READS = """
import os, sys
from libmodbus_py import Security
if os.getuid() == 0:  # who may read all
    os.setuid(65534)
try:
    Security(sys.argv[1], sys.argv[2], trust=sys.argv[3])
except ValueError as error:
    print(error)
"""


def test_a_file_without_read_permission_is_named(pki: Pki) -> None:
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        directory.chmod(0o755)
        identity = certificates.save(directory, certificates.client(), "client")
        identity.key.chmod(0)
        program = [sys.executable, "-c", READS, identity.cert, identity.key, pki.ca]
        process = subprocess.run(program, capture_output=True, text=True, timeout=30, check=False)
        assert process.stdout == f"key {str(identity.key)!r}: Permission denied\n", process.stderr


@pytest.mark.parametrize("form", ["PKCS #8", "traditional"])
def test_an_encrypted_key_needs_its_password(tmp_path: Path, pki: Pki, form: str) -> None:
    identity = certificates.client()
    cert = pki.files(identity).cert
    key = tmp_path / "key.pem"
    key.write_bytes(
        identity.key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8
            if form == "PKCS #8"
            else serialization.PrivateFormat.TraditionalOpenSSL,
            serialization.BestAvailableEncryption("Prüfer".encode()),
        )
    )
    Security(cert, key, trust=pki.ca, password="Prüfer")
    for password in ("Pruefer", "", "x" * 1024):
        with pytest.raises(ValueError, match=r"^key '.*key.pem': the password is another$"):
            Security(cert, key, trust=pki.ca, password=password)
    with pytest.raises(ValueError, match=r"^key '.*' is encrypted, and needs its password$"):
        Security(cert, key, trust=pki.ca)
    with pytest.raises(ValueError, match="password cannot be longer than 1024 bytes"):
        Security(cert, key, trust=pki.ca, password="ü" * 513)
    for wrong in (b"secret", 5):
        with pytest.raises(TypeError, match="password must be a string, not "):
            Security(cert, key, trust=pki.ca, password=wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the password is another") as caught:
        Security(cert, key, trust=pki.ca, password="S3cret")
    assert "S3cret" not in str(caught.value)


def test_a_password_is_never_asked_for_at_the_terminal(pki: Pki) -> None:
    """OpenSSL would ask if no password was passed."""
    files = pki.files(certificates.client(), b"secret")
    program = (
        "import os, sys; from libmodbus_py import Security\n"
        "os.open(os.ttyname(0), os.O_RDWR)\n"  # opening makes it the terminal of the session
        "try: Security(sys.argv[1], sys.argv[2], trust=sys.argv[3])\n"
        "except ValueError as error: print(error)"
    )
    command = [sys.executable, "-c", program, str(files.cert), str(files.key), str(pki.ca)]
    screen, terminal = pty.openpty()
    with subprocess.Popen(
        command, stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True
    ):
        os.close(terminal)
        output = b""
        try:
            while piece := os.read(screen, 4096):
                output += piece
        except OSError:  # so a terminal ends
            pass
        finally:
            os.close(screen)
    assert b"is encrypted, and needs its password" in output
    assert b"pass phrase" not in output


def test_trust_and_pin_together_are_refused(pki: Pki, files: Files) -> None:
    for options in ({}, {"trust": pki.ca, "pin": files.cert}):
        with pytest.raises(ValueError, match="either trust, the authorities, or pin"):
            Security(files.cert, files.key, **options)


def test_pins_are_files_or_hashes(pki: Pki, files: Files) -> None:
    own = certificates.client().der
    for pin in (files.cert, str(files.cert), [files.cert], iter([files.cert])):
        security = Security(files.cert, files.key, pin=pin)
        assert security.accepts(own)
        assert not security.accepts(certificates.authority().der)
    colons = ":".join(f"{byte:02X}" for byte in bytes.fromhex(digest(own)))
    for pin in (digest(own), digest(own).upper(), colons, [DIGEST, colons]):
        assert Security(files.cert, files.key, pin=pin).accepts(own)
    bundle = pki.ca.parent / "bundle.pem"
    bundle.write_bytes(files.cert.read_bytes() + pki.ca.read_bytes())
    security = Security(files.cert, files.key, pin=bundle)
    assert security.accepts(own)
    assert not security.accepts(certificates.authority().der)  # this is the chain of the first


def digest(certificate: bytes) -> str:
    return hashlib.sha256(certificate).hexdigest()


@each_case(
    ("pin", "error", "reason"),
    [
        ([], ValueError, "at least one certificate"),
        ((), ValueError, "at least one certificate"),
        (DIGEST[:-1], ValueError, "a SHA-256 has 64 digits, not 63"),
        (DIGEST + "00", ValueError, "a SHA-256 has 64 digits, not 66"),
        ("ab:" * 20, ValueError, "a SHA-256 has 64 digits, not 40"),
        ("g" * 64, ValueError, "No such file"),
        ("ü" * 64, ValueError, "No such file"),
        ([DIGEST, "nowhere.pem"], ValueError, "pin 'nowhere.pem': No such file"),
        ([DIGEST, 5], TypeError, "pin must be a file or a SHA-256, not int"),
        (bytes(32), TypeError, "pin must be a file or a SHA-256, not int"),
    ],
)
def test_an_invalid_pin_is_named(files: Files, pin, error, reason) -> None:
    with pytest.raises(error, match=reason):
        Security(files.cert, files.key, pin=pin)


def test_a_server_needs_the_certificates_that_it_pins(files: Files) -> None:
    security = Security(files.cert, files.key, pin=[files.cert, DIGEST])
    reason = f"pin {DIGEST}: a server needs the certificate"
    server = Server(Device(Mapping(1)), security=security)
    with pytest.raises(ValueError, match=reason), server.background("tls://127.0.0.1:0"):
        pass
    pinned = Security(files.cert, files.key, pin=[digest(certificates.client().der), files.cert])
    with Server(Device(Mapping(1)), security=pinned).background("tls://127.0.0.1:0"):
        pass


def test_server_names_are_checked_before_they_are_used(pki: Pki, files: Files) -> None:
    for name in ("", ".plc", "a" * 300, "a\0b"):
        with pytest.raises(ValueError, match=r"^server_name must be a name or an address, not "):
            Security(files.cert, files.key, trust=pki.ca, server_name=name)
    with pytest.raises(TypeError, match="server_name must be a string, not int"):
        Security(files.cert, files.key, trust=pki.ca, server_name=5)  # type: ignore[arg-type]
    for name in (
        "plc",
        "plc.example",
        "192.0.2.7",
        "2001:db8::7",
        "fe80::7%eth0",
        "müller.example",
    ):
        Security(files.cert, files.key, trust=pki.ca, server_name=name)


def test_each_file_is_read_once(pki: Pki) -> None:
    """Except files of a server, which it reads again when it begins."""
    files = pki.files(certificates.server())
    security = Security(files.cert, files.key, trust=pki.ca)
    security.check_server()
    for file in (files.cert, files.key, pki.ca):
        file.unlink()
    security.check_server()
    for tunnel in (security.to_server("plc"), security.to_client()):
        tunnel.feed(b"x" * 100)
        with pytest.raises(ssl.SSLError):
            tunnel.handshake()


def test_the_repr_contains_no_secret(pki: Pki) -> None:
    files = pki.files(certificates.client(), b"secret")
    text = repr(Security(files.cert, files.key, trust=pki.ca, password="secret"))
    assert text == f"Security({str(files.cert)!r}, trust={str(pki.ca)!r})"
