"""
Certificates for trials, tests and fleets: authorities, servers, clients with roles.

Keys are EC P-256, which every peer must support (MB-TCP-Security-v36, R-61, R-62), unless
others are given. The certificates pass the strict checks of Python 3.13 (RFC 5280).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from errno import EEXIST
from ipaddress import ip_address
from itertools import chain
from pathlib import Path

from ..device.state import replace_file
from ..security.certificates import ROLE_OID, encode_role
from ..version import what_is_missing

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec, rsa
    from cryptography.x509.oid import ExtendedKeyUsageOID
except ImportError as error:
    raise ImportError(what_is_missing("making certificates", "security")) from error

PrivateKey = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey

EARLIER = timedelta(hours=1)
"""Certificates are valid from before they are made, because the clocks of devices are wrong."""

MAX_DAYS = 36_500
"""A century; a longer time is a typing error."""

MAX_NAME_CHARACTERS = 64


@dataclass(frozen=True)
class Identity:
    """
    A certificate with its key.

    `issuers` are the authorities above it, nearest first, without the self-signed root; they are
    sent to the peer, which must know the root (R-46).
    """

    certificate: x509.Certificate
    key: PrivateKey
    issuers: tuple[x509.Certificate, ...] = ()

    @property
    def der(self) -> bytes:
        """The certificate alone."""
        return self.certificate.public_bytes(serialization.Encoding.DER)

    @property
    def pem(self) -> bytes:
        """The certificate and its issuers."""
        chain = (self.certificate, *self.issuers)
        return b"".join(part.public_bytes(serialization.Encoding.PEM) for part in chain)

    def key_pem(self, password: bytes | None = None) -> bytes:
        """Return the private key (PKCS #8), encrypted if a password is given."""
        encryption: serialization.KeySerializationEncryption = serialization.NoEncryption()
        if password is not None:
            encryption = serialization.BestAvailableEncryption(password)
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
    """Make a key and a certificate for it, signed by an issuer or by itself."""
    check_days(days)
    key = key or ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name[:MAX_NAME_CHARACTERS])])
    begin = begin or datetime.now(UTC) - EARLIER
    signer = key if issuer is None else issuer.key
    extensions = [
        (x509.BasicConstraints(ca=is_authority, path_length=None), True),
        (_usage(is_authority=is_authority), True),
        (x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), False),
    ]
    if not is_authority:
        # Devices are servers in the morning and clients in the afternoon.
        purposes = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
        extensions.append((x509.ExtendedKeyUsage(purposes), False))
    if names := [_host_name(host) for host in hosts]:
        extensions.append((x509.SubjectAlternativeName(names), False))
    if role is not None:
        oid = x509.ObjectIdentifier(ROLE_OID)
        extensions.append((x509.UnrecognizedExtension(oid, encode_role(role)), False))
    builder = x509.CertificateBuilder(
        issuer_name=subject if issuer is None else issuer.certificate.subject,
        subject_name=subject,
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
        not_valid_before=begin,
        not_valid_after=begin + timedelta(days=days),
    )
    for extension, is_critical in extensions:
        builder = builder.add_extension(extension, critical=is_critical)
    issuers: tuple[x509.Certificate, ...] = ()
    if issuer is not None and issuer.certificate.issuer != issuer.certificate.subject:
        issuers = (issuer.certificate, *issuer.issuers)
    return Identity(builder.sign(signer, hashes.SHA256()), key, issuers)


def check_days(days: float) -> None:
    """Raise ValueError for a number of days that is too small or too large."""
    if not 0 < days <= MAX_DAYS:
        raise ValueError(f"days must be in 1..{MAX_DAYS}, not {days:g}")


def _usage(*, is_authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not is_authority,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _host_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        if not (host and host.isascii()):
            raise ValueError(f"the host {host!r} is neither an address nor an ASCII name") from None
        return x509.DNSName(host)


def write(
    directory: Path, identities: Mapping[str, Identity], *, replaces: bool = False
) -> dict[str, tuple[Path, Path]]:
    """
    Write all certificates with their issuers and all keys, or none; return the paths of each name.

    The certificate is written after its key, so that an interrupted run leaves none without one.
    """
    directory.mkdir(parents=True, exist_ok=True)
    paths = {
        name: (directory / f"{name}.pem", directory / f"{name}-key.pem") for name in identities
    }
    new = [] if replaces else [*chain(*paths.values())]
    for path in new:
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
        for path in new:
            path.unlink(missing_ok=True)
        raise
    return paths


def load(directory: Path, name: str) -> Identity | None:
    """Load a self-signed identity that `write` has written; None if there is no certificate."""
    certificate, key = directory / f"{name}.pem", directory / f"{name}-key.pem"
    if not certificate.exists():
        return None
    certificates = x509.load_pem_x509_certificate(certificate.read_bytes())
    try:
        private = serialization.load_pem_private_key(key.read_bytes(), None)
    except (FileNotFoundError, TypeError, ValueError):
        private = None
    if not (isinstance(private, PrivateKey) and private.public_key() == certificates.public_key()):
        raise ValueError(f"{key} is not the key of {certificate}")
    return Identity(certificates, private)
