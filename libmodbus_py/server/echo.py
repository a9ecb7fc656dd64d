"""
Local echo at a server: a transceiver that returns all that is sent, which must not be answered.
"""

from __future__ import annotations

from ..protocol.either_way import may_be
from ..protocol.errors import ServerDeviceBusy
from ..protocol.framing import AsciiFramer, Frame, Framing, make_framer, pdu_of
from ..protocol.pauses import ALLOWANCE
from ..protocol.returned import AwaitedEcho

__all__ = ["EchoWatch"]

# So many answers come back one after the other as if each were a request. Then an exception is
# the answer, which is no request, so that it shows whether they are an echo.
MOST_RETURNS = 64


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
        trial: the ADU to send in order to find out; empty for none.
    """

    def __init__(
        self,
        framing: Framing,
        pause: float,
        character: float,
        longest: float = 2 * ALLOWANCE,
    ) -> None:
        self.has_echo: bool | None = None
        self.trial: bytes = b""
        self._framing: Framing = framing
        self._pause = pause
        self._character = character
        self._longest = longest
        self._sent = b""
        self._awaited = AwaitedEcho(b"")
        self._sent_at = 0.0
        self._returns = 0

    def sent(self, adu: bytes, now: float) -> None:
        """Note an answer that leaves."""
        self._sent, self._awaited, self._sent_at = adu, AwaitedEcho(adu), now

    def without_echo(self, data: bytes, now: float) -> bytes:
        """Return received bytes without an echo; hold them back until they are the whole echo."""
        if self.has_echo is not None or self._awaited.is_over:
            return data
        rest, sent = self._awaited.without(data), self._sent
        if not self._awaited.is_over:
            return rest
        if not self._awaited.came:
            self.has_echo = False
        elif self._is_certain(sent, now):
            self.has_echo = True
        elif self._returns > MOST_RETURNS:
            self._returns = 0
            self.trial = self._refusal(sent)
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
        self._returns += 1
        if now > self._sent_at + on_line + self._longest:
            self.has_echo = False
        return False

    def _refusal(self, adu: bytes) -> bytes:
        """Return the exception for the request that an answer may be; no bytes if it is none."""
        framer = make_framer(self._framing, "server")
        try:
            pdu = pdu_of(self._framing, adu)
            if isinstance(framer, AsciiFramer):
                framer.delimiter = adu[-1]
            unit = int(adu[1:3], 16) if self._framing == "ascii" else adu[0]
            return framer.encode(Frame(unit, bytes([pdu[0] | 0x80, ServerDeviceBusy.code])))
        except ValueError:  # a part of a frame
            return b""

    def _may_ask(self, adu: bytes) -> bool:
        try:
            pdu = pdu_of(self._framing, adu)
        except ValueError:  # a part of a frame
            return False
        return bool(pdu) and may_be(pdu)[0]
