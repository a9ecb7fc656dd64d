"""
Local echo at a server: a transceiver that returns all that is sent, which must not be answered.
"""

from __future__ import annotations

from ..protocol.either_way import may_be
from ..protocol.framing import Framing, pdu_of
from ..protocol.pauses import ALLOWANCE
from ..protocol.returned import AwaitedEcho

__all__ = ["EchoWatch"]

# The number of answers in a row that come back as if they were requests, before the next answer is
# tried: its last byte is held back. No client sends part of a request before it has the whole
# answer, so what comes back without that byte is an echo. A trial delays an answer, and so the next
# one follows only after this multiple of that number.
MOST_RETURNS, MORE_RETURNS = 64, 8

# The last byte is held back for this multiple of the longest time that an answer took to come back,
# and this many seconds more.
LONGER, LATER = 1.25, 0.01

# More bytes during a trial are not an echo of answers.
MOST_HEARD = 4096


class EchoWatch:
    """
    Finds out from the first answers of a port whether they come back.

    Args:
        framing: "rtu" or "ascii".
        pause: seconds between two frames on the line.
        character: seconds that a byte takes on the line; 0 if it takes no time.
        longest: seconds after which an answer that comes back is a request, and no echo.

    Attributes:
        has_echo: True or False once it is known, else None.
        is_trying: True while the last byte of an answer is held back, until `end_trial`.
    """

    def __init__(
        self,
        framing: Framing,
        pause: float,
        character: float,
        longest: float = 2 * ALLOWANCE,
    ) -> None:
        self.has_echo: bool | None = None
        self.is_trying: bool = False
        self._framing: Framing = framing
        self._pause = pause
        self._character = character
        self._longest = longest
        self._sent = b""
        self._awaited = AwaitedEcho(b"")
        self._sent_at = 0.0
        self._returned = b""
        self._returns = 0
        self._most_returns = MOST_RETURNS
        self._longest_way = 0.0
        self._heard = b""

    @property
    def gap(self) -> float:
        """For how many seconds the last byte of an answer is held back."""
        return LONGER * self._longest_way + LATER

    def sent(self, adu: bytes, now: float) -> bytes:
        """Note an answer that leaves, and return the bytes of its end to hold back, if any."""
        self._sent, self._awaited, self._sent_at = adu, AwaitedEcho(adu), now
        if self._returns <= self._most_returns or adu != self._returned:
            return b""
        self.is_trying = True
        return adu[-1:]

    def end_trial(self, now: float) -> bytes:
        """
        End a trial: the last byte leaves now.

        Returns:
            What came meanwhile, unless it was an echo: requests of a client that does not wait.
        """
        heard, self._heard = self._heard, b""
        self.is_trying = False
        self._returns = 0
        self._most_returns *= MORE_RETURNS
        if self._sent[:-1] in heard.replace(self._sent, b""):
            self.has_echo = True
            return b""
        self.sent(self._sent, now - (len(self._sent) - 1) * self._character)
        return heard

    def without_echo(self, data: bytes, now: float) -> bytes:
        """Return received bytes without an echo; hold them back until they are the whole echo."""
        if self.is_trying:
            self._heard += data
            return self.end_trial(now) if len(self._heard) > MOST_HEARD else b""
        if self.has_echo is not None or self._awaited.is_over:
            return data
        rest, sent = self._awaited.without(data), self._sent
        if not self._awaited.is_over:
            return rest
        if not self._awaited.came:
            self.has_echo = False
        elif self._is_certain(sent, now):
            self.has_echo = True
        else:
            return sent + rest
        return rest

    def _is_certain(self, adu: bytes, now: float) -> bool:
        """Return True if an answer that came back is an echo, and no request with equal bytes."""
        on_line = len(adu) * self._character
        # A client begins a pause after the answer has left, and what it sends takes as long.
        earliest = self._sent_at + 2 * on_line + (0 if on_line else self._pause)
        if now < earliest or not self._may_ask(adu):
            return True
        way = now - self._sent_at
        if adu != self._returned:
            self._returned, self._returns, self._longest_way = adu, 0, 0.0
        self._returns += 1
        self._longest_way = max(way, self._longest_way)
        if way > on_line + self._longest:
            self.has_echo = False
        return False

    def _may_ask(self, adu: bytes) -> bool:
        try:
            pdu = pdu_of(self._framing, adu)
        except ValueError:  # a part of a frame
            return False
        return bool(pdu) and may_be(pdu)[0]
