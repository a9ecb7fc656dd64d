"""
A server on a stage, and the requests that tests of its limits send there.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from libmodbus_py import Device, Fault, Mapping, Server, framing
from libmodbus_py.server.limits import Limits
from tests.simulation.stage import Stage, Talker
from tests.support.attacks import READ_MOST, READ_ONE, adu

__all__ = [
    "ANSWER_MOST",
    "ANSWER_ONE",
    "KINDS",
    "MOST_ANSWER",
    "NEVER",
    "ONE_ANSWER",
    "OTHER",
    "READ_MOST",
    "READ_ONE",
    "Served",
    "adu",
    "ask",
    "rtu",
    "served",
]

ANSWER_ONE = bytes.fromhex("03 02 0000")
ONE_ANSWER = len(adu(ANSWER_ONE))
ANSWER_MOST = bytes([3, 250]) + bytes(250)
MOST_ANSWER = len(adu(ANSWER_MOST))

KINDS = ["plain", "hooked", "faulty"]
"""Most of the server's ways to answer: in C by the chunk, through hooks, with faults."""

NEVER = Fault("no_answer", function=100)
"""Happens to nobody here, but makes every answer go the way of faults."""

OTHER = "10.255.0.2"
"""The address of a client that is another one than the usual."""

# What a request and its answer take on the network in memory, at most.
ROUND_TRIP = 0.001


class Served:
    """
    A server on a stage.

    Attributes:
        statistics: what it counts.
        url: where it listens.
    """

    def __init__(self, stage: Stage, server: Server, url: str) -> None:
        self.statistics = server.statistics
        self.url = url
        self._stage = stage

    def connect(self, source: str | None = None) -> Talker:
        return self._stage.talk(self.url, source)

    def counts(self, **expected: int) -> bool:
        """Assert what it has counted of that, when all that was sent has arrived."""
        self._stage.pass_time(ROUND_TRIP)
        counted = asdict(self.statistics)
        found = {name: counted[name] for name in expected}
        assert found == expected, f"{found} in place of {expected}"
        return True


@contextmanager
def served(
    stage: Stage, kind: str = "plain", scheme: str = "tcp", **limits: Any
) -> Iterator[Served]:
    mapping = Mapping(holding_registers=125)
    device = Device(mapping, before_read=(lambda access: None) if kind == "hooked" else None)
    faults = {None: [NEVER]} if kind == "faulty" else None
    server = Server({17: device}, faults, Limits(**limits))
    with server.background(f"{scheme}://10.0.0.1:0") as running:
        yield Served(stage, server, running.urls[0])


def ask(client: Talker, transaction: int = 1) -> None:
    """Send a request, and take its answer."""
    client.sendall(adu(READ_ONE, transaction))
    assert client.receive(ONE_ANSWER) == adu(ANSWER_ONE, transaction)


def rtu(pdu: bytes, unit: int = 17) -> bytes:
    return framing.RtuFramer("server").encode(framing.Frame(unit, pdu))
