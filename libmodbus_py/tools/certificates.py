"""
Certificates for trials, tests and fleets: authorities, servers, clients with roles.

Keys are EC P-256, which every peer must support (MB-TCP-Security-v36, R-61, R-62), unless
others are given. The certificates pass the strict checks of Python 3.13 (RFC 5280).
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from errno import EEXIST
from ipaddress import ip_address
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from ..device.state import replace_file
from ..security.describing import require_cryptography
from ..security.role import ROLE_OID, encode_role

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec, rsa

    PrivateKey = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey

__all__ = ["Identity", "load", "make", "write"]

EARLIER = timedelta(hours=1)
"""Certificates are valid from before they are made, because the clocks of devices are wrong."""

MAX_DAYS = 36_500
"""A century; a longer time is a typing error."""

MAX_NAME_CHARACTERS = 64


@dataclass(frozen=True)
class Identity:
    """
    A certificate with its key.

    Attributes:
        certificate: an object of `cryptography`.
        key: its private key.
        issuers: the authorities above it, nearest first, without the self-signed root. They are
            sent to the peer, which must know the root (R-46).
    """

    certificate: x509.Certificate
    key: PrivateKey
    issuers: tuple[x509.Certificate, ...] = ()

    @property
    def der(self) -> bytes:
        """The certificate alone."""
        from cryptography.hazmat.primitives.serialization import Encoding

        return self.certificate.public_bytes(Encoding.DER)

    @property
    def pem(self) -> bytes:
        """The certificate and its issuers."""
        from cryptography.hazmat.primitives.serialization import Encoding

        chain = (self.certificate, *self.issuers)
        return b"".join(each.public_bytes(Encoding.PEM) for each in chain)

    def key_pem(self, password: bytes | None = None) -> bytes:
        """Return the private key (PKCS #8), encrypted if a password is given."""
        from cryptography.hazmat.primitives import serialization

        encryption: serialization.KeySerializationEncryption = (
            serialization.NoEncryption()
            if password is None
            else serialization.BestAvailableEncryption(password)
        )
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption
        )


def make(
    name: str,
    issuer: Identity | None = None,
    *,
    is_authority: bool = False,
    role: str | None = None,
    hosts: Iterable[str] = (),
    begin: datetime | None = None,
    days: float = 365,
    key: PrivateKey | None = None,
) -> Identity:
    """
    Make a key and a certificate for it.

    Args:
        name: the common name; of a longer one the first 64 characters (RFC 5280, ub-common-name).
        issuer: the identity that signs the certificate; None for a self-signed one.
        is_authority: True if the certificate may sign others.
        role: the role of a client; None for no role.
        hosts: the names and IP addresses of a server.
        begin: the start of its validity, with a time zone; None for an hour ago.
        days: the length of its validity in days, more than 0 and up to 36500.
        key: the private key; None for a new EC P-256 key.

    Raises:
        ImportError: cryptography is not installed.
        ValueError: a name, role, host or time is wrong.
    """
    require_cryptography()
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec

    if not 0 < days <= MAX_DAYS:
        raise ValueError(f"days must be in 1..{MAX_DAYS}, not {days:g}")
    key = key or ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name[:MAX_NAME_CHARACTERS])])
    begin = begin or datetime.now(UTC) - EARLIER
    builder = x509.CertificateBuilder(
        issuer_name=subject if issuer is None else issuer.certificate.subject,
        subject_name=subject,
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
    )
    builder = builder.not_valid_before(begin).not_valid_after(begin + timedelta(days=days))
    signer = key if issuer is None else issuer.key
    for extension, is_critical in (
        *_usage(is_authority=is_authority),
        (x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), False),
        *_names(hosts),
        *_role(role),
    ):
        builder = builder.add_extension(extension, critical=is_critical)
    return Identity(builder.sign(signer, hashes.SHA256()), key, _issuers(issuer))


