"""
Processes that attack a server, and an innocent client that polls it meanwhile.

The attackers are a process of their own, at the lowest priority, for they stand for other machines:
python -m bench.attackers NAME PORT. It says "ready", attacks from the first line of its input to
the end of it, and prints what it did as JSON.
"""

from __future__ import annotations

import heapq
import itertools
import json
import os
import select
import selectors
import socket
import ssl
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import IO, NamedTuple, Self

from tests.support import certificates
from tests.support.attacks import (
    ATTACKS,
    Attack,
    Step,
    adu,
    connect,
    descriptor_limit,
    receive,
)
from tests.support.certificates import Pki

# --- the innocent ------------------------------------------------------------------------


@dataclass
class Polled:
    """What became of an innocent's requests; times are in seconds."""

    latencies: list[float] = field(default_factory=list)
    lost: int = 0
    wrong: int = 0

    @property
    def requests(self) -> int:
        return len(self.latencies) + self.lost

    @property
    def median(self) -> float:
        return statistics.median(self.latencies)

    @property
    def p99(self) -> float:
        return sorted(self.latencies)[len(self.latencies) * 99 // 100]

    @property
    def worst(self) -> float:
        return max(self.latencies)


class Innocent:
    """
    A well-behaved client that reads what it wrote, every two milliseconds.

    Args:
        pki: for TLS.
    """

    FIRST = 1000
    VALUES = tuple(range(40_000, 40_010))
    PERIOD = 0.002

    def __init__(self, port: int, pki: Pki | None = None) -> None:
        self._port = port
        self._pki = pki
        self._transaction = 0
        self._connection = self._connect()
        data = struct.pack(f">{len(self.VALUES)}H", *self.VALUES)
        self._request = struct.pack(">BHH", 3, self.FIRST, len(self.VALUES))
        self._answer = bytes([3, len(data)]) + data
        written = struct.pack(">BHHB", 16, self.FIRST, len(self.VALUES), len(data)) + data
        self._connection.sendall(adu(written))
        assert receive(self._connection, 12) == adu(written[:5])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def poll(self, seconds: float, until: Callable[[], bool] = lambda: True) -> Polled:
        """Ask for so many seconds, and until a function returns True."""
        polled = Polled()
        end = time.perf_counter() + seconds
        while time.perf_counter() < end or not until():
            self._ask(polled)
            time.sleep(self.PERIOD)
        return polled

    def _ask(self, polled: Polled) -> None:
        self._transaction = (self._transaction + 1) & 0xFFFF
        expected = adu(self._answer, self._transaction)
        start = time.perf_counter()
        try:
            self._connection.sendall(adu(self._request, self._transaction))
            answer = receive(self._connection, len(expected))
        except OSError:
            answer = b""
        if len(answer) < len(expected):
            polled.lost += 1
            self._connection.close()
            self._connection = self._connect()
            return
        polled.latencies.append(time.perf_counter() - start)
        polled.wrong += answer != expected

    def _connect(self) -> socket.socket:
        connection = connect(self._port)
        if self._pki is None:
            return connection
        context = ssl.create_default_context(cafile=str(self._pki.ca))
        files = self._pki.files(certificates.client())
        context.load_cert_chain(files.cert, files.key)
        return context.wrap_socket(connection, server_hostname="localhost")


# --- the attackers -----------------------------------------------------------------------------


class Done(NamedTuple):
    """The figures of an attack: connections made, bytes sent and received."""

    connected: int
    sent: int
    received: int


class AttackerProcess:
    """All the attackers of one attack."""

    def __init__(self, attack: Attack, port: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.attackers", attack.name, str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.pid = self._process.pid
        self._all_attack = False
        assert self._read_line() == "ready\n"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def begin(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write("go\n")
        self._process.stdin.flush()

    def all_attack(self) -> bool:
        """Return True if all connections were made, and have sent what each of them sends."""
        if not self._all_attack and select.select([self._process.stdout], [], [], 0)[0]:
            self._all_attack = self._read_line() == "all\n"
        return self._all_attack

    def end(self) -> Done:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.stdin = None  # with stdin open, communicate() would flush stdin
        line = self._read_line()
        return Done(*json.loads(self._read_line() if line == "all\n" else line))

    def _read_line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()


class Attackers:
    """All connections of an attack, in one thread."""

    def __init__(self, attack: Attack, port: int) -> None:
        self.attack = attack
        self.port = port
        self.connected = self.sent = self.received = 0
        self.selector = selectors.DefaultSelector()
        self._open: set[Attacker] = set()
        self._order = itertools.count()
        self._pauses: list[tuple[float, int, Attacker]] = []

    def run(self, until: IO[str]) -> Done:
        """Attack until standard input can be read."""
        self.selector.register(until, selectors.EVENT_READ)
        for number in range(self.attack.connections):
            self.add(number)
        is_told = False
        while self._turn():
            if not is_told and self._all_attack():
                is_told = True
                print("all", flush=True)
        for attacker in self._open:
            attacker.close()
        return Done(self.connected, self.sent, self.received)

    def _all_attack(self) -> bool:
        return self.connected >= self.attack.connections and (
            self.sent > 0 or not self.attack.sends
        )

    def add(self, number: int) -> None:
        self._open.add(Attacker(self, number))

    def remove(self, attacker: Attacker) -> None:
        self._open.discard(attacker)

    def pause(self, attacker: Attacker, seconds: float) -> None:
        heapq.heappush(self._pauses, (time.monotonic() + seconds, next(self._order), attacker))

    def _turn(self) -> bool:
        wait = max(0.0, self._pauses[0][0] - time.monotonic()) if self._pauses else None
        for key, events in self.selector.select(wait):
            if key.data is None:
                return False
            key.data.act(events)
        while self._pauses and self._pauses[0][0] <= time.monotonic():
            attacker = heapq.heappop(self._pauses)[2]
            if attacker in self._open:
                attacker.go_on()
        return True


class Attacker:
    """One connection. When it ends, another one of its number begins."""

    # Linux keeps for connect() what port there will be: another peer, the same port.
    IP_BIND_ADDRESS_NO_PORT = 24

    def __init__(self, attackers: Attackers, number: int) -> None:
        self._all = attackers
        self._number = number
        self._reads = attackers.attack.reads
        self._script = attackers.attack.script()
        self._step = Step()
        self._unsent = self._awaited = 0
        self._is_connected = False
        self._socket = socket.socket()
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # An address for each, so that none runs out of ports.
        self._socket.setsockopt(socket.IPPROTO_IP, self.IP_BIND_ADDRESS_NO_PORT, 1)
        self._socket.bind((f"127.1.{number // 250}.{1 + number % 250}", 0))
        self._socket.connect_ex(("127.0.0.1", attackers.port))
        attackers.selector.register(self._socket, selectors.EVENT_WRITE, self)

    def close(self) -> None:
        self._all.selector.unregister(self._socket)
        self._socket.close()

    def act(self, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                self._read()
            if events & selectors.EVENT_WRITE:
                self._write()
        except BlockingIOError:
            pass
        except OSError:
            self._begin_again()

    def go_on(self) -> None:
        """Take the next step of the attack."""
        step = next(self._script, None)
        if step is None:
            self._begin_again()
            return
        self._step, self._unsent, self._awaited = step, len(step.send), step.answer
        if self._unsent:
            self._watch(selectors.EVENT_WRITE | selectors.EVENT_READ * self._reads)
        else:
            self._end_sending()

    def _begin_again(self) -> None:
        self.close()
        self._all.remove(self)
        self._all.add(self._number)

    def _read(self) -> None:
        data = self._socket.recv(65536)
        if not data:
            raise ConnectionResetError
        self._all.received += len(data)
        if self._awaited:
            self._awaited = max(0, self._awaited - len(data))
            if not self._awaited:
                self.go_on()

    def _write(self) -> None:
        if not self._is_connected:
            self._begin()
            return
        sent = self._socket.send(self._step.send[-self._unsent :])
        self._all.sent += sent
        self._unsent -= sent
        if not self._unsent:
            self._end_sending()

    def _begin(self) -> None:
        if error := self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            raise OSError(error, os.strerror(error))
        self._is_connected = True
        self._all.connected += 1
        self.go_on()

    def _end_sending(self) -> None:
        self._watch(selectors.EVENT_READ)
        if self._step.pause:
            self._all.pause(self, self._step.pause)
        elif not self._awaited:
            self.go_on()

    def _watch(self, events: int) -> None:
        self._all.selector.modify(self._socket, events, self)


def main(name: str, port: str) -> None:
    os.nice(19)
    attack = next(attack for attack in ATTACKS if attack.name == name)
    with descriptor_limit():
        print("ready", flush=True)
        sys.stdin.readline()
        print(json.dumps(Attackers(attack, int(port)).run(until=sys.stdin)))


if __name__ == "__main__":
    main(*sys.argv[1:])
