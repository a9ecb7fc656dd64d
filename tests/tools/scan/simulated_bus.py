"""
What a scan meets, in simulated time: a serial bus whose devices hear only what is sent at their
own settings, and peers on a network that answer what they are told.
"""

import os
import termios
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from libmodbus_py import Device, Server, framing
from libmodbus_py.device.access import Caller
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.lines import MemorySerialPort, Party
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted, Write
from tests.support.peers import until

# A request PDU -> the answer PDU, or None for silence; EOFError takes the port away.
Answer = Callable[[bytes], bytes | None]


class Member(NamedTuple):
    """
    One device. `answer`: what it answers; `baudrate, stop_bits`: at which it is heard; `after`:
    seconds that it takes; `garbles`: whether it is heard at other settings, too, as damaged bytes.
    """

    answer: Answer
    baudrate: int
    stop_bits: int = 1
    after: float = 0.0
    garbles: bool = False


def of(device: Device) -> Answer:
    """Let a device of ours answer."""
    return lambda pdu: device.answer(pdu, Caller(1, "test"))


@contextmanager
def line(units: dict[int, Device]) -> Iterator[SerialWire]:
    """A pseudo-terminal with units; whoever scans it restores its settings."""
    with SerialWire() as wire, ExitStack() as stack:
        if units:
            stack.enter_context(Server(units).background(f"rtu://{wire.server}"))
        before = _settings(wire.client)
        yield wire
        if os.path.exists(wire.client):  # otherwise the line was unplugged
            until(lambda: _settings(wire.client) == before)


def _settings(path: str) -> list[Any]:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        return termios.tcgetattr(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def simulated(seed: int = 1) -> Iterator[Network]:
    """Let clients that are made meanwhile use a network in memory, on simulated time."""
    network = Network(seed)
    with network.installed():
        yield network


class SimulatedBus(Party):
    """
    Units on a line in memory, of which each hears only what is sent at its own settings. `url`: of
    the line; `asked`: every request, as (baudrate, unit, PDU).
    """

    is_unit = True

    def __init__(self, network: Network, units: dict[int, Member], scheme: str = "rtu") -> None:
        self.url: str = f"{scheme}:///dev/line"
        self.asked: list[tuple[int, int, bytes]] = []
        self._units = units
        self._events = network.events
        self._line = network.line("/dev/line")
        self._line.join(self)
        self._framing: Any = scheme

    def flood(self, data: bytes, every: float) -> None:
        """Send without having been asked, from now on."""
        self._line.write(self, data)
        self._events.after(every, self.flood, data, every)

    def hear(self, data: bytes) -> None:
        (port,) = (party for party in self._line.parties if isinstance(party, MemorySerialPort))
        self._line.character = port.character
        framer = framing.make_framer(self._framing, "server")
        for frame in framer.scan(data):
            if isinstance(frame, framing.Frame):
                self.asked.append((port.baudrate, frame.unit, frame.pdu))
                self._answer(framer, frame, (port.baudrate, port.stop_bits))

    def _answer(
        self, framer: framing.Framer, frame: framing.Frame, settings: tuple[int, int]
    ) -> None:
        member = self._units.get(frame.unit)
        pdu = member.answer(frame.pdu) if member is not None else None
        if member is None or pdu is None:
            return
        adu = framer.encode(framing.Frame(frame.unit, pdu))
        if (member.baudrate, member.stop_bits) != settings:
            if not member.garbles:
                return
            adu = bytes(byte ^ 0xA5 for byte in adu[:5])
        self._events.after(member.after, self._line.write, self, adu)


def served(network: Network, url: str, *answers: Callable[[bytes], list[Any] | None]) -> Scripted:
    """
    Serve answers, as `FakeServer` does; None among the pieces of one closes the connection.
    `answers`: one for each request, in order; the last one goes on.
    """
    replies = list(answers)

    def answer(request: bytes, write: Write) -> None:
        pieces = replies[0](request)
        if len(replies) > 1:
            del replies[0]
        for piece in pieces or []:
            write(piece)

    return Scripted(network, url, answer)


def answering(network: Network, url: str, units: dict[int, Device]) -> Scripted:
    """Serve devices, and have all other units be silent."""
    framer = framing.make_framer(parse(url).framing, "server")

    def answer(data: bytes, write: Write) -> None:
        for frame in framer.scan(data):
            if isinstance(frame, framing.Frame) and frame.unit in units:
                pdu = units[frame.unit].answer(frame.pdu, Caller(frame.unit, "test"))
                assert pdu is not None
                write(framer.encode(frame._replace(pdu=pdu)))

    return Scripted(network, url, answer)
