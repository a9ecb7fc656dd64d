"""
The package cryptography: an extra, needed because Python's own ssl does not read extensions.

It takes 35 ms to import, so it is imported where it is used.
"""

from __future__ import annotations

__all__ = ["require_cryptography"]


def require_cryptography() -> None:
    """
    Raise an ImportError that names the package to install if cryptography is missing.

    Raises:
        ImportError: it is not installed.
    """
    try:
        import cryptography.x509  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "roles and certificates need the package cryptography: "
            "pip install 'libmodbus-py[security]' (Debian: python3-cryptography)"
        ) from error
