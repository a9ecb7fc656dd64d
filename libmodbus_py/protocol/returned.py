"""
Takes the echo of sent bytes out of received ones: a transceiver may return all that is sent.
"""

from __future__ import annotations

__all__ = ["MOST_STRAY", "AwaitedEcho", "begins_with_echo"]

# A transceiver that turns round may add so many bytes before an echo. Behind them, this many bytes
# of the echo must come at once: a single one may well belong to something else.
MOST_STRAY, LEAST = 4, 2


class AwaitedEcho:
    """
    Finds the echo of sent bytes at the beginning of received ones.

    Args:
        sent: what was sent.

    Attributes:
        is_over: True once the echo came, or cannot come any more.
        came: True once it came.
    """

    def __init__(self, sent: bytes) -> None:
        self.is_over: bool = not sent
        self.came: bool = False
        self._sent = sent
        self._held = b""
        self._strayed = 0

    def expect(self, sent: bytes) -> None:
        """Expect the echo of more bytes, which were sent behind those whose echo is awaited."""
        self._sent = self._sent + sent if not self.is_over else sent
        self.is_over = self.came = False
        self._strayed = 0

    @property
    def is_holding(self) -> bool:
        """True while bytes are held back that may be the beginning of the echo."""
        return bool(self._held)

    def without(self, data: bytes) -> bytes:
        """Return bytes without the echo; hold them back until they are all of it, or none."""
        if self.is_over:
            return data
        self._held += data
        for start in range(MOST_STRAY - self._strayed + 1):
            window = self._held[start : start + len(self._sent)]
            if window == self._sent:
                self.is_over = self.came = True
                rest, self._held = self._held[start + len(window) :], b""
                return rest
            if len(window) >= (LEAST if start else 1) and self._sent.startswith(window):
                return b""
        self._strayed += len(self._held)
        if self._strayed > MOST_STRAY:
            return self.release()
        strayed, self._held = self._held, b""
        return strayed

    def release(self) -> bytes:
        """Return what is held back, which is not an echo: silence followed, or other bytes."""
        self.is_over = True
        held, self._held = self._held, b""
        return held


def begins_with_echo(received: bytes | bytearray, sent: bytes) -> bool:
    """Return True if received bytes begin with the sent ones, perhaps behind stray bytes."""
    return received.find(sent, 0, MOST_STRAY + len(sent)) >= 0
