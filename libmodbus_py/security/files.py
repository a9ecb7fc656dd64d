"""
The files of Modbus Security in PEM format: certificates, keys, pins and revocation lists; OpenSSL's
settings made of them, and what they accept later on.
"""

from __future__ import annotations

import math
import os
import re
import ssl
import time
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import NamedTuple, TypeAlias

from ..system import open_file
from .certificates import digest_of, end_of, in_words, require_cryptography, time_in
from .tunnel import EXPIRED, Tunnel, keep_presented

File: TypeAlias = str | os.PathLike[str]

# TLS 1.2 with the suites that ask for, and without those that
# forbid: Python's own list has SHA-1. What TLS 1.3 has is all good.
CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"

# OpenSSL's X509_V_FLAG_NO_CHECK_TIME, a bit that Python does not name.
NO_CHECK_TIME_FLAG = 0x200000

# OpenSSL's reasons for a key that does not match the certificate; the second: of another kind.
OF_ANOTHER_CERTIFICATE = ("KEY_VALUES_MISMATCH", "NO_CERTIFICATE_ASSIGNED")

# OpenSSL's reasons for a certificate that is too weak for its security level.
TOO_WEAK = ("EE_KEY_TOO_SMALL", "CA_KEY_TOO_SMALL", "CA_MD_TOO_WEAK")


class PemFile:
    """A file that an argument names; ``str`` returns both, as error messages name it."""

    def __init__(self, argument: str, path: File) -> None:
        if not isinstance(path, str | os.PathLike):
            raise TypeError(f"{argument} must be a file, not {type(path).__name__}")
        self._argument = argument
        self.path: File = path

    def __str__(self) -> str:
        return f"{self._argument} {os.fspath(self.path)!r}"

    def text(self) -> str:
        """Return the content; raise a ValueError if it cannot be read."""
        try:
            with open_file(self.path) as file:
                return file.read().decode("utf-8", "replace")
        except OSError as error:
            raise ValueError(f"{self}: {error.strerror}") from None
        except ValueError:  # a null byte
            raise ValueError(f"{self}: no file can have this name") from None

    def certificates(self) -> list[bytes]:
        """Return the certificates in DER; raise a ValueError if there is none, or a list."""
        text = self.text()
        if "-----BEGIN X509 CRL-----" in text:
            raise ValueError(f"{self} contains a revocation list, which must be given as crl")
        try:
            certificates = [ssl.PEM_cert_to_DER_cert(pem) for pem in _parts(text, "CERTIFICATE")]
            reader = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            for certificate in certificates:
                reader.load_verify_locations(cadata=certificate)
        except (ssl.SSLError, ValueError):
            certificates = []
        if not certificates:
            raise ValueError(f"{self}: no certificate in PEM format")
        return certificates


def _parts(text: str, kind: str) -> list[str]:
    return re.findall(f"-----BEGIN {kind}-----.+?-----END {kind}-----", text, re.DOTALL)


def _read_pins(pins: Iterable[File]) -> dict[str, bytes]:
    """Return SHA-256 -> certificate in DER; empty bytes where only the SHA-256 is given."""
    result: dict[str, bytes] = {}
    for pin in pins:
        if not isinstance(pin, str | os.PathLike):
            raise TypeError(f"pin must be a file or a SHA-256, not {type(pin).__name__}")
        digest = os.fspath(pin).replace(":", "").lower()
        if not re.fullmatch("[0-9a-f]{32,}", digest):  # no file has such a name
            certificate = PemFile("pin", pin).certificates()[0]
            result[digest_of(certificate)] = certificate
        elif len(digest) == 64:
            result.setdefault(digest, b"")
        else:
            digits = len(digest)
            raise ValueError(f"pin {os.fspath(pin)!r}: a SHA-256 has 64 digits, not {digits}")
    if not result:
        raise ValueError("pin must contain at least one certificate")
    return result


class RevocationLists:
    """The revocation lists of a file (RFC 5280, 5), for connections open before it was changed."""

    def __init__(self, file: PemFile) -> None:
        require_cryptography()
        from cryptography import x509

        text = file.text()
        if "-----BEGIN CERTIFICATE-----" in text:
            raise ValueError(f"{file} contains a certificate, which has no effect")
        try:
            self._lists = [x509.load_pem_x509_crl(pem.encode()) for pem in _parts(text, "X509 CRL")]
        except ValueError:
            self._lists = []
        if not self._lists:
            raise ValueError(f"{file}: no revocation list in PEM format")
        ends = [time_in(revocation_list, "next_update") for revocation_list in self._lists]
        self.ends: float | None = min((end.timestamp() for end in ends if end), default=None)

    def any_of(self, certificates: Iterable[bytes]) -> bool:
        from cryptography import x509

        return any(
            revocation_list.issuer == certificate.issuer
            and revocation_list.get_revoked_certificate_by_serial_number(certificate.serial_number)
            is not None
            for certificate in map(x509.load_der_x509_certificate, certificates)
            for revocation_list in self._lists
        )


class SecurityFiles(NamedTuple):
    """The files that a `Security` names, and the password of its key."""

    certificate: PemFile
    key: PemFile
    password: str | None
    trust: PemFile | None
    pins: tuple[File, ...]
    crl: PemFile | None


