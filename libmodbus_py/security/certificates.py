"""
What certificates contain, and errors of OpenSSL as text; the roles of the holders of certificates
(MB-TCP-Security-v36, R-21, R-22, R-65).

Certificates come from peers that are not trusted yet: texts are cut, and characters that could harm
a terminal or log are escaped. Python's ssl does not read what is in a certificate; the package
cryptography does. It takes 35 ms to import, so it is imported where it is used.

Some peers take other strings, and bytes that are not DER, for roles. Here these are errors: access
rights depend on a role, so that all programs must read the same role.
"""

from __future__ import annotations

import reprlib
import ssl
from typing import TYPE_CHECKING, Any, NamedTuple

from ..version import how_to_add, what_is_missing

if TYPE_CHECKING:
    from datetime import datetime

    from cryptography import x509

MEANINGS = {
    "WRONG_VERSION_NUMBER": "what answers there is no TLS; is it tcp://?",
    "UNSUPPORTED_PROTOCOL": "it speaks no TLS 1.2 or newer",
    "TLSV1_ALERT_PROTOCOL_VERSION": "it speaks no TLS 1.2 or newer",
    "SSLV3_ALERT_HANDSHAKE_FAILURE": "handshake failure: no cipher in common?",
}
"""Reason -> the probable cause at the server of a client."""


