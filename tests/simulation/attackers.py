"""
The attacks of `tests.support.attacks` on a LAN, and an innocent client that counts turns.

Nothing takes time on a LAN but the network. So what others cost a client is counted in turns of
the server's loop and in requests, from the arrival of its request to the answer.
"""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Self

from libmodbus_py.ports.endpoint import parse
from tests.support.attacks import UNIT, Attack, Step, adu

from .lan import Lan, LanClient
from .sockets import DELAY, MemorySocket, at_once

# How often an attacker that cannot send, or has sent, tries to send again.
PERIOD = 0.001


class Attackers:
    """All connections of an attack, each from a host of its own, until it is left."""

    def __init__(self, lan: Lan, attack: Attack, url: str) -> None:
        self.attack: Attack = attack
        self.connected = self.sent = self.received = 0
        self.lan: Lan = lan
        self.is_over: bool = False
        endpoint = parse(url)
        self.target: tuple[str, int] = endpoint.host, endpoint.port
        self._attackers = [_Attacker(self, number) for number in range(attack.connections)]

    def __enter__(self) -> Self:
        for attacker in self._attackers:
            attacker.begin()
        return self

    def __exit__(self, *_: object) -> None:
        self.is_over = True
        for attacker in self._attackers:
            attacker.end.close()

    @property
    def all_attack(self) -> bool:
        """True if all connections were made, and have sent what each of them sends."""
        has_sent = self.sent > 0 or not self.attack.sends
        return self.connected >= self.attack.connections and has_sent


class _Attacker:
    end: MemorySocket

    def __init__(self, attackers: Attackers, number: int) -> None:
        self._all = attackers
        self._lan = attackers.lan
        self._source = f"10.1.{number // 250}.{1 + number % 250}"

    def begin(self) -> None:
        if self._all.is_over:
            return
        connection, _ = self._lan.connect(*self._all.target, self._source)
        assert connection is not None
        self.end = connection
        self._script = self._all.attack.script()
        self._step = Step()
        self._awaited = 0
        if self._all.attack.reads:
            connection.on_input = lambda: self._read(connection)
        self._later(self._connected, 3 * DELAY)

    def _later(self, call: object, seconds: float = PERIOD) -> None:
        self._lan.events.after(seconds, self._if_open, self.end, call)

    def _if_open(self, end: MemorySocket, call: object) -> None:
        if end is self.end and not end.is_closed and callable(call):
            call()

    def _connected(self) -> None:
        self._all.connected += 1
        self._go_on()

    def _go_on(self) -> None:
        step = next(self._script, None)
        if step is None:
            self._begin_again()
            return
        self._step, self._awaited = step, step.answer
        self._write(step.send)

    def _write(self, data: bytes) -> None:
        try:
            count = self.end.send(data) if data else 0
        except BlockingIOError:
            count = 0
        except OSError:
            self._begin_again()
            return
        self._all.sent += count
        if count < len(data):
            self._later(lambda: self._write(data[count:]))
        elif self._step.pause or not self._awaited:
            self._later(self._go_on, self._step.pause or PERIOD)

    def _read(self, end: MemorySocket) -> None:
        while end.is_readable and end is self.end and not end.is_closed:
            try:
                data = end.recv(65_536)
            except OSError:
                data = b""
            if not data:
                self._begin_again()
                return
            self._all.received += len(data)
            if self._awaited:
                self._awaited = max(0, self._awaited - len(data))
                if not self._awaited and not self._step.pause:
                    self._go_on()

    def _begin_again(self) -> None:
        self.end.close()
        self._lan.events.after(PERIOD, self.begin)


@dataclass
class Waited:
    """What an innocent client had to wait for."""

    turns: list[int] = field(default_factory=list)
    others: list[int] = field(default_factory=list)
    longest: int = 0


class Innocent:
    """A client that reads what it wrote."""

    FIRST = 1000
    VALUES = tuple(range(40_000, 40_010))

    def __init__(self, lan: Lan, client: LanClient, count: Callable[[], int]) -> None:
        self._lan = lan
        self._client = client
        self._requests = count
        self._transaction = 0
        self._arrived = self._answered = (0, 0)
        data = struct.pack(f">{len(self.VALUES)}H", *self.VALUES)
        self._request = struct.pack(">BHH", 3, self.FIRST, len(self.VALUES))
        self._answer = bytes([3, len(data)]) + data
        body = struct.pack(">BHHB", 16, self.FIRST, len(self.VALUES), len(data)) + data
        client.sendall(adu(body, 1, UNIT))
        assert client.receive(12) == adu(body[:5], 1, UNIT)
        client.end.other.carriage = self._note_answer

    def poll(self, requests: int, among: Attackers | None = None) -> Waited:
        """Ask so often; with attackers, when they have just sent, so that all arrive at once."""
        waited = Waited()
        before = self._requests()

        def note_turn() -> None:
            nonlocal before
            now = self._requests()
            waited.longest, before = max(waited.longest, now - before), now

        self._lan.call_each_turn(note_turn)
        for _ in range(requests):
            if among is not None:
                count = among.sent
                # One second, or what a moment is to those who send nothing.
                most = 1 if among.attack.sends else PERIOD
                self._lan.until(lambda: among.sent > count, most)  # noqa: B023
            self._ask(waited)
        return waited

    def _ask(self, waited: Waited) -> None:
        self._transaction = (self._transaction + 1) & 0xFFFF
        answer = adu(self._answer, self._transaction, UNIT)
        self._client.sendall(adu(self._request, self._transaction, UNIT))
        self._lan.events.after(DELAY, self._note_arrival)
        assert self._client.receive(len(answer)) == answer
        waited.turns.append(self._answered[0] - self._arrived[0])
        waited.others.append(self._answered[1] - self._arrived[1] - 1)

    def _count(self) -> tuple[int, int]:
        return self._lan.turns, self._requests()

    def _note_arrival(self) -> None:
        self._arrived = self._count()

    def _note_answer(self, data: bytes) -> Iterable[tuple[float, bytes]]:
        self._answered = self._count()
        return at_once(data)
