"""`watch` of both clients: exact times without drift, failures in place of values, and its ends."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterator
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
from tests.simulation.scripted import Scripted
from tests.support.cases import each_case
from tests.support.clients import World
from tests.support.in_loops import run_client
from tests.support.peers import Write, mbap
from tests.support.reads import on_read
from tests.support.signals import interrupt, on_alarm

METER = RegisterMap([Point("a", "holding_registers", 0), Point("b", "holding_registers", 9)])


TOTALS = RegisterMap(
    [
        Point("v", "holding_registers", 0),
        Point("energy", "holding_registers", 10, interval=3, never_falls=True),
        Point("sf", "holding_registers", 20, interval=3),
    ]
)


class Wall:
    """
    A simulated device, and clients that watch it. `registers`: what is answered at an address, one
    value after the other; the last one stays; `refused, silent`: addresses that get an exception,
    and no answer; `takes`: how long an answer takes, in seconds.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.registers: dict[int, list[int]] = {}
        self.refused: set[int] = set()
        self.silent: set[int] = set()
        self.takes = 0.0
        self.device = world.peer("tcp", self.answer)

    def answer(self, request: bytes, write: Write) -> None:
        address = request[9]
        if address in self.silent:
            return
        if address in self.refused:
            write(mbap(request, b"\x83\x02"))
            return
        values = self.registers.get(address, [7])
        value = values.pop(0) if len(values) > 1 else values[0]
        write(mbap(request, b"\x03\x02" + value.to_bytes(2, "big")), after=self.takes)

    def watch(
        self, most: int, *, during: Any = None, what: Any = METER, **options: Any
    ) -> list[Any]:
        """Return the first values, each with the time at which it came."""
        polls = []
        with self.world.connect(self.device.url, timeout=0.5, max_pause=0) as plc:
            for values in plc.watch(what, **options):
                polls.append((self.world.now, values))
                if during is not None:
                    during(plc)
                if len(polls) == most:
                    break
        return polls

    def times_of(self, address: int) -> list[int]:
        """Return when a register was asked, in whole seconds since the first request."""
        times = zip(self.device.requests, self.device.times, strict=True)
        return [round(at - self.device.times[0]) for adu, at in times if adu[9] == address]


@pytest.fixture
def wall(world: World) -> Wall:
    return Wall(world)


def times(polls: list[Any]) -> list[float]:
    """Return the times after the first one."""
    return [round(at - polls[0][0], 2) for at, _ in polls]


def values_of(polls: list[Any]) -> list[Any]:
    return [values for _, values in polls]


def test_times_are_exact_and_do_not_drift(wall: Wall) -> None:
    wall.takes = 0.03
    polls = wall.watch(51, every=0.7)
    assert values_of(polls) == [{"a": 7, "b": 7}] * 51
    # The first poll also connects, and finds out whether the device takes two requests at once.
    assert times(polls[1:]) == [round(0.7 * number, 2) for number in range(50)]


def test_polls_that_are_late_are_left_out(wall: Wall) -> None:
    pauses = iter([0.0, 2.5, 0.2, 0.9, 0.0])
    polls = wall.watch(5, every=1, during=lambda _: wall.world.compute(next(pauses)))
    assert times(polls) == [0, 1, 4, 5, 6]


def test_polls_of_a_silent_device_contain_the_reasons(wall: Wall) -> None:
    def during(_: Any) -> None:
        wall.silent = set() if wall.silent else {0, 9}

    polls = [values for _, values in wall.watch(4, every=1, during=during)]
    assert polls[0] == polls[2] == {"a": 7, "b": 7}
    for away in (polls[1], polls[3]):
        assert [*away] == ["a", "b"]
        assert all(isinstance(entry, ModbusTimeoutError) for entry in away.values())


def test_a_lost_connection_is_made_again_during_a_watch(wall: Wall) -> None:
    polls = [
        values for _, values in wall.watch(3, every=1, during=lambda _: wall.device.drop_all())
    ]
    assert polls[0] == {"a": 7, "b": 7}
    assert wall.device.connections > 1
    assert all(
        isinstance(value, ModbusConnectionError | int)
        for values in polls
        for value in values.values()
    )


def test_a_refused_point_leaves_the_values_of_the_others(wall: Wall) -> None:
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
        ([("holding_registers", 3, 1, "int16")], {}, [[7]]),
    ],
)
def test_maps_plans_and_items_are_watched(wall: Wall, what: Any, options: Any, values: Any) -> None:
    assert [result for _, result in wall.watch(2, every=1, what=what, **options)] == [values] * 2


