"""
A serial line on which things go wrong, one at a time and on demand.

Two pseudo-terminals, joined like the cable of
`libmodbus_py.tools.testing.wires.SerialWire`. The next frame of one side suffers what `arm`
says; all others pass untouched.

What is injected is what the framing promises to notice, so that a wrong value
that gets through is a defect and no bad luck:

* CRC-16 notices up to three flipped bits in a frame and bursts of up to sixteen;
  all else (lost, doubled, foreign bytes) but one time in 65536.
* The LRC of ASCII is a sum of bytes: it notices what changes a single one of
  them, and an odd number of characters cannot be pairs of digits. Two flips in
  different bytes may cancel out, so flips and bursts stay inside one character, and
  one character is lost or doubled (or all to the end of the frame is lost).

No bytes come later than a client may have to reckon with: an answer that is
older than the timeout of its request and the silence after it is lost instead.
"""

from __future__ import annotations

import heapq
import json
import os
import random
import select
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple, Self

from libmodbus_py.tools.testing.wires import open_line, read_what_is_there, write_all

__all__ = ["FAULTS", "FOREIGN", "UNITS", "BadLine", "Framing", "Hurt", "Piece", "Sender"]

Framing = Literal["rtu", "ascii"]
Sender = Literal["client", "server"]


class Piece(NamedTuple):
    """Bytes, and after which part of the client's timeout they go on."""

    after: float
    data: bytes


class Event(NamedTuple):
    """Bytes that came into the line, or went on."""

    at: float
    what: str
    sender: Sender
    data: bytes

    def __str__(self) -> str:
        shown = self.data[:24].hex(" ") + " ..." * (len(self.data) > 24)
        return f"{self.at:.4f} {self.what} {self.sender}: {len(self.data)} bytes {shown}"


class Hurt(NamedTuple):
    """A frame, and the faults that may happen to it."""

    frame: bytes
    framing: Framing
    random: random.Random

    def place(self) -> int:
        return self.random.randrange(len(self.frame))

    def with_bits(self, bits: set[int]) -> list[Piece]:
        number = int.from_bytes(self.frame, "big")
        for bit in bits:
            number ^= 1 << bit
        return [Piece(0, number.to_bytes(len(self.frame), "big"))]

    def beside(self, data: bytes) -> list[Piece]:
        return [Piece(0, data + self.frame if self.random.random() < 0.5 else self.frame + data)]


def flip(hurt: Hurt) -> list[Piece]:
    size = 8 if hurt.framing == "ascii" else 8 * len(hurt.frame)
    bits = hurt.random.sample(range(size), hurt.random.randint(1, 3))
    first = 8 * hurt.place() if hurt.framing == "ascii" else 0
    return hurt.with_bits({first + bit for bit in bits})


def burst(hurt: Hurt) -> list[Piece]:
    if hurt.framing == "ascii":
        first, length = 8 * hurt.place(), 8
    else:
        length = hurt.random.randint(2, 16)
        first = hurt.random.randrange(8 * len(hurt.frame) - length + 1)
    inside = {bit for bit in range(first + 1, first + length - 1) if hurt.random.random() < 0.5}
    return hurt.with_bits({first, first + length - 1, *inside})


def lose(hurt: Hurt) -> list[Piece]:
    frame, at = hurt.frame, hurt.place()
    lost = 1
    if hurt.framing == "rtu":
        lost = hurt.random.randint(1, len(frame) - at)
    return [Piece(0, frame[:at] + frame[at + lost :])]


def cut(hurt: Hurt) -> list[Piece]:
    return [Piece(0, hurt.frame[: hurt.place()])]


def double(hurt: Hurt) -> list[Piece]:
    frame, at = hurt.frame, hurt.place()
    size = 1 if hurt.framing == "ascii" else hurt.random.randint(1, 6)
    return [Piece(0, frame[: at + size] + frame[at:])]


def delay(hurt: Hurt) -> list[Piece]:
    at, after = (
        hurt.random.choice([0, hurt.place()]),
        hurt.random.choice([(0.02, 0.9), (1.05, 1.4)]),
    )
    return [Piece(0, hurt.frame[:at]), Piece(hurt.random.uniform(*after), hurt.frame[at:])]


def merge(hurt: Hurt) -> list[Piece]:
    return hurt.beside(hurt.random.choice(FOREIGN[hurt.framing]))


def noise(hurt: Hurt) -> list[Piece]:
    return hurt.beside(hurt.random.randbytes(hurt.random.randint(1, 20)))