def _usage(*, is_authority: bool) -> Iterable[tuple[x509.ExtensionType, bool]]:
    from cryptography import x509
    from cryptography.x509.oid import ExtendedKeyUsageOID

    yield x509.BasicConstraints(ca=is_authority, path_length=None), True
    yield (
        x509.KeyUsage(
            digital_signature=not is_authority,
            key_cert_sign=is_authority,
            crl_sign=is_authority,
            content_commitment=False,
            key_encipherment=False,
            data_encipherment=False,
            key_agreement=False,
            encipher_only=False,
            decipher_only=False,
        ),
        True,
    )
    if not is_authority:
        # Devices are servers in the morning and clients in the afternoon.
        purposes = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
        yield x509.ExtendedKeyUsage(purposes), False


def _names(hosts: Iterable[str]) -> Iterable[tuple[x509.ExtensionType, bool]]:
    from cryptography import x509

    names = [_name(host) for host in hosts]
    if names:
        yield x509.SubjectAlternativeName(names), False


def _name(host: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        if not (host and host.isascii()):
            raise ValueError(f"the host {host!r} is neither an address nor an ASCII name") from None
        return x509.DNSName(host)


def _role(role: str | None) -> Iterable[tuple[x509.ExtensionType, bool]]:
    from cryptography import x509

    if role is not None:
        oid = x509.ObjectIdentifier(ROLE_OID)
        yield x509.UnrecognizedExtension(oid, encode_role(role)), False


def _issuers(issuer: Identity | None) -> tuple[x509.Certificate, ...]:
    if issuer is None or issuer.certificate.issuer == issuer.certificate.subject:
        return ()
    return (issuer.certificate, *issuer.issuers)


# --- files ---------------------------------------------------------------------------


def write(
    directory: Path, identities: Mapping[str, Identity], *, replaces: bool = False
) -> dict[str, tuple[Path, Path]]:
    """
    Write certificates with their issuers to ``NAME.pem``, and their keys to ``NAME-key.pem``.

    Only the owner can read the keys. Either all files are written or none. Each file is written
    beside its place and then moved there, the certificate last, so that an interrupted run leaves
    no half of a file and no certificate without its key.

    Args:
        directory: the directory, which is made if it does not exist.
        identities: the identities by name.
        replaces: True to replace files that exist.

    Returns:
        The paths of certificate and key, by name.

    Raises:
        FileExistsError: one of the files exists already.
        OSError: a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    paths = {
        name: (directory / f"{name}.pem", directory / f"{name}-key.pem") for name in identities
    }
    for path in chain(*paths.values()) if not replaces else ():
        if os.path.lexists(path):
            raise FileExistsError(EEXIST, os.strerror(EEXIST), str(path))
    try:
        for name, identity in identities.items():
            certificate, key = paths[name]
            with contextlib.suppress(FileNotFoundError):
                key.chmod(0o600)  # a new file keeps the permissions of the one that it replaces
            replace_file(key, identity.key_pem().decode())
            replace_file(certificate, identity.pem.decode())
            certificate.chmod(0o644)
    except BaseException:
        for path in chain(*paths.values()) if not replaces else ():
            with contextlib.suppress(OSError):
                path.unlink()
        raise
    return paths


def load(directory: Path, name: str) -> Identity | None:
    """
    Load a self-signed identity that `write` has written; None if there is no certificate.

    Raises:
        ImportError: cryptography is not installed.
        OSError: a file cannot be read.
        ValueError: the certificate is none, or its key is missing, is none or of another one.
    """
    require_cryptography()
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    certificate, key = directory / f"{name}.pem", directory / f"{name}-key.pem"
    if not certificate.exists():
        return None
    found = x509.load_pem_x509_certificate(certificate.read_bytes())
    try:
        private: PrivateKey = load_pem_private_key(key.read_bytes(), None)  # type: ignore[assignment]
    except (FileNotFoundError, TypeError, ValueError):
        private = None  # type: ignore[assignment]
    if private is None or private.public_key() != found.public_key():
        raise ValueError(f"{key} is not the key of {certificate}")
    return Identity(found, private)
