"""
`watch` of both clients: exact times without drift, failures in place of values, and its ends.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    IllegalDataAddress,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Plan,
    Point,
    RegisterMap,
    Server,
)
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.cases import each_case
from tests.support.peers import Write, mbap

METER = RegisterMap([Point("a", "holding_registers", 0), Point("b", "holding_registers", 9)])

KINDS = pytest.mark.parametrize("kind", ["blocking", "asyncio"])


class Wall:
    """A simulated device, and a client that watches it."""

    def __init__(self, kind: str, network: Network, loop: asyncio.AbstractEventLoop) -> None:
        self.kind = kind
        self.network = network
        self.loop = loop
        self.refused: set[int] = set()
        self.is_silent = False
        self.takes = 0.0
        self.device = Scripted(network, "tcp://10.0.0.1", self.answer)

    def answer(self, request: bytes, write: Write) -> None:
        if self.is_silent:
            return
        if request[9] in self.refused:
            write(mbap(request, b"\x83\x02"))
        else:
            answer = mbap(request, b"\x03\x02\x00\x07")
            self.network.events.after(self.takes, write, answer)

    def watch(
        self, most: int, *, during: Any = None, what: Any = METER, **options: Any
    ) -> list[Any]:
        """Return the first values, each with the time at which it came."""
        if self.kind == "asyncio":
            return self.loop.run_until_complete(self._await(most, during, what, options))
        found = []
        with Client(self.device.url, native=False, timeout=0.5) as plc:
            for values in plc.watch(what, **options):
                found.append((self.now, values))
                if during is not None:
                    during(plc)
                if len(found) == most:
                    break
        return found

    async def _await(self, most: int, during: Any, what: Any, options: Any) -> list[Any]:
        found = []
        async with AsyncClient(self.device.url, timeout=0.5, max_pause=0) as plc:
            async for values in plc.watch(what, **options):
                found.append((self.now, values))
                if during is not None and (doing := during(plc)) is not None:
                    await doing
                if len(found) == most:
                    break
        return found

    @property
    def now(self) -> float:
        return self.network.events.now

    def spend(self, seconds: float) -> None:
        until = self.now + seconds
        while self.now < until:
            self.network.events.advance(until)


@pytest.fixture(params=["blocking", "asyncio"])
def wall(request: pytest.FixtureRequest) -> Iterator[Wall]:
    network = Network()
    loop = network.loop()
    with network.installed():
        yield Wall(request.param, network, loop)
    assert not asyncio.all_tasks(loop)
    loop.close()


def times(found: list[Any]) -> list[float]:
    """Return the times after the first one."""
    return [round(at - found[0][0], 2) for at, _ in found]


def test_times_are_exact_and_do_not_drift(wall: Wall) -> None:
    wall.takes = 0.03
    found = wall.watch(51, every=0.7)
    assert [values for _, values in found] == [{"a": 7, "b": 7}] * 51
    # The first poll also connects, and finds out whether the device takes two requests at once.
    assert times(found[1:]) == [round(0.7 * number, 2) for number in range(50)]


def test_polls_that_are_late_are_left_out(wall: Wall) -> None:
    pauses = iter([0.0, 2.5, 0.2, 0.9, 0.0])
    found = wall.watch(5, every=1, during=lambda _: wall.spend(next(pauses)))
    assert times(found) == [0, 1, 4, 5, 6]


def test_a_device_that_is_away_gives_reasons(wall: Wall) -> None:
    def during(_: Any) -> None:
        wall.is_silent = not wall.is_silent

    found = [values for _, values in wall.watch(4, every=1, during=during)]
    assert found[0] == found[2] == {"a": 7, "b": 7}
    for away in (found[1], found[3]):
        assert [*away] == ["a", "b"]
        assert all(isinstance(each, ModbusTimeoutError) for each in away.values())


def test_a_connection_that_is_lost_is_made_again(wall: Wall) -> None:
    found = [
        values for _, values in wall.watch(3, every=1, during=lambda _: wall.device.drop_all())
    ]
    assert found[0] == {"a": 7, "b": 7}
    assert wall.device.connections > 1
    assert all(
        isinstance(each, ModbusConnectionError | int)
        for values in found
        for each in values.values()
    )


def test_a_point_that_is_refused_leaves_the_others(wall: Wall) -> None:
    wall.refused = {9}
    for _, values in wall.watch(2, every=1):
        assert values["a"] == 7
        assert isinstance(values["b"], IllegalDataAddress)


@each_case(
    ("what", "options", "values"),
    [
        (METER, {"names": ["b"]}, {"b": 7}),
        (METER.plan(["a"]), {}, {"a": 7}),
        (Plan([("holding_registers", 3)]), {}, [[7]]),
        ({"x": ("holding_registers", 3)}, {}, {"x": [7]}),
        ([("holding_registers", 3, 1, "int16")], {"max_in_flight": 1}, [[7]]),
    ],
)
def test_what_can_be_watched(wall: Wall, what: Any, options: Any, values: Any) -> None:
    assert [found for _, found in wall.watch(2, every=1, what=what, **options)] == [values] * 2


@each_case(
    ("what", "options", "error", "message"),
    [
        (METER, {"every": 0}, ValueError, "every must be in 0.01..86400 seconds"),
        (METER, {"every": "1"}, TypeError, "every must be a number"),
        (METER, {"every": 1, "names": ["c"]}, ValueError, "no point 'c'"),
        (METER, {"every": 1, "max_in_flight": 0}, ValueError, "max_in_flight must be"),
        ([("coilz", 1)], {"every": 1}, ValueError, "did you mean coils"),
        ([("coils", 1)], {"every": 1, "names": ["x"]}, ValueError, "names are for a RegisterMap"),
        (METER.plan(), {"every": 1, "gap": 3}, ValueError, "gap must be given to the plan"),
    ],
)
def test_arguments_are_checked_at_once(what: Any, options: Any, error: Any, message: str) -> None:
    for plc in (Client("127.0.0.1:1"), AsyncClient("127.0.0.1:1")):
        watching: Any = plc.watch
        with pytest.raises(error, match=message):
            watching(what, **options)
        if isinstance(plc, Client):
            plc.close()


def test_it_ends_when_the_client_is_closed(wall: Wall) -> None:
    found = wall.watch(9, every=1, during=lambda plc: plc.close())
    assert len(found) == 1
    assert wall.watch(9, every=1, during=None)[0][1] == {"a": 7, "b": 7}


def test_close_ends_a_wait_in_an_event_loop() -> None:
    network = Network()
    loop = network.loop()
    with network.installed():
        wall = Wall("asyncio", network, loop)

        async def ended() -> float:
            plc = AsyncClient(wall.device.url)
            watching = plc.watch(METER, every=100)
            await anext(watching)
            loop.call_later(5, lambda: tasks.append(loop.create_task(plc.close())))
            with pytest.raises(StopAsyncIteration):
                await anext(watching)
            await tasks[0]
            return loop.time()

        tasks: list[asyncio.Task[None]] = []
        begun = loop.time()
        assert loop.run_until_complete(ended()) - begun == pytest.approx(5, abs=0.1)
    loop.close()


def test_a_wait_that_is_cancelled_can_begin_again() -> None:
    network = Network()
    loop = network.loop()
    with network.installed():
        wall = Wall("asyncio", network, loop)

        async def again() -> list[float]:
            async with AsyncClient(wall.device.url) as plc:
                watching = plc.watch(METER, every=10)
                begun = loop.time()
                await anext(watching)
                with pytest.raises(TimeoutError):
                    await asyncio.wait_for(anext(watching), 4)
                await anext(watching)
                first = loop.time() - begun
                task = loop.create_task(anext(watching))
                await asyncio.sleep(1)
                task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
                await anext(watching)
                return [first, loop.time() - begun]

        assert loop.run_until_complete(again()) == pytest.approx([10, 20], abs=0.1)
        assert not asyncio.all_tasks(loop)
    loop.close()


@pytest.fixture
def url() -> Iterator[str]:
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_another_thread_ends_the_wait(url: str) -> None:
    with Client(url) as plc:
        watching = plc.watch(METER, every=86_400)
        assert next(watching) == {"a": 0, "b": 0}
        closing = threading.Thread(target=plc.close)
        found: list[Any] = []
        waiting = threading.Thread(target=lambda: found.extend(watching))
        waiting.start()
        closing.start()
        waiting.join()
        closing.join()
        assert found == []


def test_other_requests_go_on_meanwhile(url: str) -> None:
    with Client(url) as plc:
        watching = plc.watch(METER, every=86_400)
        next(watching)
        waiting = threading.Thread(target=lambda: list(watching))
        waiting.start()
        plc.write_register(0, 5)
        assert plc.read_holding_registers(0, 1) == [5]
        plc.close()
        waiting.join()


def test_a_signal_handler_may_close_and_ctrl_c_leaves(url: str) -> None:
    with Client(url) as plc:
        watching = plc.watch(METER, every=86_400)
        next(watching)
        before = signal.signal(signal.SIGALRM, lambda *_: plc.close())
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            assert list(watching) == []
        finally:
            signal.signal(signal.SIGALRM, before)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with Client(url) as plc:
        watching = plc.watch(METER, every=86_400)
        next(watching)
        before = signal.signal(signal.SIGALRM, interrupt)
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            with pytest.raises(KeyboardInterrupt):
                next(watching)
        finally:
            signal.signal(signal.SIGALRM, before)
        assert plc.read_holding_registers(0, 1) == [0]


def test_a_loop_that_is_left_leaves_nothing(wall: Wall) -> None:
    wall.watch(1, every=1)
    gc.collect()
    assert not asyncio.all_tasks(wall.loop)
