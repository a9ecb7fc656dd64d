"""
Casts of a simulated world: who asks whom, over what, and what goes wrong. A seed decides.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from libmodbus_py import AsyncClient, Context, Gateway, ModbusError, Route

from .devices import COUNT, Behaviour, Bus, Host, Unit
from .network import Network
from .rules import Call, Witness

__all__ = ["CASTS", "FAULTS", "Options", "World", "chosen", "play"]

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

# Not on which carrier: a stream neither flips bits nor doubles what it carries, unless told.
NOT_OVER_TCP = {"flip", "other_function"}
NOT_ON_LINES = {"drop"}

# How long everybody is left alone when the faults are over: units rest for half a minute at most.
SETTLING = 70.0

# What may be late in all that is exact: a wait rounded up to the milliseconds of poll.
ROUNDING = 0.002


@dataclass(frozen=True)
class Options:
    """
    What a run is.

    Attributes:
        seed: of every choice.
        cast: a name of `CASTS`.
        seconds: how long it goes wrong.
        clients, units: how many there are.
        faults: which may happen.
        pause: seconds between two requests of a client, on average.
    """

    seed: int
    cast: str
    seconds: float = 60.0
    clients: int = 4
    units: int = 10
    faults: tuple[str, ...] = FAULTS
    pause: float = 0.5


def chosen(seed: int) -> Options:
    """Return the run that a seed stands for."""
    choice = random.Random(seed)
    return Options(
        seed,
        choice.choice(list(CASTS)),
        clients=choice.randint(1, 6),
        units=choice.randint(1, 12),
        faults=tuple(fault for fault in FAULTS[:-1] if choice.random() < 0.6),
        pause=choice.choice([0.01, 0.1, 1.0]),
        seconds=choice.choice([20.0, 60.0]),
    )


class World:
    """
    A network, a witness, and all the units.

    Attributes:
        options: of the run.
        is_calm: whether the faults are over.
    """

    def __init__(self, options: Options) -> None:
        self.options: Options = options
        self.network: Network = Network(options.seed)
        self.events = self.network.events
        self.random: random.Random = self.events.random
        self.witness: Witness = Witness(self.events)
        self.units: list[Unit] = []
        self.hosts: list[Host] = []
        self.is_calm: bool = False
        self._number = 0

    # --- making it --------------------------------------------------------------------------------

    def unit(self, number: int, faults: set[str], timeout: float) -> Unit:
        """Make a unit; most have some of the faults, each its own."""
        has = [each for each in PROBABILITIES if each in faults and self.random.random() < 0.4]
        behaviour = Behaviour(
            delay=(0.0005, self.random.choice([0.002, 0.02])),
            lateness=1.8 * timeout,
            **{name: PROBABILITIES[name] for name in has},
        )
        made = Unit(number, behaviour, self.events, self.witness.executed)
        self.units.append(made)
        return made

    def bus(self, device: str, numbers: range, timeout: float, baudrate: int) -> None:
        """Put units on a line."""
        line = self.network.line(device)
        line.character = 11 / baudrate
        faults = set(self.options.faults) - NOT_ON_LINES
        units = [self.unit(number, faults, timeout) for number in numbers]
        Bus(self.events, line, units, max(0.00175, 38.5 / baudrate))

    def host(self, url: str, numbers: range, timeout: float) -> str:
        """Put units behind a TCP port."""
        faults = set(self.options.faults) - NOT_OVER_TCP
        units = [self.unit(number, faults, timeout) for number in numbers]
        host = Host(self.network, url, units, 0.95 if "drop" in faults else 1.0)
        self.hosts.append(host)
        return host.url

    def calm(self) -> None:
        """End all faults."""
        self.is_calm = True
        for unit in self.units:
            unit.behave()
        for host in self.hosts:
            host.accepts = 1.0

    # --- asking -----------------------------------------------------------------------------------

    def call(self, unit: int, limit: float, *, age: float = 0.0, is_direct: bool = True) -> Call:
        """Make a request that no other one equals; one of four writes."""
        self._number += 1
        high, low = divmod(self._number, 0x10000)
        kind = self.random.choice([3, 3, 3, 6])
        if kind == 3:
            pdu = bytes([3]) + low.to_bytes(2, "big") + bytes([0, COUNT])
        else:
            pdu = bytes([6, high >> 8, high & 0xFF]) + low.to_bytes(2, "big")
        now = self.events.now
        call = Call((unit, pdu), now, now + limit + ROUNDING, age, is_direct)
        if not is_direct:
            self.witness.through_gateway.add(call.key)
        self.witness.begin(call)
        return call

    async def ask(self, plc: AsyncClient, call: Call) -> None:
        """Ask, and tell the witness what became of it."""
        unit, pdu = call.key
        values = None
        try:
            async with asyncio.timeout(self._patience()):
                if pdu[0] == 3:
                    address = int.from_bytes(pdu[1:3], "big")
                    handle = plc.for_unit(unit)
                    values = await handle.read_holding_registers(address, COUNT)
                else:
                    address, value = (int.from_bytes(pdu[at : at + 2], "big") for at in (1, 3))
                    await plc.for_unit(unit).write_register(address, value)
        except (ModbusError, TimeoutError) as error:
            self.witness.error(call, error)
        else:
            self.witness.answer(call, values)

    def _patience(self) -> float | None:
        """Seconds until whoever asks gives up himself; None for never."""
        if self.is_calm or "cancel" not in self.options.faults or self.random.random() > 0.05:
            return None
        return self.random.uniform(0, 0.5)

    def ask_blocking(self, context: Context, call: Call) -> None:
        """Ask with a blocking client."""
        unit, pdu = call.key
        values = None
        try:
            if pdu[0] == 3:
                address = int.from_bytes(pdu[1:3], "big")
                values = context.for_unit(unit).read_holding_registers(address, COUNT)
            else:
                address, value = (int.from_bytes(pdu[at : at + 2], "big") for at in (1, 3))
                context.for_unit(unit).write_register(address, value)
        except ModbusError as error:
            self.witness.error(call, error)
        else:
            self.witness.answer(call, values)

    def pause(self) -> float:
        return self.random.expovariate(1 / self.options.pause)


Ask = Callable[[int], Awaitable[None]]
"""Asks a unit once."""


async def _act(world: World, ask: Ask, numbers: range, until: float) -> None:
    """Ask one unit after the other until a time."""
    while world.events.now < until:
        await asyncio.sleep(world.pause())
        await ask(world.random.choice(numbers))


async def _play(world: World, asks: list[Ask], numbers: range) -> None:
    """Have all ask while things go wrong, and each ask all when nothing does any more."""
    witness = world.witness
    until = world.events.now + world.options.seconds
    await asyncio.gather(*(_act(world, ask, numbers, until) for ask in asks))
    world.calm()
    await asyncio.sleep(SETTLING)
    failed = witness.failed
    for ask in asks:
        for number in numbers:
            await ask(number)
            witness.late()
            if witness.failed > failed:
                witness.fail("everybody is served when the faults are over", f"unit {number}")
                witness.look()


# --- casts ----------------------------------------------------------------------------------------


async def _direct(world: World, url: str, numbers: range, timeout: float, most: int) -> None:
    """Clients that ask units themselves, all over one connection where there can be only one."""
    retries = world.random.choice([0, 0, 2])
    one = timeout * (1 + retries)
    is_line = not url.startswith("tcp")
    tasks = world.options.clients
    count = 1 if is_line else most
    # Waiting for others' requests does not count: for their ends before a new connection is made.
    limit = (3 * one + 2 * timeout) * tasks if is_line else (one if count == tasks else 2 * one)
    async with _clients(url, count, timeout=timeout, retries=retries) as plcs:
        asks = [partial(_ask, world, plcs[number % len(plcs)], limit) for number in range(tasks)]
        await _play(world, asks, numbers)


async def _ask(world: World, plc: AsyncClient, limit: float, unit: int, **how: Any) -> None:
    await world.ask(plc, world.call(unit, limit, **how))


@asynccontextmanager
async def _clients(url: str, count: int, **options: Any) -> AsyncIterator[list[AsyncClient]]:
    plcs = [AsyncClient(url, **options) for _ in range(count)]
    try:
        yield plcs
    finally:
        for plc in plcs:
            await plc.close()


async def _on_tcp(world: World) -> None:
    """Clients and a device over Modbus/TCP."""
    numbers, timeout = _units(world), world.random.choice([0.2, 1.0])
    url = world.host("tcp://10.0.0.1", numbers, timeout)
    await _direct(world, url, numbers, timeout, world.random.randint(1, world.options.clients))


async def _on_line(world: World) -> None:
    """Clients and units on a serial line."""
    numbers, timeout = _units(world), world.random.choice([0.3, 1.0])
    baudrate = world.random.choice([9600, 19_200, 115_200])
    world.bus("/dev/line", numbers, timeout, baudrate)
    await _direct(world, f"rtu:///dev/line?baudrate={baudrate}", numbers, timeout, 1)


async def _on_rtu_over_tcp(world: World) -> None:
    """Clients and units whose frames have no transaction ids, over TCP."""
    numbers, timeout = _units(world), world.random.choice([0.3, 1.0])
    url = world.host("rtu+tcp://10.0.0.1", numbers, timeout)
    await _direct(world, url, numbers, timeout, 1)


def _units(world: World) -> range:
    return range(1, 1 + world.options.units)


async def _through_gateway(world: World) -> None:
    """Clients, a gateway, a line, and a device over Modbus/TCP."""
    random, numbers = world.random, range(1, 1 + max(2, world.options.units))
    half = len(numbers) // 2 + 1
    timeout = random.choice([0.3, 0.5])
    world.bus("/dev/line", range(1, half), timeout, 19_200)
    behind = world.host("tcp://10.0.0.1", range(half, numbers.stop), timeout)
    options = f"timeout={timeout}"
    routes = [
        Route(f"rtu:///dev/line?baudrate=19200&{options}", range(1, half), merge=_chance(random)),
        Route(f"{behind}?{options}", range(half, numbers.stop), cache=random.choice([0.0, 0.1])),
    ]
    gateway = Gateway(
        routes, queue=random.choice([1, 16]), longest_wait=5.0, writes_first=_chance(random)
    )
    patience = random.choice([0.5, 3.0])
    async with (
        gateway.serving("tcp://10.0.1.1"),
        _clients("tcp://10.0.1.1", world.options.clients, timeout=patience) as plcs,
    ):
        how = {"age": 0.1, "is_direct": False}
        asks = [partial(_ask, world, plc, patience, **how) for plc in plcs]
        try:
            await _play(world, asks, numbers)
        finally:
            _look_at_gateway(world, gateway)


def _chance(random: random.Random) -> bool:
    return random.random() < 0.5


def _look_at_gateway(world: World, gateway: Gateway) -> None:
    """Nothing waits in a gateway whose clients have all been told."""
    if not world.is_calm:
        return
    for line in gateway.passed.lines.values():
        if line.waiting or line.in_flight:
            text = f"{line.waiting} wait, {line.in_flight} are in flight"
            world.witness.fail("nothing is left waiting", text)


def _blocking(world: World) -> None:
    """A blocking client that asks units over TCP, with ids or without, or on a line."""
    numbers, timeout = _units(world), world.random.choice([0.3, 1.0])
    kind = world.random.choice(["tcp", "rtu+tcp", "rtu"])
    if kind == "rtu":
        world.bus("/dev/line", numbers, timeout, 19_200)
        url = "rtu:///dev/line?baudrate=19200"
    else:
        url = world.host(f"{kind}://10.0.0.1", numbers, timeout)
    retries = world.random.choice([0, 2])
    limit = (timeout if kind == "tcp" else 5 * timeout) * (1 + retries)
    witness, until = world.witness, world.events.now + world.options.seconds
    with Context.from_url(url, native=False, timeout=timeout, retries=retries) as context:
        sleep = world.network.waker().sleep
        while world.events.now < until:
            sleep(world.pause())
            world.ask_blocking(context, world.call(world.random.choice(numbers), limit))
        world.calm()
        sleep(SETTLING)
        failed = witness.failed
        for number in numbers:
            world.ask_blocking(context, world.call(number, limit))
        if witness.failed > failed:
            witness.fail("everybody is served when the faults are over", str(numbers))


CASTS: dict[str, Callable[[World], Any]] = {
    "tcp": _on_tcp,
    "line": _on_line,
    "rtu+tcp": _on_rtu_over_tcp,
    "gateway": _through_gateway,
    "blocking": _blocking,
}


def play(options: Options, tap: Callable[..., object] | None = None) -> World:
    """
    Run a cast to its end.

    Raises:
        Broken: a rule does not hold.
        AssertionError: tasks were left, or nothing happened any more.
    """
    world = World(options)
    world.events.looks.append(world.witness.look)
    wire = Wire(world)
    world.network.tap = wire.tell if tap is None else partial(_both, wire.tell, tap)
    made = CASTS[options.cast]
    state = random.getstate()
    random.seed(options.seed)  # of the pauses before reconnecting
    try:
        if asyncio.iscoroutinefunction(made):
            world.network.run(partial(made, world))
        else:
            with world.network.installed(), suppress_unconnected():
                made(world)
    finally:
        random.setstate(state)
    world.witness.look()
    return world


def _both(one: Callable[..., object], other: Callable[..., object], *args: Any) -> None:
    other(*args)
    one(*args)


def suppress_unconnected() -> Any:
    """A blocking client that connects when it is entered may be refused: then it is not asked."""
    return suppress(ModbusError)


class Wire:
    """Reads what is sent, and tells the witness: requests to units, and refusals by gateways."""

    def __init__(self, world: World) -> None:
        self._witness = world.witness
        self._asked: dict[tuple[int, bytes], tuple[int, bytes]] = {}

    def tell(self, place: str, connection: int, is_client: bool, data: bytes) -> None:
        """See `Network.tap`."""
        has_header = place.startswith("tcp:")
        for head, unit, pdu in _frames(data, has_header, is_client):
            if place.startswith("tcp://10.0.1."):  # a gateway's own clients
                self._note_at_gateway(connection, head, unit, pdu, is_client)
            elif is_client:
                self._witness.sent(unit, pdu)

    def _note_at_gateway(
        self, connection: int, head: bytes, unit: int, pdu: bytes, is_client: bool
    ) -> None:
        if is_client:
            self._asked[connection, head] = unit, pdu
            return
        key = self._asked.pop((connection, head), None)
        if key is not None and pdu[0] & 0x80 and pdu[1] in (6, 11):
            self._witness.refused(*key)


def _frames(data: bytes, has_header: bool, is_client: bool) -> list[tuple[bytes, int, bytes]]:
    """Cut what was sent together; only requests of a line are looked at."""
    if not has_header:
        size = 8 if is_client else len(data)
        return [(b"", data[at], data[at + 1 : at + size - 2]) for at in range(0, len(data), size)]
    found = []
    while len(data) >= 8:
        size = 6 + int.from_bytes(data[4:6], "big")
        found.append((data[:2], data[6], data[7:size]))
        data = data[size:]
    return found


def shortened(options: Options, **changes: Any) -> Options:
    """Return a smaller run."""
    return replace(options, **changes)