@each_case(
    ("what", "options", "error", "message"),
    [
        (METER, {"every": 0}, ValueError, "every must be in 0.01..86400 seconds"),
        (METER, {"every": "1"}, TypeError, "every must be a number"),
        (METER, {"every": 1, "names": ["c"]}, ValueError, "no point 'c'"),
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


def test_a_watch_ends_when_the_client_is_closed(wall: Wall) -> None:
    polls = wall.watch(9, every=1, during=lambda plc: plc.close())
    assert len(polls) == 1
    assert wall.watch(9, every=1, during=None)[0][1] == {"a": 7, "b": 7}


def in_a_loop(use: Callable[[AsyncClient, Any], Awaitable[None]], every: float) -> None:
    """Run a test with a client and its watch, which has returned its first values."""

    async def begun(plc: AsyncClient, _: Scripted) -> None:
        watching = plc.watch(METER, every=every)
        await anext(watching)
        await use(plc, watching)

    run_client(on_read, begun)


def test_close_ends_a_wait_in_an_event_loop() -> None:
    async def use(plc: AsyncClient, watching: Any) -> None:
        async def close() -> None:
            await asyncio.sleep(5)
            await plc.close()

        loop = asyncio.get_running_loop()
        start, closing = loop.time(), loop.create_task(close())
        with pytest.raises(StopAsyncIteration):
            await anext(watching)
        await closing
        assert loop.time() - start == pytest.approx(5, abs=0.1)

    in_a_loop(use, every=100)


def test_a_wait_that_is_cancelled_can_begin_again() -> None:
    async def use(plc: AsyncClient, watching: Any) -> None:
        loop = asyncio.get_running_loop()
        start = loop.time()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(anext(watching), 4)
        await anext(watching)
        assert loop.time() - start == pytest.approx(10, abs=0.1)
        task = loop.create_task(anext(watching))
        await asyncio.sleep(1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await anext(watching)
        assert loop.time() - start == pytest.approx(20, abs=0.1)

    in_a_loop(use, every=10)


@pytest.fixture
def url() -> Iterator[str]:
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_other_requests_go_on_until_another_thread_ends_the_wait(url: str) -> None:
    polls: list[Any] = []
    with Client(url) as plc:
        watching = plc.watch(METER, every=86_400)
        assert next(watching) == {"a": 0, "b": 0}
        thread = threading.Thread(target=lambda: polls.extend(watching))
        thread.start()
        plc.write_register(0, 5)
        assert plc.read_holding_registers(0, 1) == [5]
        plc.close()
        thread.join()
    assert polls == []


def test_ctrl_c_ends_a_watch_and_a_signal_handler_may_close_it(url: str) -> None:
    with Client(url) as plc:
        watching = plc.watch(METER, every=86_400)
        next(watching)
        with on_alarm(interrupt, 0.05), pytest.raises(KeyboardInterrupt):
            next(watching)
        assert plc.read_holding_registers(0, 1) == [0]
        with on_alarm(plc.close, 0.05):
            assert list(watching) == []


def test_points_are_asked_at_their_intervals_and_keep_their_values(wall: Wall) -> None:
    polls = values_of(wall.watch(8, what=TOTALS, every=1))
    assert polls == [{"v": 7, "energy": 7, "sf": 7}] * 8
    assert wall.times_of(0) == [0, 1, 2, 3, 4, 5, 6, 7]
    assert wall.times_of(10) == wall.times_of(20) == [0, 3, 6]


def test_polls_come_at_the_shortest_interval(wall: Wall) -> None:
    wall.watch(4, what=TOTALS, every=6)
    assert wall.times_of(10) == [0, 3, 6, 9]
    assert wall.times_of(0) == [0, 6]


def test_a_total_is_marked_once_if_its_next_value_is_smaller_too(wall: Wall) -> None:
    wall.registers[10] = [100, 3, 4, 5]
    polls = values_of(wall.watch(7, what=TOTALS, every=1, names=["v", "energy"]))
    assert [values["energy"] for values in polls] == [100, 100, 100, 4, 4, 4, 5]
    assert [set(values.fell) for values in polls] == [*[set()] * 3, {"energy"}, *[set()] * 3]
