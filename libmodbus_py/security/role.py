"""
Roles of the holders of certificates (MB-TCP-Security-v36, R-21, R-22, R-65).

Some peers take other strings, and bytes that are not DER, for roles. Here these are
errors: access rights depend on a role, so that all programs must read the same role.
"""

from __future__ import annotations

from .describing import quoted, require_cryptography

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
    """Return the role in a certificate in DER, None if it has none (R-23), or raise RoleError."""
    require_cryptography()
    from cryptography import x509

    try:
        extensions = x509.load_der_x509_certificate(certificate).extensions
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
    return bytes([UTF8_STRING_TAG, *length]) + text


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
