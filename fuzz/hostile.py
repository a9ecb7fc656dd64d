"""
Clients that attack, or were written badly, and one that must not suffer from them.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import threading
from collections.abc import Callable
from typing import Self

from fuzz.bad_line import UNITS
from fuzz.checks import examples
from fuzz.transactions import FIXED, register
from libmodbus_py import Client, ModbusError

__all__ = ["STREAMS", "UNIT", "Hostile", "Innocent"]

Frames = Callable[[random.Random], bytes]

UNIT = UNITS[0]


def noise(chance: random.Random) -> bytes:
    return chance.randbytes(chance.randint(1, 5000))


def mutated(chance: random.Random) -> bytes:
    """Examples, most of them with a byte changed, lost or doubled, or their end cut off."""
    stream = bytearray()
    for frame in chance.choices(FRAMES, k=chance.randint(1, 60)):
        at = chance.randrange(len(frame))
        stream += chance.choice(
            [
                frame,
                frame[:at] + chance.randbytes(1) + frame[at + 1 :],
                frame[:at] + frame[at + 1 :],
                frame[: at + 1] + frame[at:],
                frame[:at],
            ]
        )
    return bytes(stream)


def plausible(chance: random.Random) -> bytes:
    """Right headers before bodies that are anything, for the unit of the innocent."""
    stream = bytearray()
    for _ in range(chance.randint(1, 100)):
        function = chance.choice([1, 2, 3, 4, 7, 8, 11, 12, 17, 20, 24, 43, 9, 65, 130])
        body = bytes([function]) + chance.randbytes(chance.choice([0, 1, 4, 4, 4, 5, 9, 60, 252]))
        stream += struct.pack(">HHHB", chance.randrange(65536), 0, 1 + len(body), UNIT) + body
    return bytes(stream)


def impossible(chance: random.Random) -> bytes:
    """Headers with lengths and protocols that cannot be."""
    length = chance.choice([0, 1, 255, 256, 65535])
    return struct.pack(">HHHB", 1, chance.choice([0, 1, 65535]), length, UNIT) + noise(chance)


def flood(chance: random.Random) -> bytes:
    """Requests for the longest answers."""
    read = struct.pack(">HHHBBHH", 1, 0, 6, UNIT, 3, 0, 125)
    return read * chance.randint(500, 3000)


# Requests that write are left out, because they would be carried out.
FRAMES = [frame for frame in examples("tcp") if frame[7] in (1, 2, 3, 4, 7, 8, 11, 12, 17, 20, 24)]

STREAMS: dict[str, Frames] = {
    "noise": noise,
    "mutated examples": mutated,
    "plausible bodies": plausible,
    "impossible headers": impossible,
    "flood, never read": flood,
}
"""What a hostile client sends, made with a random generator."""


class Hostile:
    """
    One hostile client after the other, in a thread, until closed.

    Args:
        port: of a server on 127.0.0.1.
        seed: of the random choices.

    Attributes:
        streams: how many were sent.
        sent: how many bytes the server took.
        by_kind: how often each of `STREAMS` was sent.
    """

    def __init__(self, port: int, seed: int) -> None:
        self.streams = self.sent = 0
        self.by_kind = dict.fromkeys(STREAMS, 0)
        self._port = port
        self._random = random.Random(seed)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._attack, name="hostile", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()

    def _attack(self) -> None:
        while not self._stopped.is_set():
            kind = self._random.choice([*STREAMS])
            with contextlib.suppress(OSError):
                self._send(STREAMS[kind](self._random))
            self.by_kind[kind] += 1
            self.streams += 1

    def _send(self, data: bytes) -> None:
        with socket.create_connection(("127.0.0.1", self._port), 5) as peer:
            peer.settimeout(0.05)  # a client that does not read gets no answers read here
            while data:
                size = self._random.choice([1, 7, 300, 5000, 100_000])
                self.sent += peer.send(data[:size])
                data = data[size:]
            if self._random.random() < 0.5:
                with contextlib.suppress(TimeoutError):
                    peer.recv(1000)


class Innocent:
    """
    A client in order, whose requests all succeed and read what is there.

    Args:
        port: of a server on 127.0.0.1 with a `known_device`.
        seed: of the random choices.

    Attributes:
        reads: how many were right.
        findings: what went wrong, in words.
    """

    def __init__(self, port: int, seed: int) -> None:
        self.reads = 0
        self.findings: list[str] = []
        self._random = random.Random(seed)
        self._context = Client(f"tcp://127.0.0.1:{port}", unit=UNIT, timeout=10)

    def __enter__(self) -> Self:
        self._context.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self._context.close()

    def read(self) -> None:
        """Read some registers, and look whether they are right."""
        count = self._random.randint(1, 125)
        address = self._random.randrange(len(FIXED) - count)
        try:
            got = self._context.read_holding_registers(address, count)
        except ModbusError as error:
            self.findings.append(f"{type(error).__name__}: {error}")
            return
        if got == [register(at) for at in range(address, address + count)]:
            self.reads += 1
        else:
            self.findings.append(f"{count} registers at {address}: {got}")
