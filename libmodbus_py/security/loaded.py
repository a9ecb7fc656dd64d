"""
OpenSSL's settings made of the files that a `Security` names, and what they accept later on.
"""

from __future__ import annotations

import math
import os
import ssl
import time
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import NamedTuple

from .describing import digest_of, end_of, in_words
from .files import File, PemFile, Revoked, read_pins
from .tunnel import EXPIRED, Tunnel, keep_presented

__all__ = ["Acceptance", "Loaded", "SecurityFiles"]

# TLS 1.2 with the suites that ask for, and without those that
# forbid: Python's own list has SHA-1. What TLS 1.3 has is all good.
CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"

# OpenSSL's X509_V_FLAG_NO_CHECK_TIME, a bit that Python does not name.
NO_CHECK_TIME_FLAG = 0x200000

# OpenSSL's reasons for a key that does not match the certificate; the second: of another kind.
OF_ANOTHER_CERTIFICATE = ("KEY_VALUES_MISMATCH", "NO_CERTIFICATE_ASSIGNED")

# OpenSSL's reasons for a certificate that is too weak for its security level.
TOO_WEAK = ("EE_KEY_TOO_SMALL", "CA_KEY_TOO_SMALL", "CA_MD_TOO_WEAK")


class SecurityFiles(NamedTuple):
    """The files that a `Security` names, and the password of its key."""

    certificate: PemFile
    key: PemFile
    password: str | None
    trust: PemFile | None
    pins: tuple[File, ...]
    crl: PemFile | None


class Loaded:
    """
    The content of the files; errors are those of `Security`.

    Attributes:
        own: the own certificate in DER.
        revoked: the revocation lists, if any.
        client: OpenSSL's settings for the client's end.
    """

    def __init__(self, files: SecurityFiles) -> None:
        self._files = files
        self.own: bytes = files.certificate.certificates()[0]
        if "PRIVATE KEY-----" not in files.key.text():
            raise ValueError(f"{files.key}: no key in PEM format")
        self._pins = {} if files.trust is not None else read_pins(files.pins)
        self._trusted = [] if files.trust is None else files.trust.certificates()
        self._authorities = frozenset(map(digest_of, self._trusted))
        self.revoked: Revoked | None = None if files.crl is None else Revoked(files.crl)
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

    def refusal_of(self, before: Loaded, chain: Iterable[bytes]) -> str | None:
        """
        Return why a connection must end that was accepted with earlier files, or None.

        `chain` is the other side's certificates in DER, its own first.
        """
        own, *issuers = chain
        if self.has_pins:
            return None if self.accepts(own) else "it is none of the pins"
        # Only a new handshake can tell whether an authority that is gone had signed it.
        if before.has_pins or not before._authorities <= self._authorities:
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
        except ssl.SSLError:  # it has more than the lists that were found
            raise ValueError(f"{crl}: cannot be read") from None


class Acceptance:
    """
    The certificate of a connection, which can expire or be revoked; made before the handshake.

    `loaded` returns the current content of the own files; None if they never change.
    """

    __slots__ = ("_before", "_ends", "_loaded", "_tunnel")

    def __init__(self, loaded: Callable[[], Loaded | None]) -> None:
        self._loaded = loaded
        # Files that change during the handshake must be compared with those at its beginning.
        self._before = loaded()
        self._ends = math.inf
        self._tunnel: Tunnel | None = None

    def begin(self, tunnel: Tunnel) -> None:
        """Note that the handshake was accepted."""
        self._tunnel = tunnel
        # A pinned certificate is trusted even if it has expired.
        has_pins = self._before is not None and self._before.has_pins
        if not has_pins and (end := tunnel.expires) is not None:
            self._ends = ssl.cert_time_to_seconds(end)

    def refusal(self) -> str | None:
        """Return why the accepted connection must end, or None."""
        if time.time() > self._ends:
            return EXPIRED
        loaded, before = self._loaded(), self._before
        if loaded is before or loaded is None or before is None or self._tunnel is None:
            return None
        reason = loaded.refusal_of(before, self._tunnel.chain)
        if reason is None:
            self._before = loaded
        return reason
