"""
Delivery of faulty answers to one client: each byte at its time.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from ...ports.trace import Trace
from ...protocol.framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer, UdpFramer
from ...server.service import Channel
from .fault import Fault

__all__ = ["Delivery", "Fragment", "fragments"]

# On a connection, fewer bytes wait: the answers to one read. On a serial line this limits the
# answers to a client that does not wait for them.
MAX_WAITING = 1 << 17


Told = tuple[bytes, Frame | None]
"""Bytes that are sent, for a trace, and their frame; None if they are not a frame."""


class Fragment(NamedTuple):
    """
    Bytes to send, and the seconds to wait after the previous fragment.

    Attributes:
        is_last: True if the connection is closed behind them.
        told: the arguments of the trace when they are sent.
    """

    wait: float
    data: bytes
    is_last: bool = False
    told: tuple[Told, ...] = ()


def fragments(fault: Fault | None, answer: Frame, framer: Framer) -> list[Fragment]:
    """Return the fragments sent in place of an answer; for garbage `data` is required."""
    if fault is None:
        data = framer.encode(answer)
        return [Fragment(0, data, told=((data, answer),))]
    frame = _FRAMES.get(fault.kind, _unchanged)(answer)
    adu = framer.encode(frame)
    parts = _PARTS[fault.kind](adu, fault, framer) if fault.kind in _PARTS else (adu,)
    made = _IN_TIME.get(fault.kind, _at_once)(b"".join(parts), fault)
    told = tuple((each, frame if each == adu else None) for each in parts if each)
    return [*made[:-1], *(each._replace(told=told) for each in made[-1:])]


def _unchanged(frame: Frame) -> Frame:
    return frame


# Kind -> the frame that is sent in place of the answer.
_FRAMES: dict[str, Callable[[Frame], Frame]] = {
    # Never that of the next request, because this would then count as its answer.
    "wrong_transaction": lambda frame: frame._replace(transaction=frame.transaction - 1 & 0xFFFF),
    # 1..247, that of a unit which a serial line can have.
    "wrong_unit": lambda frame: frame._replace(unit=frame.unit % 247 + 1),
}


def _spoil_header(adu: bytes) -> bytes:
    return adu[:4] + b"\0\0" + adu[6:]


def _spoil_crc(adu: bytes) -> bytes:
    return adu[:-2] + bytes(byte ^ 0xFF for byte in adu[-2:])


def _spoil_lrc(adu: bytes) -> bytes:
    # The two digits before CR and delimiter.
    return adu[:-4] + b"%02X" % (int(adu[-4:-2], 16) ^ 0xFF) + adu[-2:]


_SPOILS: dict[type, Callable[[bytes], bytes]] = {
    TcpFramer: _spoil_header,
    UdpFramer: _spoil_header,
    RtuFramer: _spoil_crc,
    AsciiFramer: _spoil_lrc,
}


def _with_garbage(adu: bytes, fault: Fault, _: Framer) -> Parts:
    garbage = fault.data or b""
    return {"instead": (garbage,), "behind": (adu, garbage)}.get(fault.place or "", (garbage, adu))


Parts = tuple[bytes, ...]

# Kind -> the bytes sent in place of the answer.
_PARTS: dict[str, Callable[[bytes, Fault, Framer], Parts]] = {
    "wrong_check": lambda adu, fault, framer: (_SPOILS[type(framer)](adu),),
    "truncate": lambda adu, fault, framer: (adu[: min(fault.length or 0, len(adu) - 1)],),
    "disconnect": lambda adu, fault, framer: (adu[: fault.length or 0],),
    "garbage": _with_garbage,
}


def _at_once(data: bytes, fault: Fault) -> list[Fragment]:
    return [Fragment(fault.seconds or 0, data)]


def _byte_by_byte(data: bytes, fault: Fault) -> list[Fragment]:
    wait = fault.seconds or 0
    return [Fragment(wait if at else 0, data[at : at + 1]) for at in range(len(data))]


# Kind -> the fragments in which they are sent.
_IN_TIME: dict[str, Callable[[bytes, Fault], list[Fragment]]] = {
    "no_answer": lambda data, fault: [],
    "trickle": _byte_by_byte,
    "disconnect": lambda data, fault: [Fragment(0, data, True)],
}


class Delivery:
    """
    Sends bytes to one client, in order, each at its time. For one loop only.

    Args:
        channel: channel of the client; `follow` is called whenever `is_waiting` has changed.
        trace: called with all that is sent, or None.
        write: sends bytes; by default the channel's.

    Attributes:
        is_waiting: True while something is to be sent later.
        is_over: True once the connection was closed; nothing more is sent.
    """

    def __init__(
        self,
        channel: Channel,
        trace: Trace | None = None,
        write: Callable[[bytes], None] | None = None,
    ) -> None:
        self.is_waiting: bool = False
        self.is_over: bool = False
        self._channel = channel
        self._trace = trace
        self._write = write or channel.write
        self._loop = asyncio.get_running_loop()
        self._queue: deque[Fragment] = deque()
        self._queued = 0
        self._timer: asyncio.TimerHandle | None = None

    def send(self, answer: list[Fragment]) -> None:
        """Send an answer after the previous ones; it is dropped if too much waits already."""
        if self._queued >= MAX_WAITING or self.is_over:
            return
        self._queue += answer
        self._queued += sum(len(fragment.data) for fragment in answer)
        if self._timer is None:
            self._go_on()

    def close(self) -> None:
        """Drop all fragments that were not sent."""
        self._queue.clear()
        self._queued = 0
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _go_on(self) -> None:
        """Send the fragments that are due, then wait for the next."""
        while self._queue:
            if self._queue[0].wait:
                self._timer = self._loop.call_later(self._queue[0].wait, self._send_next)
                break
            self._send_first()
        if self.is_waiting != bool(self._queue):
            self.is_waiting = not self.is_waiting
            self._channel.follow()

    def _send_next(self) -> None:
        self._timer = None
        self._send_first()
        self._go_on()

    def _send_first(self) -> None:
        fragment = self._queue.popleft()
        self._queued -= len(fragment.data)
        if self._trace is not None:
            _tell(self._trace, fragment.told)
        if fragment.data or not fragment.is_last:
            self._write(fragment.data)
        if fragment.is_last and self._channel.hang_up():
            self.is_over = True
            self.close()


def _tell(trace: Trace, told: tuple[Told, ...]) -> None:
    for adu, frame in told:
        if frame is None:
            trace.tell("sent", adu)
        else:
            trace.tell("sent", adu, frame.unit, frame.pdu[0])