class LoadedFiles:
    """The content of the files; errors are those of `Security`."""

    def __init__(self, files: SecurityFiles) -> None:
        self._files = files
        self.own: bytes = files.certificate.certificates()[0]
        if "PRIVATE KEY-----" not in files.key.text():
            hint = "; name its file as key" if files.key.path == files.certificate.path else ""
            raise ValueError(f"{files.key}: no key in PEM format{hint}")
        self._pins = {} if files.trust is not None else _read_pins(files.pins)
        self._trusted = [] if files.trust is None else files.trust.certificates()
        self._authorities = frozenset(map(digest_of, self._trusted))
        self.revoked: RevocationLists | None = (
            None if files.crl is None else RevocationLists(files.crl)
        )
        self.client: ssl.SSLContext = self._make_client()
        self._server = self._make_server()

    @property
    def has_pins(self) -> bool:
        return bool(self._pins)

    @property
    def server(self) -> ssl.SSLContext:
        """OpenSSL's settings for the server's end; a ValueError without a pinned certificate."""
        for digest, certificate in self._pins.items():
            if not certificate:
                raise ValueError(f"pin {digest}: a server needs the certificate, a PEM file")
        return self._server

    @cached_property
    def ends(self) -> float | None:
        """The time at which the own certificate ends, in seconds since 1970, if that is known."""
        return end_of(self.own)

    def accepts(self, certificate: bytes) -> bool:
        """Return True if a certificate is one of the pins, or there are none."""
        return not self._pins or digest_of(certificate) in self._pins

    def refusal_of(self, before: LoadedFiles, chain: Iterable[bytes]) -> str | None:
        """Return why a connection must end that earlier files accepted; its own is first."""
        own, *issuers = chain
        if self.has_pins:
            return None if self.accepts(own) else "it is none of the pins"
        # Only a new handshake can tell whether an authority that is gone had signed it.
        if before.has_pins or not before._authorities <= self._authorities:
            return "the trusted authorities are others now"
        if self.revoked is not None and self.revoked.any_of([own, *issuers]):
            return "certificate revoked"
        return None

    def _own_context(self, protocol: int) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_ciphers(CIPHERS)
        context.options |= ssl.OP_NO_COMPRESSION | ssl.OP_NO_RENEGOTIATION
        files, was_asked = self._files, False

        def password() -> str:
            # Called only if the key is encrypted; without a password OpenSSL would ask the user.
            nonlocal was_asked
            was_asked = True
            if files.password is None:
                raise ValueError(f"{files.key} is encrypted, and needs its password")
            return files.password

        try:
            context.load_cert_chain(files.certificate.path, files.key.path, password)
        except ssl.SSLError as error:
            if error.reason in TOO_WEAK:
                raise ValueError(f"{files.certificate}: {in_words(error)}") from None
            reason = "the password is another" if was_asked else "cannot be read"
            if error.reason in OF_ANOTHER_CERTIFICATE:
                reason = "not the key of the certificate"
            raise ValueError(f"{files.key}: {reason}") from None
        return context

    def _make_client(self) -> ssl.SSLContext:
        context = self._own_context(ssl.PROTOCOL_TLS_CLIENT)
        if self.has_pins:  # checked when the handshake is over
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        else:
            self._load_trust(context)
        return context

    def _make_server(self) -> ssl.SSLContext:
        context = self._own_context(ssl.PROTOCOL_TLS_SERVER)
        context.verify_mode = ssl.CERT_REQUIRED  # R-06..10
        keep_presented(context)
        context.num_tickets = 1
        if not self.has_pins:
            self._load_trust(context)
            return context
        for certificate in filter(None, self._pins.values()):
            context.load_verify_locations(cadata=certificate)
        partial = ssl.VerifyFlags.VERIFY_X509_PARTIAL_CHAIN | NO_CHECK_TIME_FLAG
        context.verify_flags |= ssl.VerifyFlags(partial)
        return context

    def _load_trust(self, context: ssl.SSLContext) -> None:
        for certificate in self._trusted:
            context.load_verify_locations(cadata=certificate)
        if (crl := self._files.crl) is None:
            return
        # The whole chain: an authority between may have been revoked.
        context.verify_flags |= ssl.VerifyFlags.VERIFY_CRL_CHECK_CHAIN
        try:
            context.load_verify_locations(cafile=os.fspath(crl.path))
        except ssl.SSLError:  # the file contains more than the lists found in it
            raise ValueError(f"{crl}: cannot be read") from None


class Acceptance:
    """A connection's certificate, which can expire or be revoked; made before the handshake."""

    __slots__ = ("_before", "_ends", "_loaded", "_tunnel")

    def __init__(self, load: Callable[[], LoadedFiles | None]) -> None:
        self._loaded = load
        # Files that change during the handshake must be compared with those at its beginning.
        self._before = load()
        self._ends = math.inf
        self._tunnel: Tunnel | None = None

    def begin(self, tunnel: Tunnel) -> None:
        self._tunnel = tunnel
        # A pinned certificate is trusted even if it has expired.
        has_pins = self._before is not None and self._before.has_pins
        if not has_pins and (end := tunnel.expires) is not None:
            self._ends = ssl.cert_time_to_seconds(end)

    def refusal(self) -> str | None:
        """Return why the accepted connection must end, or None."""
        if time.time() > self._ends:
            return EXPIRED
        files, before = self._loaded(), self._before
        if files is before or files is None or before is None or self._tunnel is None:
            return None
        reason = files.refusal_of(before, self._tunnel.chain)
        if reason is None:
            self._before = files
        return reason
