"""
The certificate of an open connection, which can expire or be revoked.
"""

from __future__ import annotations

import math
import ssl
import time
from collections.abc import Callable

from .loaded import Loaded
from .tunnel import EXPIRED, Tunnel

__all__ = ["Acceptance"]


class Acceptance:
    """
    The certificate of a connection; made before its handshake begins.

    Args:
        loaded: returns the current content of the own files; None if they never change.
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
