"""
The share that a listener names right: python -m fuzz.listening [TRANSACTIONS] [SEED]

A client sends so many requests, 100000 by default, to three units on a line with simulated time.
0, 1 and 5 % of the frames are damaged as `bad_line` does it. A request without a valid response is
repeated up to twice. Bytes come in pieces that are cut anywhere or joined, each with the time at
which an adapter would deliver it. The program prints the shares of transactions and frames that
were named right, and exits with 1 if those of transactions are below 100, 99 and 95 %.
"""

from __future__ import annotations

import random
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from fuzz.bad_line import FAULTS, UNITS, Hurt
from fuzz.command import numbers, progress
from libmodbus_py import Device, Mapping, pdu
from libmodbus_py.protocol.framing import Frame, make_framer
from libmodbus_py.tools.listener.separator import Separator
from libmodbus_py.tools.listener.transaction import TimedFrame, Transaction

__all__ = ["LATENCY", "Framing", "Result", "Told", "heard", "line", "measure"]

Framing = Literal["rtu", "ascii"]

TIMEOUT = 0.3
RETRIES = 2
CHARACTER = 11 / 115200
LATENCY = 0.001  # seconds that an adapter collects bytes
SLOW_LATENCY = 0.016  # seconds that slow adapters do

# Faults that leave the frame complete, with bytes beside the frame or a pause inside.
HARMLESS = ("delay", "merge", "noise")


class Told(NamedTuple):
    """A frame as it was sent, and its time."""

    part: str
    frame: Frame


@dataclass
class Result:
    """The numbers of transactions and frames, of those named right, and examples of the others."""

    transactions: int = 0
    right_transactions: int = 0
    frames: int = 0
    right_frames: int = 0
    faults: int = 0
    examples: list[str] = field(default_factory=list)

    @property
    def share(self) -> float:
        return self.right_transactions / self.transactions


class Sent(NamedTuple):
    at: float
    data: bytes


class Line:
    """
    A client, its units, and the line between them, in simulated time.

    Attributes:
        pieces: bytes with their times.
        told: for each transaction the frames that came whole, and whether any was damaged.
    """

    def __init__(self, framing: Framing, faults: float, seed: int, latency: float) -> None:
        self.pieces: list[Sent] = []
        self.told: list[list[Told]] = []
        self.faults = 0
        self.now = 1000.0
        self._framing = framing
        self._share = faults
        self._latency = latency
        self._random = random.Random(seed)
        self._framer = make_framer(framing, "server")
        mapping = Mapping(2000, 2000, 2000, 2000)
        mapping.holding_registers[:] = [at * 40503 % 65536 for at in range(2000)]
        self._device = Device(mapping, files={4: range(10_000)})
        self._request: pdu.Request[Any] = pdu.ReadCoils(0, 1)

    def transaction(self) -> None:
        """Send a request until it is answered, or `RETRIES` times more."""
        choose = self._random
        if choose.random() > 0.3:  # otherwise a former request is repeated, as polls do
            self._request = choose.choice(REQUESTS)(choose)
        unit = (
            0 if self._request.may_be_broadcast and choose.random() < 0.02 else choose.choice(UNITS)
        )
        for _ in range(1 + RETRIES):
            told: list[Told] = []
            self.told.append(told)
            if self._ask(unit, told):
                break
            self.now += TIMEOUT
        # The client pauses, briefly or for long.
        self.now += max(0.00175, choose.choice([0.0, 0.002, 0.05, choose.expovariate(5)]))

    def _ask(self, unit: int, told: list[Told]) -> bool:
        frame = Frame(unit, self._request.encode())
        if not self._send("request", frame, told):
            return False
        if unit == 0:
            self.now += 0.1  # turnaround
            return True
        answer = self._device.answer(frame.pdu)
        if answer is None or self._random.random() < self._share:
            return False  # lost
        # Each unit takes its time, and sometimes much more.
        slow = 0.06 if self._random.random() < 0.01 else 0.0
        self.now += 0.002 * (1 + UNITS.index(unit)) + self._random.uniform(0, 0.003) + slow
        return self._send("response", Frame(unit, answer), told)

    def _send(self, part: str, frame: Frame, told: list[Told]) -> bool:
        """Put a frame on the line, damaged or not; return True if it arrives whole."""
        data = self._framer.encode(frame)
        if self._random.random() >= self._share:
            told.append(Told(part, frame))
            self._put(data)
            return True
        self.faults += 1
        kind = self._random.choice([*FAULTS])
        for after, piece in FAULTS[kind](Hurt(data, self._framing, self._random)):
            self.now += after * 0.1
            self._put(piece)
        if kind not in HARMLESS:
            return False
        told.append(Told(part, frame))
        return True

    def _put(self, data: bytes) -> None:
        """Deliver bytes as adapters do: cut anywhere, late, and several frames in one piece."""
        while data:
            size = self._random.choice([len(data), len(data), self._random.randint(1, len(data))])
            self.now += size * CHARACTER
            self.pieces.append(Sent(self.now + self._latency, data[:size]))
            data = data[size:]


def _read(name: str, most: int) -> Any:
    def make(choose: random.Random) -> pdu.Request[Any]:
        count = choose.choice([1, 2, choose.randint(1, most), most])
        return getattr(pdu, name)(choose.randrange(2200 - count), count)

    return make


def _words(choose: random.Random) -> list[int]:
    return [choose.randrange(65536) for _ in range(choose.choice([1, 2, choose.randint(1, 120)]))]


