"""
Detects a local echo: a transceiver returns all requests, and these copies are not answers.
"""

from __future__ import annotations

from ..protocol.returned import AwaitedEcho, begins_with_echo
from .statistics import Statistics

__all__ = ["LocalEcho"]

# Functions that read: received bytes that are equal to the request are rarely an answer.
READING = frozenset((1, 2, 3, 4, 7, 11, 12, 17, 20, 23, 24, 43))

# Functions whose answer differs from the request, so that it shows whether an echo came before it.
TELLING = READING | {15, 16}


class LocalEcho:
    """
    Finds out from the answers of a connection whether there is a local echo.

    Args:
        place: the endpoint, for the log.
        statistics: counts the echo.
        is_taken_out: True if the port itself removes the echo from the received bytes.

    Attributes:
        is_there: True or False once it is known whether there is an echo, else None.
    """

    def __init__(self, place: str, statistics: Statistics, is_taken_out: bool) -> None:
        self._place = place
        self._statistics = statistics
        self._is_taken_out = is_taken_out
        self._was_told = False
        self.reset()

    def reset(self) -> None:
        """Forget what was learned, for the next connection."""
        self.is_there: bool | None = False if self._is_taken_out else None
        self._awaited = AwaitedEcho(b"")

    def sent(self, adu: bytes) -> None:
        """Note a request that is sent, if there is an echo."""
        self._awaited = AwaitedEcho(adu)

    @property
    def is_holding(self) -> bool:
        """True while received bytes are held back."""
        return self._awaited.is_holding

    def without(self, data: bytes) -> bytes:
        """Return received bytes without the echo of the request, if there is one."""
        return data if self._awaited.is_over else self._awaited.without(data)

    def release(self) -> bytes:
        """Return the bytes held back, because silence shows that they are not an echo."""
        return self._awaited.release() if self._awaited.is_holding else b""

    def may_be(self, request: bytes) -> bool:
        """Return True if a received PDU equal to the request is probably not its answer."""
        if self.is_there:  # the first copy is an echo, and what follows is an answer
            return not self._awaited.came
        return self.is_there is None and request[0] in READING

    def accepts(self, request: bytes, pdu: bytes) -> bool:
        """Return True if a single received answer cannot be an echo; learn from it."""
        if pdu == request:
            return not self.is_there and not self.may_be(request)
        if request[0] in TELLING:
            self.is_there = False
        return True

    def learn(self, request: bytes, adu: bytes, received: bytearray) -> None:
        """Learn from all bytes received until the answer, or until the end of the wait."""
        if request[0] not in TELLING or not received:
            return
        if not begins_with_echo(received, adu):
            self.is_there = False
            self._awaited = AwaitedEcho(b"")
            return
        if not self._is_taken_out and not self.is_there:
            self.is_there = True
            self._tell()

    def _tell(self) -> None:
        if self._was_told:
            return
        self._was_told = True
        self._statistics.echoes += 1
        from ..protocol.logs import HarmlessLogger

        text = (
            "%s: what is sent comes back (local echo), and is dropped; on serial ports set echo=1"
        )
        HarmlessLogger(__name__).warning(text, self._place)
