"""
Roles: what a certificate says its holder is (MB-TCP-Security-v36, R-21, R-22, R-65).
"""

from __future__ import annotations

from unicodedata import category

__all__ = ["ROLE_OID", "RoleError", "encode_role"]

ROLE_OID = "1.3.6.1.4.1.50316.802.1"
"""The extension that holds the role."""

MAX_ROLE = 255
"""Bytes of UTF-8 that a role may have: the document names no bound, logs and tables need one."""

_UTF8_STRING = 0x0C


class RoleError(ValueError):
    """A certificate whose role nobody can tell: it is refused, rather than taken without one."""


def encode_role(role: str) -> bytes:
    """
    Give the DER of a role, as the extension holds it.

    Args:
        role: 1..255 bytes of UTF-8, without control characters.

    Raises:
        RoleError: it is no such role.
    """
    text = role.encode("utf-8")
    _check(role, len(text))
    length = bytes([len(text)]) if len(text) < 0x80 else bytes([0x81, len(text)])
    return bytes([_UTF8_STRING]) + length + text


def _check(role: str, size: int) -> None:
    if not 1 <= size <= MAX_ROLE:
        raise RoleError(f"the role has {size} bytes, not 1..{MAX_ROLE}")
    if any(category(character) == "Cc" for character in role):
        raise RoleError(f"the role {role!r} has control characters")
