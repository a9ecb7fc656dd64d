"""
The local echo of a line: a transceiver or converter returns all that is sent.

An echo comes back at once, before anything that the peer sends in response. So received bytes are
compared with those that were sent, in their order, and equal ones are taken out.

Equal bytes alone do not prove an echo: the response to a write is equal to its request, and a
master may send the same write again and again. Unless a user has set whether there is an echo, it
is found out from *telling* frames only. Such a frame can be nothing else when it comes back: the
request of a read at a client (that of a write of several cells differs from its response, too, but
some devices answer with the whole request); a response that is no possible request at a server. If
a telling frame comes back whole, there is an echo; if other bytes come in its place, there is none.
Until then other frames that come back are left in, and decide nothing. An echo that was found out
is disbelieved at the first frame that does not come back. Time is no evidence: converters keep
bytes for longer than some masters wait.

A server on a serial port does not carry out its own response to a write: if the same request
follows where the echo would, it sends only the first byte of the response. If that byte comes
back, there is an echo, for no client goes on before it has the whole response; else there is none.
"""

from __future__ import annotations

from collections import deque

from .scan import MIN_ADU

# Frames that are remembered, more than are ever on their way. Where nothing is received, such as
# after broadcasts, the oldest are forgotten.
MAX_SENT = 64


class Echo:
    """
    Removes the echo of sent bytes from received bytes.

    Args:
        setting: True if all that is sent comes back, False if not, None to find out.

    Attributes:
        is_there: True or False once it is known or set, else None.
        has_returned: False if the last frame sent has not come back, perhaps behind much noise.
    """

    def __init__(self, setting: bool | None) -> None:
        self._setting = setting
        self._held = b""
        self.has_returned: bool = True
        self.reset()

    def reset(self) -> None:
        """Begin again for another connection."""
        self.is_there: bool | None = self._setting
        self.forget()

    def forget(self) -> bytes:
        """Expect no echo of the sent bytes; return the delayed bytes, which are discarded."""
        self._awaited: deque[bytes] = deque(maxlen=MAX_SENT)
        self._undecided: deque[bytes] = deque(maxlen=MAX_SENT)  # sent before a telling frame
        data, self._held = self._held, b""
        return data

    def confirm(self) -> None:
        """Note that there is an echo, and that all sent bytes were returned."""
        self.is_there = self.has_returned = True
        self.forget()

    @property
    def is_holding(self) -> bool:
        """True while received bytes are held back that may be the beginning of an echo."""
        return bool(self._held)

    def sent(self, adu: bytes, *, is_telling: bool) -> None:
        """Expect bytes back that are sent now; `is_telling` if they can be nothing else then."""
        if self.is_there is False or not adu:
            return
        self.has_returned = False
        if self.is_there or is_telling or self._awaited:
            self._awaited.append(adu)
        elif adu not in self._undecided:
            self._undecided.append(adu)

    def without(self, data: bytes) -> bytes:
        """Return received bytes without echoes; hold back a beginning until it is whole or not."""
        if not self._awaited:
            return data
        data, self._held = self._held + data, b""
        rest = b""
        while data and self._awaited:
            adu, start = self._find(data)
            if start is None:
                self._miss()
                break
            end = start + len(adu)
            if len(data) < end:
                self._held = data
                break
            if adu == self._awaited[0]:
                self._awaited.popleft()
                self.is_there = self.has_returned = True
            rest += data[:start] if self.is_there else data[:end]
            data = data[end:]
        return rest if self._held else rest + data

    def release(self) -> bytes:
        """Return the delayed bytes, because silence shows that they are no echo."""
        data = self._held
        if data:
            self._miss()
        return data

    def _find(self, data: bytes) -> tuple[bytes, int | None]:
        for adu in (self._awaited[0], *(self._undecided if self.is_there is None else ())):
            if (start := _start(adu, data)) is not None:
                return adu, start
        return b"", None

    def _miss(self) -> None:
        if self._setting is None:
            self.is_there = False
        self.forget()


def _start(adu: bytes, data: bytes) -> int | None:
    # A transceiver that turns round may add bytes before it: fewer than the shortest frame has.
    return next((at for at in range(MIN_ADU) if adu.startswith(data[at : at + len(adu)])), None)