REQUESTS = [
    _read("ReadCoils", 1000),
    _read("ReadDiscreteInputs", 1000),
    _read("ReadHoldingRegisters", 125),
    _read("ReadInputRegisters", 125),
    lambda choose: pdu.WriteCoil(choose.randrange(2100), choose.random() < 0.5),
    lambda choose: pdu.WriteRegister(choose.randrange(2100), choose.randrange(65536)),
    lambda choose: pdu.ReadExceptionStatus(),
    lambda choose: pdu.Diagnostics(0, choose.randbytes(2 * choose.randint(1, 5))),
    lambda choose: pdu.ReadCommEventLog(),
    lambda choose: pdu.WriteCoils(choose.randrange(1000), [True] * choose.randint(1, 900)),
    lambda choose: pdu.WriteRegisters(choose.randrange(1000), _words(choose)),
    lambda choose: pdu.ReportServerId(),
    lambda choose: pdu.ReadFileRecords([(4, choose.randrange(100), choose.randint(1, 50))]),
    lambda choose: pdu.WriteFileRecords([(4, choose.randrange(100), _words(choose))]),
    lambda choose: pdu.MaskWriteRegister(choose.randrange(2000), 0xF2, choose.randrange(256)),
    lambda choose: pdu.ReadWriteRegisters(choose.randrange(900), 9, 5, _words(choose)),
    lambda choose: pdu.ReadDeviceIdentification(1, 0),
]


def line(framing: Framing, count: int, faults: float, seed: int, latency: float = LATENCY) -> Line:
    """Let a client send so many requests, including repeats."""
    made = Line(framing, faults, seed, latency)
    while len(made.told) < count:
        made.transaction()
    return made


def _glued(pieces: list[Sent], latency: float) -> list[Sent]:
    """Join what arrived within the latency of the adapter; all of it is as late as the last."""
    glued: list[Sent] = []
    for at, data in pieces:
        if glued and at - glued[-1].at < latency:
            glued[-1] = Sent(glued[-1].at, glued[-1].data + data)
        else:
            glued.append(Sent(at, data))
    return glued


def heard(framing: Framing, pieces: list[Sent]) -> tuple[list[Told], list[Transaction]]:
    """Let a listener separate the pieces."""
    named: list[Told] = []

    def note(each: TimedFrame) -> None:
        if each.frame is not None:
            named.append(Told(each.part, each.frame))

    separator = Separator(framing, note)
    done: list[Transaction] = []
    for at, data in pieces:
        done += separator.feed(data, at)
    return named, done + separator.end()


class Pair(NamedTuple):
    """A request, and whether it was answered."""

    unit: int
    question: bytes
    is_answered: bool


def _pairs(done: list[Transaction]) -> list[Pair]:
    asked = sorted((exchange for exchange in done if exchange.request), key=lambda each: each.time)
    answered = ("answered", "exception")
    return [
        Pair(request.unit or 0, request.request.encode(), request.kind in answered)
        for request in asked
        if request.request and request.kind != "late"
    ]


def _as_pair(frames: list[Told]) -> Pair | None:
    """None for a response whose request did not come whole."""
    asked = frames[0].frame
    return Pair(asked.unit, asked.pdu, len(frames) > 1) if frames[0].part == "request" else None


def compared(told: list[list[Told]], named: list[Told], pairs: list[Pair]) -> Result:
    """
    Find what was sent in what was named, in its order.

    A frame is right that is named as what it was; a transaction, if all its frames that came
    whole are, and it is given as answered if its answer came whole, and else as unanswered. What
    was named and never sent (glued frames of others) is passed over, and so are transactions of
    which nothing came whole.
    """
    result = Result()
    at = paired_at = 0
    for frames in filter(None, told):
        result.transactions += 1
        right = 0
        for frame in frames:
            window = named[at : at + 12]
            if frame in window:
                at += window.index(frame) + 1
                right += 1
        result.frames += len(frames)
        result.right_frames += right
        pair = _as_pair(frames)
        window_of_pairs = pairs[paired_at : paired_at + 12]
        is_paired = pair in window_of_pairs
        if is_paired:
            paired_at += window_of_pairs.index(pair) + 1
        is_right = right == len(frames) and is_paired
        result.right_transactions += is_right
        if not is_right and len(result.examples) < 8:
            result.examples.append(f"sent {frames}\n    heard {named[max(0, at - 3) : at + 4]}")
    return result


def measure(framing: Framing, count: int, faults: float, seed: int, latency: float) -> Result:
    made = line(framing, count, faults, seed, latency)
    named, done = heard(framing, _glued(made.pieces, latency))
    result = compared(made.told, named, _pairs(done))
    result.faults = made.faults
    return result


WANTED = {0.0: 1.0, 0.01: 0.99, 0.05: 0.95}


def main() -> int:
    total, seed = numbers(__doc__, transactions=100_000, seed=1)
    cases = [
        (framing, faults, latency)
        for framing in ("rtu", "ascii")
        for latency in (LATENCY, SLOW_LATENCY)
        for faults in WANTED
    ]
    with ProcessPoolExecutor() as processes, progress(f"{len(cases)} x {total} transactions"):
        waiting = {
            case: processes.submit(measure, case[0], total, case[1], seed, case[2])
            for case in cases
        }
        results = {case: future.result() for case, future in waiting.items()}
    print(f"{'':24}{'faults':>8}{'transactions right':>22}{'frames right':>16}")
    for (framing, faults, latency), result in results.items():
        name = f"{framing}, {faults:4.0%}, {latency * 1000:3.0f} ms"
        print(
            f"{name:24}{result.faults:>8}{result.share:>21.3%}"
            f"{result.right_frames / result.frames:>16.3%}"
        )
        for example in result.examples if "-v" in sys.argv else ():
            print(f"  {example}")
    good = all(result.share >= WANTED[faults] for (_, faults, _), result in results.items())
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
