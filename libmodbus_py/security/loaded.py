"""
The content of the files that a `Security` names, and OpenSSL's settings made of it.
"""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from .describing import end_of
from .files import File, certificates_of, digest_of, has_key, pins_of, place_of
from .revoked import Revoked
from .words import in_words

__all__ = ["Loaded", "SecurityFiles"]

# TLS 1.2 with the suites that ask for, and without those that
# forbid: Python's own list has SHA-1. What TLS 1.3 has is all good.
CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"

# OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which Python does not name.
NO_CHECK_TIME = 0x200000

# Errors of OpenSSL for a key that does not match the certificate; the second: of another kind.
OF_ANOTHER_CERTIFICATE = ("KEY_VALUES_MISMATCH", "NO_CERTIFICATE_ASSIGNED")

# Errors of OpenSSL for a certificate that is too weak for its security level.
TOO_WEAK = ("EE_KEY_TOO_SMALL", "CA_KEY_TOO_SMALL", "CA_MD_TOO_WEAK")


@dataclass(frozen=True, repr=False)
class SecurityFiles:
    """The files that a `Security` names, and the password of its key."""

    certificate: File
    key: File | None
    password: str | None
    trust: File | None
    pins: tuple[File, ...] | None
    crl: File | None


class Loaded:
    """
    The content of the files.

    Args:
        for_server: True to make the settings of servers too, which takes certificates for all pins.

    Attributes:
        own: the own certificate in DER.
        authorities: the SHA-256 of each trusted authority.
        revoked: the revocation lists, if any.
        client, server: OpenSSL's settings; `server` is None unless asked for.

    Raises:
        ImportError: cryptography is not installed, and there are revocation lists.
        TypeError, ValueError: a file is wrong, as `Security` describes.
    """

    def __init__(self, files: SecurityFiles, *, for_server: bool) -> None:
        self._files = files
        self.own: bytes = certificates_of("certificate", files.certificate)[0]
        if not has_key("key", files.certificate if files.key is None else files.key):
            raise ValueError(f"{self._key_place()}: no key in PEM format")
        self._pins = None if files.pins is None else pins_of(files.pins)
        trusted = [] if files.trust is None else certificates_of("trust", files.trust)
        self.authorities: frozenset[str] = frozenset(map(digest_of, trusted))
        self.revoked: Revoked | None = None if files.crl is None else Revoked(files.crl)
        self._trusted = trusted
        self.client: ssl.SSLContext = self._make_client()
        self.server: ssl.SSLContext | None = self._make_server() if for_server else None

    @cached_property
    def ends(self) -> float | None:
        """The time at which the own certificate ends, in seconds since 1970, if that is known."""
        return end_of(self.own)

    def accepts(self, certificate: bytes) -> bool:
        """Return True if a certificate is one of the pins, or there are none."""
        return self._pins is None or digest_of(certificate) in self._pins

    @property
    def has_pins(self) -> bool:
        return self._pins is not None

    def refusal_of(self, before: Loaded, chain: Iterable[bytes]) -> str | None:
        """
        Return why a connection must end that was accepted with earlier files, or None.

        Args:
            before: the files when the connection began.
            chain: the other side's certificates in DER, its own first.
        """
        own, *issuers = chain
        if self.has_pins:
            return None if self.accepts(own) else "it is none of the pins"
        # Only a new handshake can tell whether an authority that is gone had signed it.
        if before.has_pins or not before.authorities <= self.authorities:
            return "the trusted authorities are others now"
        if self.revoked is not None and self.revoked.any_of([own, *issuers]):
            return "certificate revoked"
        return None

    # --- OpenSSL's settings -------------------------------------------------------------------

    def _own_context(self, protocol: int) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_ciphers(CIPHERS)
        context.options |= ssl.OP_NO_COMPRESSION | ssl.OP_NO_RENEGOTIATION
        was_asked = False

        def password() -> str:
            # Called only if the key is encrypted; without a password OpenSSL would ask the user.
            nonlocal was_asked
            was_asked = True
            if self._files.password is None:
                raise ValueError(f"{self._key_place()} is encrypted, and needs its password")
            return self._files.password

        try:
            context.load_cert_chain(self._files.certificate, self._files.key, password)
        except ssl.SSLError as error:
            raise ValueError(self._what_is_wrong(error, was_encrypted=was_asked)) from None
        except OSError as error:  # the file was there a moment ago
            raise ValueError(f"{self._key_place()}: {error.strerror}") from None
        return context

    def _what_is_wrong(self, error: ssl.SSLError, *, was_encrypted: bool) -> str:
        reason = in_words(error) if error.reason else "cannot be read"
        if error.reason in TOO_WEAK:
            return f"{place_of('certificate', self._files.certificate)}: {reason}"
        if error.reason in OF_ANOTHER_CERTIFICATE:
            reason = "not the key of the certificate"
        elif was_encrypted:
            reason = "the password is another"
        return f"{self._key_place()}: {reason}"

    def _key_place(self) -> str:
        key = self._files.certificate if self._files.key is None else self._files.key
        return place_of("key", key)

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
        context.num_tickets = 1
        if self._pins is None:
            self._load_trust(context)
            return context
        unknown = [digest for digest, certificate in self._pins.items() if not certificate]
        if unknown:
            raise ValueError(f"pin {unknown[0]}: a server needs the certificate, a PEM file")
        for certificate in self._pins.values():
            context.load_verify_locations(cadata=certificate)
        partial = ssl.VerifyFlags.VERIFY_X509_PARTIAL_CHAIN | NO_CHECK_TIME
        context.verify_flags |= ssl.VerifyFlags(partial)
        return context

    def _load_trust(self, context: ssl.SSLContext) -> None:
        for certificate in self._trusted:
            context.load_verify_locations(cadata=certificate)
        if self._files.crl is None:
            return
        # The whole chain: an authority between may have been revoked.
        context.verify_flags |= ssl.VerifyFlags.VERIFY_CRL_CHECK_CHAIN
        try:
            context.load_verify_locations(cafile=os.fspath(self._files.crl))
        except OSError as error:  # the file was read a moment ago; ssl.SSLError is one, too
            reason = error.strerror or "cannot be read"
            raise ValueError(f"{place_of('crl', self._files.crl)}: {reason}") from None
