"""Devices that refuse registers, and plans that read them again, without sockets and clocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from libmodbus_py.errors import IllegalDataAddress, ModbusError
from libmodbus_py.maps.plan import Plan, unreadable_of
from libmodbus_py.maps.refusals import Refusals, carried_out, reading

H = "holding_registers"


class Registers:
    """
    A device whose registers hold their own addresses.

    It refuses requests for `missing` addresses, or for more than `most`; `then` may give another
    answer. `asked` has the first address and the count of each request.
    """

    def __init__(
        self,
        missing: Iterable[int] = (),
        most: int = 125,
        refusal: type[ModbusError] = IllegalDataAddress,
        then: Callable[[Registers, Any], Any] = lambda device, answer: answer,
    ) -> None:
        self.missing = set(missing)
        self.most = most
        self.refusal = refusal
        self.then = then
        self.asked: list[tuple[int, int]] = []

    def __call__(self, request: Any) -> Any:
        self.asked.append((request.address, request.count))
        cells = range(request.address, request.address + request.count)
        if request.count > self.most or not self.missing.isdisjoint(cells):
            return self.then(self, self.refusal())
        return self.then(self, list(cells))


def leaving(after: int, error: ModbusError) -> Callable[[Registers, Any], Any]:
    """Return a device that fails after so many requests."""
    return lambda device, answer: answer if len(device.asked) <= after else error


class Polls:
    """Reads one plan of one device again and again, as one client does."""

    def __init__(self, plan: Plan, device: Any) -> None:
        self.plan = plan
        self.device = device
        self.refusals = Refusals()
        self.news: list[str] = []
        self.connects = 1

    def ask(self, requests: list[Any]) -> list[Any]:
        return [self.device(request) for request in requests]

    def ask_strictly(self, requests: list[Any]) -> list[Any]:
        """Ask up to the first failure, as clients do; there are no outcomes behind it."""
        outcomes = [None] * len(requests)
        for at, request in enumerate(requests):
            outcomes[at] = self.device(request)
            if isinstance(outcomes[at], ModbusError):
                break
        return outcomes

    def steps(self, now: float = 0.0, *, is_strict: bool = False) -> Any:
        tell = self.news.append
        blocks, connects = self.plan.blocks, self.connects
        return reading(blocks, self.refusals, now, connects, is_strict=is_strict, tell=tell)

    def answers(self, now: float = 0.0, *, is_strict: bool = False) -> tuple[int, list[Any]]:
        """Read the plan; return the number of requests, and the answers."""
        before = len(self.device.asked)
        ask = self.ask_strictly if is_strict else self.ask
        answers = carried_out(self.steps(now, is_strict=is_strict), ask)
        return len(self.device.asked) - before, answers

    def strictly(self) -> tuple[int, list[Any]]:
        return self.answers(is_strict=True)

    def poll(self, now: float = 0.0) -> tuple[int, Any]:
        """Read the plan; return the number of requests, and the values."""
        count, answers = self.answers(now)
        return count, self.plan.results(answers)

    def requests(self, count: int) -> list[int]:
        """Return the requests of so many polls, a second apart."""
        return [self.poll(now)[0] for now in range(count)]

    @property
    def unreadable(self) -> list[Any]:
        return [name.name for name in unreadable_of(self.plan, self.refusals, "device")]


def singles(count: int) -> Plan:
    return Plan([("holding_registers", address) for address in range(count)])


def lost(values: Iterable[Any]) -> list[int]:
    return [at for at, value in enumerate(values) if isinstance(value, ModbusError)]
