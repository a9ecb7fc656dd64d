"""A simulated world: a network, a checker, units that misbehave, and how clients ask them."""

import asyncio
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from libmodbus_py import AsyncClient, Client, Gateway, ModbusError

from .devices import COUNT, Behaviour, Bus, Host, Unit
from .network import Network
from .processes import HOST
from .rules import Call, Checker, Wire

Ask = Callable[[int], Awaitable[None]]  # asks a unit once

FAULTS = ("silent", "late", "refuse", "split", "flip", "drop", "other_function", "cancel", "twice")
"""What may go wrong; each may be left out to find the shortest run that fails."""

# Of the faults, how probable each is in a unit that has it.
PROBABILITIES = {
    "silent": 0.2,
    "late": 0.2,
    "refuse": 0.2,
    "split": 0.3,
    "flip": 0.1,
    "drop": 0.02,
    "other_function": 0.1,
    "twice": 0.2,
}

# How many of the units have a fault: where there are many kinds, and where there are one or two.
FEW, MOST = 0.4, 0.8

# Not on which carrier: a stream neither flips bits nor doubles what it carries, unless told.
NOT_OVER_TCP = {"flip", "other_function"}
NOT_ON_LINES = {"drop"}

# How much later than the first the second of two equal answers comes, at most.
APART = 0.05

# Scenarios whose workers are stopped and continued.
WITH_PROCESSES = ("fleet", "plant")

# What may be late in all that is exact: a wait rounded up to the milliseconds of poll.
ROUNDING = 0.002


@dataclass(frozen=True)
class Options:
    """The settings of a run."""

    seed: int
    scenario: str
    seconds: float = 60.0
    clients: int = 4
    units: int = 10
    faults: tuple[str, ...] = FAULTS
    pause: float = 0.5


class World:
    """A network, a checker, and all the units."""

    def __init__(self, options: Options) -> None:
        self.options: Options = options
        self.network: Network = Network(options.seed)
        self.network.has_processes = options.scenario in WITH_PROCESSES
        self.events = self.network.events
        self.random: random.Random = self.events.random
        self.checker: Checker = Checker(self.events)
        self.units: list[Unit] = []
        self.hosts: list[Host] = []
        self.is_calm: bool = False
        self.wire: Wire = Wire(self.events, self.checker)
        self._number = 0

    # --- making it --------------------------------------------------------------------------------

    def unit(self, number: int, faults: set[str], timeout: float) -> Unit:
        """Make a unit; most have some of the faults, each its own."""
        share = FEW if len(faults & PROBABILITIES.keys()) > 2 else MOST
        has = [item for item in PROBABILITIES if item in faults and self.random.random() < share]
        behaviour = Behaviour(
            delay=(0.0005, self.random.choice([0.002, 0.02])),
            lateness=1.8 * timeout,
            apart=APART,
            **{name: PROBABILITIES[name] for name in has},
        )
        unit_ = Unit(number, behaviour, self.events, self.checker.executed)
        self.units.append(unit_)
        return unit_

    def bus(self, device: str, numbers: range, timeout: float, baudrate: int) -> None:
        """Put units on a line."""
        self.checker.is_line = True
        line = self.network.line(device)
        line.character = 11 / baudrate
        faults = set(self.options.faults) - NOT_ON_LINES
        units = [self.unit(number, faults, timeout) for number in numbers]
        Bus(self.events, line, units, max(0.00175, 38.5 / baudrate))

    def host(self, url: str, numbers: range, timeout: float) -> str:
        """Put units behind a TCP port."""
        self.checker.is_line |= not url.startswith("tcp")
        faults = set(self.options.faults) - NOT_OVER_TCP
        units = [self.unit(number, faults, timeout) for number in numbers]
        host = Host(self.network, url, units, 0.95 if "drop" in faults else 1.0)
        self.hosts.append(host)
        return host.url

    def calm(self) -> None:
        """End all faults, and with them the pauses of silent units."""
        self.is_calm = True
        self.checker.paused.clear()
        for unit in self.units:
            unit.behave()
        for host in self.hosts:
            host.accepts = 1.0

    # --- asking -----------------------------------------------------------------------------------

    def call(
        self,
        unit: int,
        limit: float,
        *,
        age: float = 0.0,
        is_direct: bool = True,
        function: int | None = None,
    ) -> Call:
        """Make a request that no other one equals; one of four writes."""
        self._number += 1
        high, low = divmod(self._number, 0x10000)
        kind = function or self.random.choice([3, 3, 3, 6])
        if kind == 3:
            pdu = bytes([3]) + low.to_bytes(2, "big") + bytes([0, COUNT])
        else:
            pdu = bytes([6, high >> 8, high & 0xFF]) + low.to_bytes(2, "big")
        now = self.events.now
        self.wire.host[unit, pdu] = HOST.get()
        call = Call((unit, pdu), now, now + limit + ROUNDING, age, is_direct)
        if not is_direct:
            self.checker.through_gateway.add(call.key)
        self.checker.begin(call)
        return call

    async def act(self, ask: Ask, numbers: range, until: float, host: str = "") -> None:
        """Ask one unit after the other until a time, as a client on a host."""
        if host:
            HOST.set(host)
        while self.events.now < until:
            await asyncio.sleep(self.pause())
            await ask(self.random.choice(numbers))

    def asking(self, plc: AsyncClient, limit: float, **how: Any) -> Ask:
        """Return what asks a unit once, with a client."""

        async def ask(unit: int) -> None:
            await self.ask(plc, self.call(unit, limit, **how))

        return ask

    async def ask(self, plc: AsyncClient, call: Call) -> None:
        """Send a request, and pass its outcome to the checker."""
        try:
            async with asyncio.timeout(self._patience()):
                values = await _requested(plc, call)
        except (ModbusError, TimeoutError) as error:
            self.checker.error(call, error)
        else:
            self.checker.answer(call, values)

    def _patience(self) -> float | None:
        """Seconds until whoever asks gives up himself; None for never."""
        if self.is_calm or "cancel" not in self.options.faults or self.random.random() > 0.05:
            return None
        return self.random.uniform(0, 0.5)

    def ask_blocking(self, context: Client, call: Call) -> None:
        """Ask with a blocking client."""
        try:
            values = _requested(context, call)
        except ModbusError as error:
            self.checker.error(call, error)
        else:
            self.checker.answer(call, values)

    def pause(self) -> float:
        return self.random.expovariate(1 / self.options.pause)


@asynccontextmanager
async def clients(url: str, count: int, **options: Any) -> AsyncIterator[list[AsyncClient]]:
    """Make so many clients of one URL."""
    plcs = [AsyncClient(url, **options) for _ in range(count)]
    try:
        yield plcs
    finally:
        for plc in plcs:
            await plc.close()


@asynccontextmanager
async def asking_gateway(
    world: World, gateway: Gateway, count: int, timeout: float, *, age: float = 0.0
) -> AsyncIterator[list[Ask]]:
    """Let a gateway serve, and give what asks it, with so many clients."""
    url = "tcp://10.0.1.1"
    async with gateway.serving(url), clients(url, count, timeout=timeout) as plcs:
        yield [world.asking(plc, timeout, age=age, is_direct=False) for plc in plcs]


def _requested(plc: AsyncClient | Client, call: Call) -> Any:
    """Return what the client returns: the values, or with asyncio what is awaited for them."""
    unit, pdu = call.key
    address, number = (int.from_bytes(pdu[at : at + 2], "big") for at in (1, 3))
    handle = plc.for_unit(unit)
    if pdu[0] == 3:
        return handle.read_holding_registers(address, number)
    return handle.write_register(address, number)