FAULTS: dict[str, Callable[[Hurt], list[Piece]]] = {
    "flip": flip,
    "burst": burst,
    "lose": lose,
    "cut": cut,
    "double": double,
    "delay": delay,
    "merge": merge,
    "noise": noise,
}
"""
What can happen to a frame: one to three bits flipped; two to sixteen bits changed in a
row; bytes lost; the rest lost; bytes doubled; all or the rest late; the frame of another unit
glued to it; noise before or behind it.
"""

UNITS = (77, 78, 79)  # no units of the worked examples, whose frames belong to other units here

_EXAMPLES = json.loads(
    (Path(__file__).parents[1] / "tests" / "support" / "vectors.json").read_text()
)
_FRAMES = [example for example in _EXAMPLES if "rtu" in example]
_OTHERS = [example for example in _FRAMES if example["unit"] not in (0, *UNITS)]

FOREIGN: dict[Framing, list[bytes]] = {
    "rtu": [bytes.fromhex(example["rtu"]) for example in _OTHERS],
    "ascii": [example["ascii"].encode() for example in _OTHERS],
}
"""Whole frames of other units, requests and responses."""

# Within these parts of the client's timeout an answer must pass.
LATEST = 1.75

# Frames are written at once; whatever follows within this time belongs to them.
GAP = 0.001


class BadLine:
    """
    Args:
        framing: what is spoken on it.
        timeout: of the client, in seconds.
        seed: of the random choices.

    Attributes:
        client, server: the paths of the ports.
        injected: what went wrong, as (kind, whose frame): how often.
        outdated: answers that were lost because they would have come too late.
        recent: what went in and out lately, to explain a finding.
    """

    def __init__(self, framing: Framing, timeout: float, seed: int) -> None:
        self.injected: Counter[tuple[str, Sender]] = Counter()
        self.outdated = 0
        self.recent: deque[Event] = deque(maxlen=16)
        self._framing = framing
        self._timeout = timeout
        self._random = random.Random(seed)
        self._armed: tuple[str, Sender] | None = None
        self._late: list[tuple[float, float, Sender, bytes]] = []
        self._asked_at = 0.0
        self._masters: dict[Sender, int] = {}
        self._slaves: dict[Sender, int] = {}
        self._masters["client"], self._slaves["client"], self.client = open_line()
        self._masters["server"], self._slaves["server"], self.server = open_line()
        self._wake, self._sleep = socket.socketpair()
        self._thread = threading.Thread(target=self._carry, name="bad line", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wake.close()
        self._thread.join()
        self._sleep.close()
        for descriptor in (*self._masters.values(), *self._slaves.values()):
            os.close(descriptor)

    @property
    def is_clean(self) -> bool:
        """Return True if no fault and no late byte is still to come."""
        return self._armed is None and not self._late

    def arm(self, kind: str, sender: Sender) -> None:
        """Let one of `FAULTS` happen to the next frame of this side."""
        self._armed = kind, sender

    def disarm(self) -> None:
        """Let no more faults happen; late bytes still come."""
        self._armed = None

    def _carry(self) -> None:
        while True:
            wait = max(0.0, self._late[0][0] - time.monotonic()) if self._late else None
            ready, _, _ = select.select([*self._masters.values(), self._sleep], [], [], wait)
            if self._sleep in ready:
                return
            for side, master in self._masters.items():
                if master in ready and (data := read_what_is_there(master)):
                    self._pass(side, data)
            while self._late and self._late[0][0] <= time.monotonic():
                _, asked_at, side, data = heapq.heappop(self._late)
                self._deliver(asked_at, side, data)

    def _pass(self, sender: Sender, data: bytes) -> None:
        self._log("from", sender, data)
        if sender == "client":
            self._asked_at = time.monotonic()
        armed = self._armed
        if armed is None or armed[1] != sender:
            self._deliver(self._asked_at, sender, data)
            return
        data += self._rest(sender)
        self._armed = None
        self.injected[armed] += 1
        for after, piece in FAULTS[armed[0]](Hurt(data, self._framing, self._random)):
            if after:
                at = time.monotonic() + after * self._timeout
                heapq.heappush(self._late, (at, self._asked_at, sender, piece))
            else:
                self._deliver(self._asked_at, sender, piece)

    def _rest(self, sender: Sender) -> bytes:
        rest = bytearray()
        while select.select([self._masters[sender]], [], [], GAP)[0]:
            rest += read_what_is_there(self._masters[sender])
        return bytes(rest)

    def _deliver(self, asked_at: float, sender: Sender, data: bytes) -> None:
        if sender == "server" and time.monotonic() - asked_at > LATEST * self._timeout:
            self.outdated += 1
        elif data:
            self._log("on, from", sender, data)
            write_all(self._masters["server" if sender == "client" else "client"], data)

    def _log(self, what: str, sender: Sender, data: bytes) -> None:
        self.recent.append(Event(time.monotonic(), what, sender, data))
