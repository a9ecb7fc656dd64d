"""
Certificates that tests present: good ones and, above all, bad ones.

All that is good comes from `making`; what it refuses to make is put together here. Keys
are made once for a process, for they take longest.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from libmodbus_py import Security, Server
from libmodbus_py.security.certificates import ROLE_OID, encode_role
from libmodbus_py.tools.certificates import Identity, make

HOSTS = ("localhost", "127.0.0.1", "::1")


@cache
def authority() -> Identity:
    """The authority that both sides trust."""
    return make("Test authority", is_authority=True)


@cache
def foreign_authority() -> Identity:
    """Another authority of the same name, because names prove nothing."""
    return make("Test authority", is_authority=True)


@cache
def intermediate() -> Identity:
    """An authority below the one that both sides trust: pass it as issuer."""
    return make("Test intermediate", authority(), is_authority=True)


@cache
def rsa_key() -> rsa.RSAPrivateKey:
    return rsa.generate_private_key(65537, 2048)


@cache
def server(**options: Any) -> Identity:
    """The certificate of the server, for this machine; options as those of `make`."""
    return make("Test server", **{"issuer": authority(), "hosts": HOSTS} | options)


@cache
def client(role: str | None = "Operator", **options: Any) -> Identity:
    return make("Test client", **{"issuer": authority(), "role": role} | options)


def expired(**options: Any) -> dict[str, Any]:
    """Options of a certificate that ended yesterday."""
    return {"begin": datetime.now(UTC) - timedelta(days=31), "days": 30} | options


def not_yet_valid(**options: Any) -> dict[str, Any]:
    """Options of a certificate that begins tomorrow."""
    return {"begin": datetime.now(UTC) + timedelta(days=1)} | options


def end(certificate: x509.Certificate) -> datetime:
    """Return when a certificate expires, also with a cryptography older than 42."""
    if hasattr(certificate, "not_valid_after_utc"):
        return certificate.not_valid_after_utc
    return certificate.not_valid_after.replace(tzinfo=UTC)


def revocation_list(
    *revoked: Identity, issuer: Identity | None = None, days: float = 30.0
) -> bytes:
    """
    Return a revocation list in PEM. `revoked`: whose certificates it has; `issuer`: who signs it;
    the authority if not given; `days`: how long it is valid; negative for one that has ended.
    """
    issuer = issuer or authority()
    begin = datetime.now(UTC) - timedelta(days=400)
    builder = x509.CertificateRevocationListBuilder().issuer_name(issuer.certificate.subject)
    builder = builder.last_update(begin)
    builder = builder.next_update(datetime.now(UTC) + timedelta(days=days))
    for serial in revoked:
        entry = x509.RevokedCertificateBuilder().serial_number(serial.certificate.serial_number)
        builder = builder.add_revoked_certificate(entry.revocation_date(begin).build())
    return builder.sign(issuer.key, hashes.SHA256()).public_bytes(Encoding.PEM)


@cache
def self_signed(name: str = "Test device", **options: Any) -> Identity:
    """As small devices have it: nobody signed it, so it must be pinned."""
    return make(name, **options)


@cache
def server_only() -> Identity:
    """A client's that is good for servers only (extended key usage)."""
    purpose = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
    return _signed_anew(client(), purpose, without=purpose.oid)


def with_roles(
    identity: Identity, *values: bytes | str, issuer: Identity | None = None
) -> Identity:
    """
    The same with these role extensions instead of its own: none, two, or what is not a role.
    `values`: bytes as they are, text as it should be; `issuer`: who signs; the authority if not
    given.
    """
    role = x509.ObjectIdentifier(ROLE_OID)
    roles = [encode_role(value) if isinstance(value, str) else value for value in values]
    added = [x509.UnrecognizedExtension(role, entry) for entry in roles]
    return _signed_anew(identity, *added, without=role, issuer=issuer)


def _signed_anew(
    identity: Identity,
    *added: x509.ExtensionType,
    without: x509.ObjectIdentifier,
    issuer: Identity | None = None,
) -> Identity:
    """Return the same certificate for a day, with other extensions."""
    old = identity.certificate
    extensions = [extension for extension in old.extensions if extension.oid != without]
    builder = x509.CertificateBuilder(
        issuer_name=old.issuer,
        subject_name=old.subject,
        public_key=identity.key.public_key(),
        serial_number=x509.random_serial_number(),
        # add_extension would refuse a second one.
        extensions=[*extensions, *(x509.Extension(entry.oid, False, entry) for entry in added)],
    )
    begin = datetime.now(UTC) - timedelta(hours=1)
    builder = builder.not_valid_before(begin).not_valid_after(begin + timedelta(days=1))
    signed = builder.sign((issuer or authority()).key, hashes.SHA256())
    return replace(identity, certificate=signed)


@dataclass(frozen=True)
class Files:
    """What the options cert, key and ca take."""

    cert: Path
    key: Path


class Pki:
    """
    An authority and the certificates of both sides of a test, in files of one directory. `ca`: the
    authority that both trust.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._count = 0
        self.ca = self.authority(authority())

    def authority(self, identity: Identity) -> Path:
        return self.files(identity).cert

    def files(self, identity: Identity, password: bytes | None = None) -> Files:
        self._count += 1
        return save(self._directory, identity, f"{self._count}", password)

    def security(self, identity: Identity, **options: Any) -> Security:
        """Who has this certificate, and trusts the authority unless told otherwise."""
        files = self.files(identity)
        if not options.keys() & {"trust", "pin"}:
            options["trust"] = self.ca
        return Security(files.cert, files.key, **options)

    def server(self, **options: Any) -> Security:
        return self.security(server(), **options)

    def client(self, role: str | None = "Operator", **options: Any) -> Security:
        return self.security(client(role), **options)

    def url(self, scheme_and_host: str, identity: Identity) -> str:
        """A URL with all that it needs."""
        files = self.files(identity)
        return f"{scheme_and_host}?cert={files.cert}&key={files.key}&ca={self.ca}"


@cache
def _lasting_folder() -> TemporaryDirectory[str]:
    """Return a folder that exists until the process ends."""
    return TemporaryDirectory(prefix="pki")


@cache
def lasting_pki() -> Pki:
    """Return those that all tests of this process may share."""
    return Pki(Path(_lasting_folder().name))


@contextmanager
def secured(serving: Server, pki: Pki) -> Iterator[str]:
    """Run a server on TLS; gives the URL of a client who may talk to it."""
    with serving.background(pki.url("tls://127.0.0.1:0", server())) as running:
        yield pki.url(running.urls[0], client())


def save(directory: Path, identity: Identity, name: str, password: bytes | None = None) -> Files:
    """Write a certificate with its chain, and its key, encrypted if there is a password."""
    directory.mkdir(parents=True, exist_ok=True)
    files = Files(directory / f"{name}.pem", directory / f"{name}-key.pem")
    files.cert.write_bytes(identity.pem)
    files.key.write_bytes(identity.key_pem(password))
    return files
