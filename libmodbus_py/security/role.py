"""
Roles of the holders of certificates (MB-TCP-Security-v36, R-21, R-22, R-65).

Some peers take other strings, and bytes that are not DER, for roles. Here these are
errors: access rights depend on a role, so that all programs must read the same role.
"""

from __future__ import annotations

from .describing import quoted, require_cryptography

# fmt: off
__all__ = [
    "ROLE_OID", "RoleError", "check_role", "decode_role", "encode_role", "mentions_role", "role_of",
]
# fmt: on

ROLE_OID = "1.3.6.1.4.1.50316.802.1"
"""The extension that holds the role."""

# The length of a role in UTF-8: the document names no bound, logs and tables need one.
MAX_ROLE_BYTES = 255

# The tag of a UTF8String in DER.
UTF8_STRING_TAG = 0x0C

# The OID as DER has it; OpenSSL takes no other form.
ENCODED_OID = bytes.fromhex("060b2b06010401 83890c 8622 01")


class RoleError(ValueError):
    """The role in a certificate is invalid: the certificate is refused, not used without a role."""


def mentions_role(certificate: bytes) -> bool:
    """Return True if a certificate may have a role: fast, and without cryptography."""
    return ENCODED_OID in certificate


def role_of(certificate: bytes) -> str | None:
    """
    Return the role in a certificate that was accepted otherwise.

    Args:
        certificate: X.509 in DER, as ``ssl.SSLSocket.getpeercert(True)`` returns it.

    Returns:
        The role; None if there is none, which is a caller without a role (R-23).

    Raises:
        RoleError: bytes that are not a certificate, or none whose extensions can be read; two
            roles; one that is not a UTF8String in DER and nothing else, that is empty, that is
            longer than 255 bytes or has control characters.
        ImportError: cryptography is not installed.
    """
    require_cryptography()
    from cryptography import x509

    try:
        extensions = x509.load_der_x509_certificate(certificate).extensions
        found = extensions.get_extension_for_oid(x509.ObjectIdentifier(ROLE_OID)).value
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
    return decode_role(found.value if isinstance(found, x509.UnrecognizedExtension) else b"")


def encode_role(role: str) -> bytes:
    """
    Return the DER of a role, as the extension contains it.

    Raises:
        RoleError: as for `check_role`.
    """
    check_role(role)
    return _string(role.encode())


def _string(text: bytes) -> bytes:
    """Return a UTF8String of up to 255 bytes in DER, which has one form for each length."""
    size = len(text) & 0xFF
    length = [size] if len(text) < 0x80 else [0x81, size]
    return bytes([UTF8_STRING_TAG, *length]) + text


def decode_role(value: bytes) -> str:
    """
    Return the role that an extension contains.

    Raises:
        RoleError: the extension is not exactly one UTF8String in DER, or contains no role.
    """
    if value[:1] != bytes([UTF8_STRING_TAG]):
        tag = f"tag {value[0]:02X}h" if value else "no tag"
        raise RoleError(f"the role must be a UTF8String (tag 0Ch), not {tag}")
    text = value[3:] if value[1:2] == b"\x81" else value[2:]
    if _string(text) != value:
        begin = value[:6].hex(" ")
        raise RoleError(f"the role's {len(value)} bytes ({begin} ...) are not one string in DER")
    try:
        role = text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise RoleError(f"the role is not UTF-8 from byte {error.start} on") from None
    check_role(role)
    return role


def check_role(role: str) -> None:
    """
    Raises:
        RoleError: not 1..255 bytes of UTF-8, or control characters among them.
    """
    try:
        size = len(role.encode())
    except UnicodeEncodeError:
        raise RoleError(f"the role {quoted(role)} is not all Unicode") from None
    if not 1 <= size <= MAX_ROLE_BYTES:
        raise RoleError(f"the role must have 1..{MAX_ROLE_BYTES} bytes of UTF-8, not {size}")
    if any(character < " " or "\x7f" <= character <= "\x9f" for character in role):
        raise RoleError(f"the role {quoted(role)} has control characters")