def in_words(error: ssl.SSLError, *, guess: bool = False) -> str:
    """Return an error of OpenSSL as text; `guess`: the likely cause, for an error of a client."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return str(error.verify_message)
    reason = error.reason or str(error)
    meaning = MEANINGS.get(reason) if guess else None
    return meaning or reason.lower().replace("_", " ")


def quoted(what: object) -> str:
    """Quote text that may come from a peer: on one line, in 100 characters, nothing hidden."""
    short = reprlib.Repr()
    short.maxstring = 100
    return short.repr(str(what))


def digest_of(certificate: bytes) -> str:
    import hashlib  # 2 ms, which programs without TLS need not wait for

    return hashlib.sha256(certificate).hexdigest()


def require_cryptography() -> None:
    """Raise an ImportError that names the package to install if cryptography is missing."""
    try:
        import cryptography.x509  # noqa: F401
    except ImportError as error:
        reason = what_is_missing("reading certificates", "security")
        raise ImportError(reason) from error


def _read(certificate: bytes) -> x509.Certificate:
    require_cryptography()
    from cryptography import x509

    return x509.load_der_x509_certificate(certificate)


def describe(certificate: bytes) -> str:
    """Describe a certificate in DER, whatever the bytes are, in 500 printable characters."""
    fingerprint = f"SHA-256 {digest_of(certificate)}"
    try:
        fields = _read(certificate)
        is_own = fields.subject == fields.issuer
        issuer = "self-signed" if is_own else f"issued by {_name(fields.issuer)}"
        begin, end = time_in(fields, "not_valid_before"), time_in(fields, "not_valid_after")
        valid = f"{begin:%Y-%m-%d %H:%M:%S} to {end:%Y-%m-%d %H:%M:%S} UTC"
        return f"{_name(fields.subject)}, {issuer}, valid {valid}, {fingerprint}"
    except ImportError:
        return f"{fingerprint} (more with: {how_to_add('security')})"
    except Exception:
        return f"{len(certificate)} bytes that are not a certificate, {fingerprint}"


def _name(name: x509.Name) -> str:
    return quoted(name.rfc4514_string()) if name.rdns else "nameless"


class CertificateHolder(NamedTuple):
    """The holder of a certificate; names and number are empty without cryptography."""

    subject: str  # as in RFC 4514; empty for a nameless one
    serial: str  # in hexadecimal digits
    issuer: str
    fingerprint: str  # the SHA-256 in hexadecimal digits


def holder_of(certificate: bytes) -> CertificateHolder:
    """Return the holder of a certificate in DER. Never raises, whatever the bytes are."""
    subject = serial = issuer = ""
    try:
        fields = _read(certificate)
        serial = f"{fields.serial_number:x}"
        subject, issuer = fields.subject.rfc4514_string(), fields.issuer.rfc4514_string()
    except Exception:  # it is no certificate, or cryptography is not installed
        pass
    return CertificateHolder(subject, serial, issuer, digest_of(certificate))


def end_of(certificate: bytes) -> float | None:
    """Return when a certificate in DER ends, in seconds since 1970; None without cryptography."""
    try:
        end = time_in(_read(certificate), "not_valid_after")
    except ImportError:
        return None
    return None if end is None else end.timestamp()


def time_in(fields: Any, name: str) -> datetime | None:
    """Return a time in a certificate or revocation list, in UTC; None if the field is missing."""
    if hasattr(fields, f"{name}_utc"):  # since cryptography 42, where the one without a zone warns
        aware: datetime | None = getattr(fields, f"{name}_utc")
        return aware
    from datetime import UTC

    naive: datetime | None = getattr(fields, name)
    return None if naive is None else naive.replace(tzinfo=UTC)


# --- roles ----------------------------------------------------------------------------------

ROLE_OID = "1.3.6.1.4.1.50316.802.1"
"""The extension that holds the role."""

# The length of a role in UTF-8: the document names no bound, logs and tables need one.
MAX_ROLE_BYTES = 255

# The tag of a UTF8String in DER.
UTF8_STRING = b"\x0c"

# The OID as DER has it; OpenSSL takes no other form.
ENCODED_OID = bytes.fromhex("060b2b06010401 83890c 8622 01")


class RoleError(ValueError):
    """The role in a certificate is invalid: the certificate is refused, not used without a role."""


def mentions_role(certificate: bytes) -> bool:
    """Return True if a certificate may have a role: fast, and without cryptography."""
    return ENCODED_OID in certificate


def role_of(certificate: bytes) -> str | None:
    """Return the role in a certificate in DER, None if it has none (R-23), or raise RoleError."""
    require_cryptography()
    from cryptography import x509

    try:
        extensions = _read(certificate).extensions
        extension = extensions.get_extension_for_oid(x509.ObjectIdentifier(ROLE_OID)).value
    except x509.ExtensionNotFound:
        return None
    except x509.DuplicateExtension as error:
        oid = error.oid.dotted_string
        reason = "two roles" if oid == ROLE_OID else f"the extension {quoted(oid)} twice"
        raise RoleError(f"the certificate has {reason}") from None
    except Exception as error:
        # cryptography documents ValueError, and raises others for malformed certificates, too. The
        # peer has sent the certificate, so that each of them means a refusal.
        raise RoleError(f"the certificate cannot be read: {quoted(error)}") from None
    # cryptography does not know this extension, and returns its bytes.
    return decode_role(
        extension.value if isinstance(extension, x509.UnrecognizedExtension) else b""
    )


def encode_role(role: str) -> bytes:
    """Return the DER of a role, as the extension contains it, or raise RoleError."""
    check_role(role)
    text = role.encode()
    length = [len(text)] if len(text) < 0x80 else [0x81, len(text)]
    return UTF8_STRING + bytes(length) + text


def decode_role(value: bytes) -> str:
    """Return the role of an extension, or raise RoleError: it is exactly one UTF8String in DER."""
    text = value[3:] if value[1:2] == b"\x81" else value[2:]
    try:
        role = text.decode()
    except UnicodeDecodeError:
        role = ""
    if role and encode_role(role) == value:
        return role
    begin = value[:6].hex(" ")
    raise RoleError(f"the role's {len(value)} bytes ({begin} ...) are not one string in DER")


def check_role(role: str) -> None:
    """Raise RoleError: not 1..255 bytes of UTF-8, or control characters among them."""
    try:
        size = len(role.encode())
    except UnicodeEncodeError:
        raise RoleError(f"the role {quoted(role)} is not all Unicode") from None
    if not 1 <= size <= MAX_ROLE_BYTES:
        raise RoleError(f"the role must have 1..{MAX_ROLE_BYTES} bytes of UTF-8, not {size}")
    if any(character < " " or "\x7f" <= character <= "\x9f" for character in role):
        raise RoleError(f"the role {quoted(role)} has control characters")
