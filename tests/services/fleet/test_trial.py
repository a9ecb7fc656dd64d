"""The checks before a fleet runs: of each device, and of lines that cannot carry polls."""

import asyncio

import pytest

from libmodbus_py import Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.maps.point_plan import PointPlan
from libmodbus_py.services.fleet.trial import TrialPoll, overloads, trial_polls
from tests.services.fleet.fleets import Peer, good, in_simulated_time, meter, silent
from tests.support.cases import each_case


async def trials(*devices: object) -> dict[str, TrialPoll]:
    return {item.device.name: item async for item in trial_polls(devices)}  # type: ignore[arg-type]


@in_simulated_time
async def test_the_time_of_each_poll_is_reported() -> None:
    async def slow(request: bytes) -> bytes:
        await asyncio.sleep(2 if request[6] == 1 else 3)
        return await good(request)

    async with Peer(slow) as peer:
        first, second = (
            meter(name, peer.url, unit=unit, timeout=9) for unit, name in ((1, "a"), (2, "b"))
        )
        results = await trials(first, second)
    assert results["a"].seconds == pytest.approx(2, abs=0.01)
    assert results["b"].seconds == pytest.approx(3, abs=0.01)
    assert {result.problem for result in results.values()} == {""}


@in_simulated_time
async def test_a_device_has_one_request_at_a_time() -> None:
    requests: set[bytes] = set()
    most = 0

    async def slow(request: bytes) -> bytes:
        nonlocal most
        requests.add(request)
        most = max(most, len(requests))
        await asyncio.sleep(0.1)
        requests.remove(request)
        return await good(request)

    points = [Point(f"p{place}", "holding_registers", place) for place in (0, 500, 1000)]
    async with Peer(slow) as peer:
        results = await trials(meter("a", peer.url, map=RegisterMap(points)))
    assert (results["a"].requests, results["a"].problem, most) == (3, "", 1)


@in_simulated_time
async def test_the_first_of_several_invalid_values_is_named() -> None:
    points = [Point(f"p{number}", "holding_registers", number, type="bcd16") for number in range(3)]
    # A quiet NaN of IEEE 754.
    ratio = Point("ratio", "holding_registers", 3, type="float32")
    device = Device(Mapping(holding_registers={0: [0x1234, 0x0A00, 0x00B0, 0x7FC0, 0]}))

    async with Server({1: device}).serving("tcp://127.0.0.1:0") as running:
        url = running.urls[0]
        results = await trials(
            meter("both", url, map=RegisterMap(points)),
            meter("last", url, map=RegisterMap(points[::2])),
            meter("none", url, map=RegisterMap(points[:1])),
            meter("not a number", url, map=RegisterMap([ratio])),
        )
    wrong = "has no value: {} has digits other than 0..9"
    count = "points without a good value: 2 of 3"
    assert results["both"].problem == f"p1 {wrong.format('0A00')}; {count}"
    assert results["last"].problem == f"p2 {wrong.format('00B0')}"
    assert results["not a number"].problem == "ratio has no value: the device says nan"
    assert results["none"].problem == ""


@in_simulated_time
async def test_a_trial_closed_after_its_first_result_leaves_no_task() -> None:
    async with (
        Server({1: Device(Mapping(holding_registers=3))}).serving("tcp://127.0.0.1:0") as good,
        Peer(silent) as peer,
    ):
        trial = trial_polls([meter("good", good.urls[0]), meter("dead", peer.url, timeout=60)])
        first = await anext(trial)
        assert first.device.name == "good"
        start = asyncio.get_running_loop().time()
        await trial.aclose()
        assert asyncio.get_running_loop().time() == start
        assert peer.requests
        assert not [task for task in asyncio.all_tasks() if "_try_line" in repr(task)]


@in_simulated_time
async def test_an_internal_error_ends_the_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unexpected exception is raised while other lines are still tried."""

    def broken(*_: object, **__: object) -> object:
        raise RuntimeError("a defect")

    monkeypatch.setattr(PointPlan, "results", broken)
    async with Peer() as peer, Peer(silent) as dead:
        devices = meter("a", peer.url), meter("b", dead.url, timeout=60)
        with pytest.raises(RuntimeError, match="a defect"):
            await trials(*devices)


@in_simulated_time
async def test_devices_that_do_not_answer_are_reported_with_the_reason() -> None:
    async with Peer() as peer, Peer(silent) as dead:
        results = await trials(
            meter("good", peer.url),
            meter("dead", f"{dead.url}?timeout=0.1"),
            meter("dead too", f"{dead.url}?timeout=0.1", unit=2),
            meter("gone", "tcp://127.0.0.1:1"),
        )
    assert (results["good"].problem, results["good"].requests) == ("", 1)
    assert "no answer within 0.1 s" in results["dead"].problem
    assert "refused" in results["gone"].problem
    assert len(results) == 4


# Of RTU: a frame of 8 bytes, one of 5 + 6, and 7 characters of silence, 11 bits each. Of ASCII:
# 2 * (unit, PDU, LRC) + 3, which are 17 and 2 * 10 + 3 characters of 10 bits.
RTU, ASCII = "rtu:///dev/x?baudrate=9600&parity=E", "ascii:///dev/x?baudrate=9600&parity=E"
ASCII_S = (17 + 2 * 10 + 3) * 10 / 9600


@each_case(
    ("url", "intervals", "message"),
    [
        (RTU, [0.05], ""),
        (RTU, [0.02], "line rtu:///dev/x at 9600: 0.0298 s of requests each 0.02 s"),
        (ASCII, [ASCII_S + 1e-9], ""),
        (ASCII, [0.04], "line ascii:///dev/x at 9600: 0.0417 s of requests each 0.04 s"),
        ("tcp://127.0.0.1", [0.01], ""),
        # All devices of a line count, each at its interval.
        (RTU, [0.1, 0.2], ""),
        (RTU, [0.1, *[0.2] * 7], "line rtu:///dev/x at 9600: 0.134 s of requests each 0.1 s"),
    ],
)
def test_lines_that_are_too_slow_for_their_intervals_are_reported(url, intervals, message) -> None:
    devices = [
        meter(f"{unit}", url, unit=unit, interval=item) for unit, item in enumerate(intervals, 1)
    ]
    assert overloads(devices) == ([message] if message else [])


def test_only_points_that_are_due_count_as_load_of_a_line() -> None:
    url = "rtu:///dev/ttyUSB0?baudrate=9600"
    for own, count in ((60, 0), (None, 1)):
        points = [Point(f"p{at}", "holding_registers", 2 * at, interval=own) for at in range(50)]
        assert len(overloads([meter("a", url, map=RegisterMap(points), interval=1)])) == count
