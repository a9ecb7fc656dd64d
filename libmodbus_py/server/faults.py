"""
Faults on demand: a server that answers late, wrong, in pieces or not at all.

`Fault` says what goes wrong and how often; `Faults` counts the requests of one server
and says which is due; `Delivery` brings bytes to one client, each in its time.
"""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ..protocol.checks import integer, seconds
from ..protocol.framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer, UdpFramer

__all__ = ["KINDS", "Delivery", "Fault", "Faults", "Piece"]

KINDS: dict[str, str | None] = {
    "delay": "seconds",
    "no_answer": None,
    "exception": "code",
    "wrong_check": None,
    "wrong_transaction": None,
    "wrong_unit": None,
    "trickle": "seconds",
    "truncate": "length",
}
"""Kind of fault -> the one setting that it needs."""

SETTINGS: dict[str, Callable[[str, object], object]] = {
    "seconds": seconds,
    "code": lambda name, value: integer(name, value, 1, 0xFF),
    "length": lambda name, value: integer(name, value, 1, 512),
}

# Answers that wait on a connection are no more than those to one read, which is
# less; on a serial line, those to a client that does not wait for answers.
MAX_WAITING = 1 << 17


@dataclass(frozen=True)
class Fault:
    """
    What goes wrong with the answers of a unit, and how often.

    A fault counts the requests of its unit and function that are answered, on all
    lines and from all clients together. Where several are due, the unit's own come
    before those of all units, and the first of each before the next. The request is
    executed, whatever becomes of its answer; only "exception" executes nothing.

    Attributes:
        kind: what goes wrong:

            * "delay": the answer, and what follows it on that connection, comes
              `seconds` later;
            * "no_answer": none comes;
            * "exception": the request is refused with the exception `code`;
            * "wrong_check": CRC or LRC is wrong; TCP has none, and there the
              header says that 0 bytes follow;
            * "wrong_transaction": the answer has the transaction of the request
              before; serial lines have none, and there it never happens;
            * "wrong_unit": the answer says that another unit gave it;
            * "trickle": between the bytes of the answer pass `seconds`;
            * "truncate": only the first `length` bytes come, header or first
              character included, and never all of them.

        function: 1..127, the only function that it happens to; None for all.
        every: 1 or more: it happens to every so manieth request; None for 1.
        probability: 0..1, of happening to a request, in place of `every`.
        seed: makes `probability` hit the same requests each time.
        seconds: 0.001..86400.
        code: 1..255.
        length: 1..512 bytes.

    Raises:
        TypeError, ValueError: an attribute that cannot be, or that its kind needs or lacks.
    """

    kind: str
    function: int | None = None
    every: int | None = None
    probability: float | None = None
    seed: int | None = None
    seconds: float | None = None
    code: int | None = None
    length: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in KINDS:
            raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {self.kind!r}")
        for name, check in SETTINGS.items():
            value = getattr(self, name)
            if name == KINDS[self.kind]:
                if value is None:
                    raise ValueError(f"{name} is missing, which {self.kind} needs")
                check(name, value)
            elif value is not None:
                raise ValueError(f"{name} means nothing for {self.kind}")
        if self.function is not None:
            integer("function", self.function, 1, 0x7F)
        self._check_how_often()

    def _check_how_often(self) -> None:
        if self.every is not None:
            integer("every", self.every, 1, 1_000_000_000)
            if self.probability is not None:
                raise ValueError("probability means nothing beside every")
        if self.probability is None:
            if self.seed is not None:
                raise ValueError("seed means nothing without probability")
            return
        if isinstance(self.probability, bool) or not isinstance(self.probability, int | float):
            given = type(self.probability).__name__
            raise TypeError(f"probability must be a number in 0..1, not {given}")
        if not 0 <= self.probability <= 1:
            raise ValueError(f"probability must be in 0..1, not {self.probability:g}")
        if self.seed is not None:
            integer("seed", self.seed, 0, (1 << 64) - 1)


