"""
Units that answer over TCP and on lines, each in its own way: late, twice, damaged, or not at all.

Frames are read and made here from the specification, and not by the package. A unit knows two
functions. A read of five registers (function 3) is answered with the unit, the address and the
time, so that the value itself says whose it is and how old; a write (function 6) is told to the
checker.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from tests.support.driver import rtu

from .events import START, Events
from .lines import Party, SerialLine
from .network import Network
from .sockets import DELAY, MemorySocket

COUNT = 5  # how many registers a read asks for

# Of the time in an answer, in seconds.
RESOLUTION = 1e-6

ILLEGAL_ADDRESS, BUSY = 2, 6


@dataclass(frozen=True)
class Behaviour:
    """What a unit does, each with a probability, once for each request."""

    delay: tuple[float, float] = (0.0005, 0.005)  # seconds, at least and at most
    silent: float = 0.0
    late: float = 0.0  # by `lateness` seconds at most
    lateness: float = 0.0
    refuse: float = 0.0
    twice: float = 0.0  # within `apart` seconds
    apart: float = 0.0
    split: float = 0.0
    flip: float = 0.0
    other_function: float = 0.0  # a good frame of another function comes first
    drop: float = 0.0  # the connection, in place of an answer


ExecutedRequest = Callable[[int, bytes], object]  # told that a unit carries out a request PDU, now


class Unit:
    """One unit."""

    def __init__(
        self, number: int, behaviour: Behaviour, events: Events, executed: ExecutedRequest
    ) -> None:
        self.number: int = number
        self.behaviour: Behaviour = behaviour
        self._events = events
        self._executed = executed

    def behave(self) -> None:
        """Answer everything at once from now on, and well."""
        self.behaviour = replace(Behaviour(), delay=self.behaviour.delay)

    def answer(self, pdu: bytes) -> bytes:
        """Carry out a request; return the response PDU."""
        if self._chance(self.behaviour.refuse):
            return bytes([pdu[0] | 0x80, self._events.random.choice([ILLEGAL_ADDRESS, BUSY])])
        self._executed(self.number, pdu)
        if pdu[0] == 6:
            return pdu
        ticks = round((self._events.now - START) / RESOLUTION)
        (address,) = struct.unpack(">H", pdu[1:3])
        time = ticks.to_bytes(6, "big")
        return struct.pack(">BBHH", 3, 2 * COUNT, self.number, address) + time

    def replies(
        self, pdu: bytes, frame: Callable[[bytes], bytes]
    ) -> list[tuple[float, list[bytes]]]:
        """Return what to send for a request: in how many seconds, and the pieces of each frame."""
        behaviour, random = self.behaviour, self._events.random
        if self._chance(behaviour.silent):
            return []
        after = random.uniform(*behaviour.delay)
        if self._chance(behaviour.late):
            after += random.uniform(0, behaviour.lateness)
        # What it says is what it knows when it was asked, however late it says it.
        adu = frame(self.answer(pdu))
        pairs = [(after, self._pieces(adu))]
        if self._chance(behaviour.other_function):
            other = frame(bytes([4, 2, 0, self.number]))
            pairs.insert(0, (random.uniform(0, after), [other]))
        if self._chance(behaviour.twice):
            pairs.append((after + random.uniform(0, behaviour.apart), [adu]))
        return pairs

    def _pieces(self, adu: bytes) -> list[bytes]:
        random = self._events.random
        if self._chance(self.behaviour.flip):
            at = random.randrange(len(adu))
            adu = adu[:at] + bytes([adu[at] ^ 1 << random.randrange(8)]) + adu[at + 1 :]
        if self._chance(self.behaviour.split):
            at = random.randrange(1, len(adu))
            return [adu[:at], adu[at:]]
        return [adu]

    def _chance(self, probability: float) -> bool:
        return probability > 0 and self._events.random.random() < probability


def time_of(values: list[int]) -> float:
    """Return when the unit read what it answered."""
    return START + int.from_bytes(struct.pack(">3H", *values[2:5]), "big") * RESOLUTION


class Bus(Party):
    """Units on a serial line, in RTU: a request is what silence ends."""

    is_unit: bool = True

    def __init__(
        self, events: Events, line: SerialLine, units: list[Unit], quiet: float = 0.00175
    ) -> None:
        self._events = events
        self._line = line
        self._units = {unit.number: unit for unit in units}
        self._quiet = quiet
        self._buffer = b""
        self._heard_at = 0.0
        line.join(self)

    def hear(self, data: bytes) -> None:
        self._buffer += data
        self._heard_at = self._events.now
        self._events.after(self._quiet, self._end_frame)

    def _end_frame(self) -> None:
        if self._events.now - self._heard_at < self._quiet - 1e-9:
            return
        data, self._buffer = self._buffer, b""
        unit = self._units.get(data[0]) if len(data) == 8 and rtu(data[:-2].hex()) == data else None
        if unit is None:
            return
        for after, pieces in unit.replies(data[1:-2], partial(_rtu, unit.number)):
            self._events.after(after, self._write, pieces)

    def _write(self, pieces: list[bytes]) -> None:
        """Write one after the other, with less silence between them than ends a frame."""
        self._line.write(self, pieces[0])
        if len(pieces) > 1:
            pause = self._line.character * (len(pieces[0]) + self._events.random.uniform(0, 1))
            self._events.after(pause, self._write, pieces[1:])


class Host:
    """Units behind a TCP port, with MBAP headers or with the frames of a line."""

    def __init__(self, network: Network, url: str, units: list[Unit], accepts: float = 1.0) -> None:
        self.accepts: float = accepts
        self.closes: bool = False  # after each answer
        self.has_ids: bool = True  # else those of answers are 0
        self._events = network.events
        self._units = {unit.number: unit for unit in units}
        self._has_header = not url.startswith("rtu")
        self._ends: list[MemorySocket] = []
        self.url: str = network.listen(url, self._accept)

    def drop_all(self) -> None:
        """Reset every connection."""
        for end in self._ends:
            if not end.is_closed:
                end.other.reset()
                end.close()
        self._ends.clear()

    def _accept(self, end: MemorySocket, address: tuple[str, int]) -> None:
        if self._events.random.random() >= self.accepts:
            end.other.reset()
            end.close()
            return
        self._ends.append(end)
        buffer = bytearray()
        end.on_input = partial(self._take, end, buffer)

    def _take(self, end: MemorySocket, buffer: bytearray) -> None:
        while end.is_readable:
            try:
                data = end.recv(4096)
            except OSError:
                data = b""
            if not data:
                end.close()
                self._ends = [end for end in self._ends if not end.is_closed]
                return
            buffer += data
        size = 12 if self._has_header else 8  # of both requests that a unit knows
        while len(buffer) >= size and not end.is_closed:
            request = bytes(buffer[:size])
            del buffer[:size]
            self._answer(end, request)

    def _answer(self, end: MemorySocket, request: bytes) -> None:
        number, pdu = (request[6], request[7:]) if self._has_header else (request[0], request[1:-2])
        unit = self._units.get(number)
        if unit is None:
            return
        if self._events.random.random() < unit.behaviour.drop:
            end.close()
            return
        head = request[:4] if self.has_ids else bytes(4)
        frame = partial(_mbap, head, number) if self._has_header else partial(_rtu, number)
        for after, pieces in unit.replies(pdu, frame):
            self._events.after(after, self._send, end, pieces)

    def _send(self, end: MemorySocket, pieces: list[bytes]) -> None:
        """Send all of a frame at once; its pieces arrive one after the other."""
        if end.is_closed:
            return
        pause = self._events.random.uniform(0, 0.01)
        end.carriage = lambda data: [(DELAY + pause * at, piece) for at, piece in enumerate(pieces)]
        try:
            end.send(b"".join(pieces))
        except OSError:
            end.close()
        if self.closes:
            end.close()


def _rtu(unit: int, pdu: bytes) -> bytes:
    return rtu(f"{unit:02X}" + pdu.hex())


def _mbap(head: bytes, unit: int, pdu: bytes) -> bytes:
    return head + struct.pack(">HB", 1 + len(pdu), unit) + pdu
