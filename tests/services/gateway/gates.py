"""Gateways between clients and devices, and lines of a gateway without one."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Awaitable, Callable, Hashable, Iterator
from typing import Any, NamedTuple
from unittest.mock import patch

from libmodbus_py import Device, Gateway, Mapping, Route, framing
from libmodbus_py.client import line
from libmodbus_py.client.history import history_of
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.services.gateway.line import NO_ANSWER, ForwardedRequest, GatewayLine, request_of
from libmodbus_py.services.gateway.routes import GatewayOptions
from libmodbus_py.services.gateway.statistics import LineStatistics
from tests.simulation.lan import Lan
from tests.simulation.network import Network
from tests.simulation.runner import runner_of
from tests.simulation.scripted import Scripted, Write
from tests.support.driver import rtu

READ_ONE = bytes.fromhex("03 0000 0001")


def adu(data: bytes, transaction: int = 1, unit: int = 1) -> bytes:
    return struct.pack(">HHHB", transaction, 0, 1 + len(data), unit) + data


LINE = "rtu:///dev/line"


def small() -> Device:
    return Device(Mapping(10, 10, 10, 10))


class Gate:
    """Unit 1 on the line behind a gateway, which answers from when it is opened on."""

    def __init__(self, lan: Lan) -> None:
        self.asked: list[int] = []
        self.kinds: list[str] = []
        self._device = Device(Mapping(10, 10, 10, 10))
        self._device.mapping.holding_registers[7] = 7
        self._framer = framing.make_framer("rtu", "server")
        self._is_open = False
        self._held: list[tuple[bytes, Write]] = []
        Scripted(lan, LINE, self._take)

    def open(self) -> None:
        self._is_open = True
        answers, self._held = self._held, []
        for request, write in answers:
            self._answer(request, write)

    def _take(self, request: bytes, write: Write) -> None:
        self.asked.append(int.from_bytes(request[2:4], "big"))
        self.kinds.append("read" if request[1] == 3 else "write")
        if self._is_open:
            self._answer(request, write)
        else:
            self._held.append((request, write))

    def _answer(self, request: bytes, write: Write) -> None:
        answer = self._device.answer(request[1:-2])
        write(self._framer.encode(framing.Frame(request[0], answer)))


@contextlib.contextmanager
def gated(lan: Lan, route: dict[str, Any] | None = None, **options: Any) -> Iterator[Gated]:
    """A gateway before a gate, with its line and where clients find it."""
    gate = Gate(lan)
    routes = [Route(f"{LINE}?timeout=1000", **(route or {}))]
    gateway_ = Gateway(routes, longest_wait=5000, **options)
    with gateway_.background("tcp://10.0.0.1:0") as running:
        (line,) = gateway_.traffic.lines.values()
        yield Gated(gate, line, running.urls[0], gateway_)


class Gated(NamedTuple):
    gate: Gate
    line: LineStatistics
    url: str
    made: Gateway


def numbered(number: int) -> Device:
    device = small()
    device.mapping.holding_registers[0] = number
    return device


@contextlib.contextmanager
def gateway(routes: list[Route], *urls: str, **options: Any) -> Iterator[tuple[Gateway, str]]:
    gateway_ = Gateway(routes, **options)
    with gateway_.background(*(urls or ("tcp://127.0.0.1:0",))) as running:
        yield gateway_, running.urls[0]


READ, WRITE, UNKNOWN = "03 0000 0001", "06 0000 0007", "08 0000 0001"
INPUTS = "04 0000 0001"

TIMEOUT = 0.5

REFUSED = f"83{NO_ANSWER:02x}"


class Asker:
    """A client of the gateway, and what it was told."""

    def __init__(self, host: Hashable = "192.0.2.1") -> None:
        self.host = host
        self.answers: list[str | None] = []

    def take_response(self, forwarded: ForwardedRequest, response: bytes | None) -> None:
        self.answers.append(None if response is None else response.hex())


class Plant:
    """
    A line, and units on it that answer each request after a while, if at all. `asked`: the units
    that were asked, in their order; or the function, with a minus; `silent`: units that give no
    answer; and `unanswered` functions; `damaging`: units whose answers have wrong check bytes;
    `delay`: seconds that an answer takes; or `delays`, by unit.
    """

    def __init__(self, url: str = f"{LINE}?timeout={TIMEOUT}", **options: Any) -> None:
        self.network = Network()
        self.options = options
        self.asked: list[int] = []
        self.silent: set[int] = set()
        self.unanswered: set[int] = set()
        self.damaging: set[int] = set()
        self.delay = 0.05
        self.delays: dict[int, float] = {}
        self.line: GatewayLine
        url, _, query = url.partition("?")
        self.peer = Scripted(self.network, url, self._answer)
        self.url = f"{self.peer.url}{'&' if '?' in self.peer.url else '?'}{query}"
        self._has_ids = url.startswith("tcp")

    def _answer(self, request: bytes, write: Write) -> None:
        head, unit, body = request[:4], request[6 if self._has_ids else 0], request[1:-2]
        body = request[7:] if self._has_ids else body
        self.asked.append(-body[0] if body[0] in self.unanswered else unit)
        if unit in self.silent or not unit or body[0] in self.unanswered:
            return
        pdu = body
        if body[0] in (3, 4):
            pdu = body[:1] + b"\x02" + bytes([unit, len(self.asked) & 0xFF])
        answer = rtu(bytes([unit, *pdu]).hex())
        if unit in self.damaging:
            answer = answer[:-1] + bytes([answer[-1] ^ 1])
        if self._has_ids:
            answer = head + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu
        write(answer, self.delays.get(unit, self.delay))

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        async def whole() -> None:
            self.line = GatewayLine(parse(self.url), GatewayOptions(**self.options))
            try:
                await main()
            finally:
                await self.line.close()
            statistics = self.line.statistics
            assert (statistics.waiting, statistics.in_flight) == (0, 0)

        # As if the line had been open for long: its first answers are not held.
        history_of(parse(self.url)).pair(255, 3, 0.0)
        with patch.object(line, "OPENED_S", 0.0):
            self.network.run(whole)

    def ask(
        self, unit: int, asker: Asker, request: str = READ, *, merge: bool = False, age: float = 0
    ) -> ForwardedRequest:
        given = request_of(bytes.fromhex(request))
        each = ForwardedRequest(asker, 1, unit, unit, given, self.network.events.now, age)
        if code := self.line.put(each, merge=merge):
            asker.answers.append(f"code {code}")
        return each

    def has_cached(self, unit: int) -> bool:
        read, now = request_of(bytes.fromhex(READ)), self.network.events.now
        return self.line.cached_response(unit, read, 60, now) is not None

    @property
    def unit(self) -> Any:
        return self.line.statistics.unit


def on_line(*urls: str, **options: Any) -> Callable[[Any], Any]:
    """Let a test run on a plant, its first argument, in simulated time."""

    def run(test: Callable[[Plant], Awaitable[None]]) -> None:
        plant = Plant(*urls, **options)
        plant.run(lambda: test(plant))

    return runner_of(run)


def answer_of(unit: int, number: int) -> str:
    return bytes([3, 2, unit, number]).hex()