# --- which is due --------------------------------------------------------------------------


class _Counted:
    """A fault, and how far it is."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self._every = fault.every or 1
        self._count = 0
        self._random = random.Random(fault.seed)

    def is_due(self) -> bool:
        if self.fault.probability is not None:
            return self._random.random() < self.fault.probability
        self._count += 1
        return self._count % self._every == 0


class Faults:
    """
    The faults of one server.

    Args:
        faults: ``{unit 0..255: faults}``; None is every unit.

    Raises:
        TypeError, ValueError: `faults` is something else.
    """

    def __init__(self, faults: Mapping[int | None, Iterable[Fault]]) -> None:
        if not isinstance(faults, Mapping):
            given = type(faults).__name__
            raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {given}")
        self._by_unit: dict[int | None, list[_Counted]] = {}
        for unit, given_faults in faults.items():
            key = None if unit is None else integer("faults: unit", unit, 0, 255)
            self._by_unit[key] = [_Counted(_checked(fault)) for fault in given_faults]

    def __bool__(self) -> bool:
        return any(self._by_unit.values())

    def share(self, unit: int, others: Iterable[int]) -> None:
        """Have the faults of a unit happen to these, too, unless they have their own."""
        if unit in self._by_unit:
            for other in others:
                self._by_unit.setdefault(other, self._by_unit[unit])

    def due(self, request: Frame, *, has_transaction: bool) -> Fault | None:
        """
        Count a request that is going to be answered.

        Args:
            request: as it came in.
            has_transaction: whether its line has transactions.

        Returns:
            The fault that happens to it.
        """
        due = [
            each.fault
            for key in (request.unit, None)
            for each in self._by_unit.get(key, ())
            if each.fault.function in (None, request.pdu[0])
            and (has_transaction or each.fault.kind != "wrong_transaction")
            and each.is_due()
        ]
        return due[0] if due else None


def _checked(fault: object) -> Fault:
    if not isinstance(fault, Fault):
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {fault!r}")
    return fault


# --- what happens --------------------------------------------------------------------------


class Piece(NamedTuple):
    """Bytes to send, and the seconds to wait before, once those before it are gone."""

    wait: float
    data: bytes


def pieces(fault: Fault | None, answer: Frame, framer: Framer) -> list[Piece]:
    """Say what is sent in place of an answer."""
    if fault is None:
        return [Piece(0, framer.encode(answer))]
    change = _FRAMES.get(fault.kind)
    data = framer.encode(change(answer) if change else answer)
    wait = fault.seconds or 0
    if fault.kind == "no_answer":
        return []
    if fault.kind == "wrong_check":
        data = _SPOILS[type(framer)](data)
    if fault.kind == "trickle":
        return [Piece(wait if at else 0, data[at : at + 1]) for at in range(len(data))]
    if fault.length is not None:
        data = data[: min(fault.length, len(data) - 1)]
    return [Piece(wait, data)]


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


class Delivery:
    """
    Bytes on their way to one client, in order, each in its time. For one loop only.

    Args:
        write: sends bytes now.
        follow: called whenever `is_waiting` has changed.

    Attributes:
        is_waiting: whether anything is to be sent later.
    """

    def __init__(self, write: Callable[[bytes], None], follow: Callable[[], None]) -> None:
        self.is_waiting: bool = False
        self._write = write
        self._follow = follow
        self._loop = asyncio.get_running_loop()
        self._queue: deque[Piece] = deque()
        self._queued = 0
        self._timer: asyncio.TimerHandle | None = None

    def send(self, answer: list[Piece]) -> None:
        """Send an answer after those before it; it is lost where too much waits already."""
        if self._queued >= MAX_WAITING:
            return
        self._queue += answer
        self._queued += sum(len(piece.data) for piece in answer)
        if self._timer is None:
            self._go_on()

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
        data = self._queue.popleft().data
        self._queued -= len(data)
        self._write(data)
