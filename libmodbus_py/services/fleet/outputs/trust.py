"""
The certificate authorities that outputs trust.
"""

from __future__ import annotations

import ssl
from pathlib import Path

from ....security.describing import in_words

__all__ = ["trust"]


def trust(ca: str | None) -> ssl.SSLContext:
    """
    Return the context of TLS that trusts the authorities in a file, or those of the system.

    Raises:
        OSError: the file is missing, or holds no certificate; it may be replaced while this runs.
    """
    if ca is not None and not Path(ca).is_file():
        raise OSError(f"ca: there is no file {ca!r}")
    try:
        return ssl.create_default_context(cafile=ca)
    except ssl.SSLError as error:
        raise OSError(f"ca: {ca!r} contains no certificate: {in_words(error)}") from None
