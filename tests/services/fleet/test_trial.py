"""
The checks before a fleet runs: what is told of each device, and of lines that cannot carry polls.
"""

from __future__ import annotations

import asyncio

import pytest

from libmodbus_py import Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.maps.point_plan import PointPlan
from libmodbus_py.services.fleet.trial import Tried, overloads, trying
from tests.services.fleet.fleets import Peer, good, meter, simulated_run


async def tried(*devices: object) -> dict[str, Tried]:
    return {each.device.name: each async for each in trying(devices)}  # type: ignore[arg-type]


def test_the_time_of_each_poll_is_told() -> None:
    async def slow(request: bytes) -> bytes:
        await asyncio.sleep(2 if request[6] == 1 else 3)
        return await good(request)

    async def go() -> None:
        async with Peer(slow) as peer:
            first, second = (
                meter(name, peer.url, unit=unit, timeout=9) for unit, name in ((1, "a"), (2, "b"))
            )
            found = await tried(first, second)
        assert found["a"].seconds == pytest.approx(2, abs=0.01)
        assert found["b"].seconds == pytest.approx(3, abs=0.01)
        assert {each.problem for each in found.values()} == {""}

    simulated_run(go())


def test_a_device_has_one_request_at_a_time() -> None:
    asked: set[bytes] = set()
    most = 0

    async def slow(request: bytes) -> bytes:
        nonlocal most
        asked.add(request)
        most = max(most, len(asked))
        await asyncio.sleep(0.1)
        asked.remove(request)
        return await good(request)

    async def go() -> None:
        points = [Point(f"p{place}", "holding_registers", place) for place in (0, 500, 1000)]
        async with Peer(slow) as peer:
            found = await tried(meter("a", peer.url, map=RegisterMap(points)))
        assert (found["a"].requests, found["a"].problem, most) == (3, "", 1)

    simulated_run(go())


def test_the_first_of_the_values_that_cannot_be_is_told() -> None:
    points = [Point(f"p{number}", "holding_registers", number, type="bcd16") for number in range(3)]
    device = Device(Mapping(holding_registers={0: [0x1234, 0x0A00, 0x00B0]}))

    async def go() -> None:
        async with Server({1: device}).serving("tcp://127.0.0.1:0") as running:
            url = running.urls[0]
            found = await tried(
                meter("both", url, map=RegisterMap(points)),
                meter("last", url, map=RegisterMap(points[::2])),
                meter("none", url, map=RegisterMap(points[:1])),
            )
        wrong = "registers[0:1] hold no bcd16: {} has digits other than 0..9"
        assert found["both"].problem == f"p1: {wrong.format('0A00')}"
        assert found["last"].problem == f"p2: {wrong.format('00B0')}"
        assert found["none"].problem == ""

    simulated_run(go())


def test_who_looks_at_the_first_result_only_leaves_nothing_behind() -> None:
    async def silent(request: bytes) -> None:
        return None

    async def go() -> None:
        async with (
            Server({1: Device(Mapping(holding_registers=3))}).serving("tcp://127.0.0.1:0") as good,
            Peer(silent) as peer,
        ):
            trial = trying([meter("good", good.urls[0]), meter("dead", peer.url, timeout=60)])
            first = await anext(trial)
            assert first.device.name == "good"
            begun = asyncio.get_running_loop().time()
            await trial.aclose()
            assert asyncio.get_running_loop().time() == begun
            assert peer.requests
            assert not [task for task in asyncio.all_tasks() if "_try_line" in repr(task)]

    simulated_run(go())


def test_a_defect_ends_the_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unexpected exception is raised while other lines are still tried."""

    def broken(*_: object, **__: object) -> object:
        raise RuntimeError("a defect")

    async def silent(request: bytes) -> None:
        return None

    async def go() -> None:
        async with Peer() as peer, Peer(silent) as dead:
            devices = meter("a", peer.url), meter("b", dead.url, timeout=60)
            with pytest.raises(RuntimeError, match="a defect"):
                await tried(*devices)

    monkeypatch.setattr(PointPlan, "results", broken)
    simulated_run(go())


def test_a_line_may_be_busy_all_the_time() -> None:
    """The shortest interval that a line can keep is that of its requests and responses."""
    url = "ascii:///dev/x?baudrate=9600&parity=E"
    needed = (17 + 2 * 10 + 3) * 10 / 9600
    assert overloads([meter("a", url, interval=needed + 1e-9)]) == []
    assert overloads([meter("a", url, interval=needed * 0.999)]) != []
