"""
The folder of an authority, as the command certificates fills it: certificates that are renewed,
listed and revoked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from ..device.state import replace_file
from ..security.certificates import role_of, time_in
from .certificates import EARLIER, Identity, check_days, load

AUTHORITY = "ca"


@dataclass(frozen=True)
class IssuedCertificate:
    """A certificate in a folder; `name` is that of its file, or of the machine that it is for."""

    name: str
    path: Path
    certificate: x509.Certificate
    is_revoked: bool

    @property
    def serial(self) -> str:
        """The serial number in hexadecimal digits, as in the audit trail."""
        return f"{self.certificate.serial_number:x}"

    @property
    def ends(self) -> datetime:
        """The time at which it expires, in UTC."""
        return _end(self.certificate)

    @property
    def purpose(self) -> str:
        """The role, or the names and addresses, or that it is the authority."""
        if self.name == AUTHORITY:
            return "authority"
        if role := role_of(self.certificate.public_bytes(serialization.Encoding.DER)):
            return f"role {role}"
        for extension in self.certificate.extensions:
            if isinstance(extension.value, x509.SubjectAlternativeName):
                return ", ".join(str(name.value) for name in extension.value)
        return "no role"


class Authority:
    """
    An authority with its key, and the certificates beside it.

    Raises:
        FileNotFoundError: there is no authority in the folder.
        ValueError: its key is another one, or its revocation list is not its own.
    """

    def __init__(self, directory: Path) -> None:
        identity = load(directory, AUTHORITY)
        if identity is None:
            raise FileNotFoundError(2, "there is no authority", str(directory / "ca.pem"))
        self.identity: Identity = identity
        public_key = identity.key.public_key()
        self._issuer_key = x509.AuthorityKeyIdentifier.from_issuer_public_key(public_key)
        self.list_path: Path = directory / "crl.pem"
        self._directory = directory
        self._revocations: dict[int, x509.RevokedCertificate] = {}
        self._number = 0
        self.list_ends: datetime | None = None
        if self.list_path.exists():
            self._read_list()

    def _read_list(self) -> None:
        try:
            revocation_list = x509.load_pem_x509_crl(self.list_path.read_bytes())
        except ValueError:
            raise ValueError(f"{self.list_path}: no revocation list in PEM format") from None
        if not revocation_list.is_signature_valid(self.identity.key.public_key()):
            raise ValueError(f"{self.list_path} is not signed by {self._directory / 'ca.pem'}")
        self._revocations = {entry.serial_number: entry for entry in revocation_list}
        self.list_ends = time_in(revocation_list, "next_update")
        for extension in revocation_list.extensions:
            if isinstance(extension.value, x509.CRLNumber):
                self._number = extension.value.crl_number

    def issued(self) -> dict[str, IssuedCertificate]:
        """
        Return the certificates of the authority in its folder by name, its own first.

        Raises:
            ValueError: a file with the ending .pem contains none.
        """
        paths = {AUTHORITY: self._directory / "ca.pem"}
        paths |= {
            path.stem: path
            for path in sorted(self._directory.glob("*.pem"))
            if not path.stem.endswith("-key") and path.stem not in (AUTHORITY, "crl")
        }
        paths |= {path.parent.name: path for path in sorted(self._directory.glob("*/server.pem"))}
        certificates = {}
        for name, path in paths.items():
            try:
                certificate = x509.load_pem_x509_certificate(path.read_bytes())
            except ValueError:
                raise ValueError(f"{path}: no certificate in PEM format") from None
            # Not the issuer, because authorities of one command have one name.
            if self._issuer_key in [extension.value for extension in certificate.extensions]:
                is_revoked = certificate.serial_number in self._revocations
                certificates[name] = IssuedCertificate(name, path, certificate, is_revoked)
        return certificates

    def renew(self, names: Iterable[str] = (), days: float | None = None) -> list[Path]:
        """
        Replace certificates by others of the same key and content, and return their paths.

        Args:
            names: of which ones; none for all but the authority and those that are revoked.
            days: how long they are valid; None for as long as before.

        Raises:
            ValueError: there is no such certificate, or it is revoked, or `days` is not in
                1..36500.
        """
        if days is not None:
            check_days(days)
        rows = self.issued()
        for name in names:
            self._check_name(name, rows)
            if rows[name].is_revoked:  # others may know its key, which would be the same
                raise ValueError(f"{name!r} is revoked, and its key with it: make another one")
        every = [*names] or [
            row.name for row in rows.values() if row.name != AUTHORITY and not row.is_revoked
        ]
        for name in every:
            old = rows[name]
            certificate = self._renewed(old.certificate, days)
            replace_file(old.path, certificate.public_bytes(serialization.Encoding.PEM).decode())
            if name == AUTHORITY:
                self._copy(old.path)
        return [rows[name].path for name in every]

    def _renewed(self, old: x509.Certificate, days: float | None) -> x509.Certificate:
        begin = datetime.now(UTC) - EARLIER
        before = _end(old) - (time_in(old, "not_valid_before") or begin)
        builder = x509.CertificateBuilder(
            issuer_name=old.issuer,
            subject_name=old.subject,
            public_key=old.public_key(),
            serial_number=x509.random_serial_number(),
            not_valid_before=begin,
            not_valid_after=begin + (before if days is None else timedelta(days=days)),
        )
        for extension in old.extensions:
            builder = builder.add_extension(extension.value, extension.critical)
        return builder.sign(self.identity.key, hashes.SHA256())

    def revoke(self, names: Iterable[str]) -> list[str]:
        """
        Add certificates, by name or serial number in hexadecimal digits, to the revocation list;
        return the serial numbers.

        Raises:
            ValueError: there is no such certificate, and it is no serial number.
        """
        certificates = self.issued()
        serials = [self._serial(name, certificates) for name in names]
        now = datetime.now(UTC)
        for serial in serials:
            entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now)
            self._revocations.setdefault(serial, entry.build())
        return [f"{serial:x}" for serial in serials]

    def write_list(self, days: float) -> Path:
        """
        Write the revocation list, valid for some days, and return its path.

        Raises:
            ValueError: `days` is not in 1..36500.
        """
        check_days(days)
        now = datetime.now(UTC)
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self.identity.certificate.subject)
            .last_update(now - EARLIER)
            .next_update(now + timedelta(days=days))
            .add_extension(x509.CRLNumber(self._number + 1), critical=False)
            .add_extension(self._issuer_key, critical=False)
        )
        for entry in self._revocations.values():
            builder = builder.add_revoked_certificate(entry)
        crl = builder.sign(self.identity.key, hashes.SHA256())
        replace_file(self.list_path, crl.public_bytes(serialization.Encoding.PEM).decode())
        self.list_path.chmod(0o644)
        self._copy(self.list_path)
        return self.list_path

    def _copy(self, path: Path) -> None:
        """Write a file of the authority into the folders of its machines, too."""
        for folder in {path.parent for path in self._directory.glob("*/server.pem")}:
            replace_file(folder / path.name, path.read_text())
            (folder / path.name).chmod(0o644)

    def _serial(self, name: str, certificates: dict[str, IssuedCertificate]) -> int:
        if name == AUTHORITY:
            raise ValueError("an authority cannot revoke itself: trust another one instead")
        if name in certificates:
            return certificates[name].certificate.serial_number
        digits = name.replace(":", "")
        if not re.fullmatch("[0-9A-Fa-f]{1,40}", digits) or not int(digits, 16):
            self._check_name(name, certificates)
        return int(digits, 16)

    def _check_name(self, name: str, certificates: dict[str, IssuedCertificate]) -> None:
        if name not in certificates:
            names = ", ".join(certificates)
            raise ValueError(f"{name!r} is no certificate in {self._directory}, which has {names}")


def _end(certificate: x509.Certificate) -> datetime:
    end = time_in(certificate, "not_valid_after")
    assert end is not None
    return end
