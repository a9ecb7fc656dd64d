"""
Answers as faults make them, on their way to one client: each byte in its time.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from ...protocol.framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer, UdpFramer
from .fault import Fault

__all__ = ["Delivery", "Piece", "pieces"]

# Answers that wait on a connection are no more than those to one read, which is
# less; on a serial line, those to a client that does not wait for answers.
MAX_WAITING = 1 << 17


class Piece(NamedTuple):
    """
    Bytes to send, and the seconds to wait before, once those before it are gone.

    Attributes:
        is_last: whether the connection is closed behind them.
    """

    wait: float
    data: bytes
    is_last: bool = False


def pieces(fault: Fault | None, answer: Frame, framer: Framer) -> list[Piece]:
    """Say what is sent in place of an answer; of garbage `data` must be given."""
    if fault is None:
        return [Piece(0, framer.encode(answer))]
    change = _FRAMES.get(fault.kind)
    data = framer.encode(change(answer) if change else answer)
    if spoil := _BYTES.get(fault.kind):
        data = spoil(data, fault, framer)
    return _IN_TIME.get(fault.kind, _at_once)(data, fault)


# Kind -> the frame that is sent in place of the answer.
_FRAMES: dict[str, Callable[[Frame], Frame]] = {
    # Never that of the next request, whose answer this one would then be.
    "wrong_transaction": lambda frame: frame._replace(transaction=frame.transaction - 1 & 0xFFFF),
    # 1..247, that of a unit which a serial line can have.
    "wrong_unit": lambda frame: frame._replace(unit=frame.unit % 247 + 1),
}


def _spoil_header(adu: bytes) -> bytes:
    return adu[:4] + b"\0\0" + adu[6:]


def _spoil_crc(adu: bytes) -> bytes:
    return adu[:-2] + bytes(byte ^ 0xFF for byte in adu[-2:])


def _spoil_lrc(adu: bytes) -> bytes:
    # Before CR and delimiter, two digits.
    return adu[:-4] + b"%02X" % (int(adu[-4:-2], 16) ^ 0xFF) + adu[-2:]


_SPOILS: dict[type, Callable[[bytes], bytes]] = {
    TcpFramer: _spoil_header,
    UdpFramer: _spoil_header,
    RtuFramer: _spoil_crc,
    AsciiFramer: _spoil_lrc,
}


def _with_garbage(adu: bytes, fault: Fault, _: Framer) -> bytes:
    garbage = fault.data or b""
    return {"instead": garbage, "behind": adu + garbage}.get(fault.place or "", garbage + adu)


# Kind -> the bytes that are sent in place of the answer's.
_BYTES: dict[str, Callable[[bytes, Fault, Framer], bytes]] = {
    "wrong_check": lambda adu, fault, framer: _SPOILS[type(framer)](adu),
    "truncate": lambda adu, fault, framer: adu[: min(fault.length or 0, len(adu) - 1)],
    "disconnect": lambda adu, fault, framer: adu[: fault.length or 0],
    "garbage": _with_garbage,
}


def _at_once(data: bytes, fault: Fault) -> list[Piece]:
    return [Piece(fault.seconds or 0, data)]


def _byte_by_byte(data: bytes, fault: Fault) -> list[Piece]:
    wait = fault.seconds or 0
    return [Piece(wait if at else 0, data[at : at + 1]) for at in range(len(data))]


# Kind -> when they are sent.
_IN_TIME: dict[str, Callable[[bytes, Fault], list[Piece]]] = {
    "no_answer": lambda data, fault: [],
    "trickle": _byte_by_byte,
    "disconnect": lambda data, fault: [Piece(0, data, True)],
}


class Delivery:
    """
    Bytes on their way to one client, in order, each in its time. For one loop only.

    Args:
        write: sends bytes now.
        follow: called whenever `is_waiting` has changed.
        hang_up: closes the connection; False if there is none.

    Attributes:
        is_waiting: whether anything is to be sent later.
        is_over: whether the connection was closed, and nothing goes out any more.
    """

    def __init__(
        self,
        write: Callable[[bytes], None],
        follow: Callable[[], None],
        hang_up: Callable[[], bool] = lambda: False,
    ) -> None:
        self.is_waiting: bool = False
        self.is_over: bool = False
        self._write = write
        self._follow = follow
        self._hang_up = hang_up
        self._loop = asyncio.get_running_loop()
        self._queue: deque[Piece] = deque()
        self._queued = 0
        self._timer: asyncio.TimerHandle | None = None

    def send(self, answer: list[Piece]) -> None:
        """Send an answer after those before it; it is lost where too much waits already."""
        if self._queued >= MAX_WAITING or self.is_over:
            return
        self._queue += answer
        self._queued += sum(len(piece.data) for piece in answer)
        if self._timer is None:
            self._go_on()

    def send_bytes(self, data: bytes) -> None:
        """Send what no fault happens to, after what waits."""
        self.send([Piece(0, data)])

    def close(self) -> None:
        """Forget what was not sent."""
        self._queue.clear()
        self._queued = 0
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _go_on(self) -> None:
        """Send what needs no wait, then wait for the next."""
        while self._queue:
            if self._queue[0].wait:
                self._timer = self._loop.call_later(self._queue[0].wait, self._send_next)
                break
            self._send_first()
        if self.is_waiting != bool(self._queue):
            self.is_waiting = not self.is_waiting
            self._follow()

    def _send_next(self) -> None:
        self._timer = None
        self._send_first()
        self._go_on()

    def _send_first(self) -> None:
        piece = self._queue.popleft()
        self._queued -= len(piece.data)
        if piece.data or not piece.is_last:
            self._write(piece.data)
        if piece.is_last and self._hang_up():
            self.is_over = True
            self.close()
