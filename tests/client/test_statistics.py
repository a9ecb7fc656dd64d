"""What a connection counts: what became of each request, and how long answers took."""

import asyncio
import os
import signal
from contextlib import suppress
from unittest.mock import patch

import pytest

from libmodbus_py import AsyncClient, Client, ModbusError, pdu
from libmodbus_py.client.statistics import RESULTS, TIME_BOUNDS, Statistics
from tests.simulation import network
from tests.simulation.scripted import Scripted
from tests.simulation.sockets import DELAY
from tests.support.clients import Connect, World, asking
from tests.support.in_loops import run_client
from tests.support.peers import FakeServer, TcpPeer, answering, echo, mbap

REQUEST = pdu.ReadHoldingRegisters(5, 1)
WRITE = pdu.WriteRegister(5, 7)


def refused(request: bytes) -> list[bytes]:
    return [mbap(request, bytes([request[7] | 0x80, 2]))]


def good(request: bytes) -> list[bytes]:
    return [echo(request)] if request[7] == 3 else [request]


def silent(request: bytes) -> list[bytes]:
    return []


def short(request: bytes) -> list[bytes]:
    return [mbap(request, b"\x03\x04\0\1")]


def check(statistics: Statistics) -> None:
    """Check the counters, which must agree when nothing is in flight."""
    assert {result for _, result in statistics.results} <= set(RESULTS)
    results = statistics.results.items()
    requests = sum(count for (_, result), count in results if result != "unsent")
    answers = sum(count for (_, result), count in results if result in ("ok", "exception"))
    assert requests == statistics.requests
    assert answers == statistics.responses == sum(statistics.answer_times)
    refusals = sum(count for (_, result), count in results if result == "exception")
    assert refusals == statistics.exceptions


def test_each_sent_request_has_a_result(world: World) -> None:
    peer = world.peer("tcp", answering(good, good, refused, good, silent, short, None, good))
    with world.connect(peer.url, timeout=60) as plc:
        for request in (REQUEST, WRITE, REQUEST, REQUEST, REQUEST, WRITE, REQUEST, REQUEST):
            with suppress(ModbusError):
                plc.execute(request)
        assert plc.statistics.results == {
            (3, "ok"): 4,
            (6, "ok"): 1,
            (3, "exception"): 1,
            (3, "timeout"): 1,
            (6, "invalid"): 1,
            (3, "lost"): 1,
        }
        check(plc.statistics)


def test_repetitions_have_results_of_their_own(world: World) -> None:
    with world.client_of("tcp", answering(silent, good), timeout=0.2, retries=3) as plc:
        plc.execute_many([REQUEST])
        assert plc.statistics.results == {(3, "timeout"): 1, (3, "ok"): 1}
        check(plc.statistics)


def test_requests_of_cancelled_callers_are_counted_as_cancelled(world: World) -> None:
    """The first failure ends a batch; the answers to the others come, and are dropped."""
    with world.client_of("tcp", answering(refused, good), timeout=1, max_in_flight=4) as plc:
        with pytest.raises(ModbusError):
            plc.execute_many([REQUEST] * 8)
        results = dict(plc.statistics.results)
        assert results.pop((3, "exception")) == 1
        assert set(results) <= {(3, "cancelled"), (3, "ok")}
        check(plc.statistics)


def test_unsent_requests_are_counted_apart(world: World) -> None:
    plc = world.connect("tcp://10.0.0.9", timeout=0.2)
    for _ in range(2):
        with pytest.raises(ModbusError):
            plc.execute(REQUEST)
    plc.execute_many([REQUEST, WRITE], return_exceptions=True)
    assert plc.statistics.results == {(3, "unsent"): 3, (6, "unsent"): 1}
    assert plc.statistics.requests == 0
    plc.close()
    check(plc.statistics)


def test_a_cancelled_request_is_counted() -> None:
    async def use(plc: AsyncClient, _: Scripted) -> None:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "cancelled"): 1}
        await plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "cancelled"): 1, (3, "ok"): 1}
        check(plc.statistics)

    run_client(answering(silent, good), use, timeout=5)


def test_an_interrupted_request_is_counted() -> None:
    def interrupt(request: bytes) -> list[bytes]:
        os.kill(os.getpid(), signal.SIGINT)
        return []

    with (
        TcpPeer(answering(interrupt, good)) as server,
        asking("blocking", server.url, timeout=60) as plc,
    ):
        with pytest.raises(KeyboardInterrupt):
            plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "cancelled"): 1}
        plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "cancelled"): 1, (3, "ok"): 1}
        check(plc.statistics)


def test_a_broadcast_is_silent(world: World) -> None:
    unit = world.peer("rtu", answering(silent))
    with world.connect(unit.url, unit=0, turnaround=0.01) as plc:
        plc.write_register(5, 7)
        assert plc.statistics.results == {(6, "silent"): 1}
        check(plc.statistics)


@pytest.mark.parametrize("seconds", [0.0009, 0.06, 0.3, 9.9])
def test_answer_times_are_those_that_passed(world: World, seconds: float) -> None:
    """From sending to the answer: no more, no less."""
    peer = world.peer("tcp", lambda request, write: write(echo(request), after=seconds - 2 * DELAY))
    with world.connect(peer.url, timeout=50) as plc:
        for _ in range(3):
            plc.execute(REQUEST)
        statistics = plc.statistics
        assert statistics.answer_seconds == pytest.approx(3 * seconds)
        at = next(at for at, bound in enumerate(TIME_BOUNDS) if seconds <= bound)
        assert statistics.answer_times[at] == 3
        assert sum(statistics.answer_times) == 3
        check(statistics)


def test_the_time_of_connecting_is_not_counted_as_an_answer_time(world: World) -> None:
    """A request that waits for the connection has not been sent."""
    peer = world.peer("tcp", answering(good))
    plc = world.connect(peer.url, timeout=20)
    with patch.object(network, "CONNECTING", 5.0), world.lasting(5.0):
        plc.execute(REQUEST)
    assert plc.statistics.answer_seconds == pytest.approx(2 * DELAY)
    plc.close()


def test_all_results_are_explained() -> None:
    for result in RESULTS:
        assert f'"{result}"' in (Statistics.__doc__ or "")


def test_bounds_of_times_are_those_of_the_documentation() -> None:
    """Dashboards have them: 100 us to 10 s, each about twice the one before."""
    milliseconds = [0.1, 0.25, 0.5, 1, 2.5, 5, 10, 25, 50, 100, 250, 500, 1000, 2500, 5000, 10_000]
    assert [bound * 1000 for bound in TIME_BOUNDS] == pytest.approx(milliseconds)


@pytest.mark.parametrize(
    ("seconds", "place"), [(0.0001, 0), (0.00011, 1), (0.1, 9), (10.0, 15), (10.1, 16)]
)
def test_an_answer_is_counted_up_to_its_bound(seconds: float, place: int) -> None:
    statistics = Statistics()
    statistics.note_answer(3, seconds, 0.0)
    statistics.note_answer(3, seconds, 0.0, "exception")
    assert [at for at, count in enumerate(statistics.answer_times) if count] == [place]
    assert statistics.answer_times[place] == statistics.responses == 2
    assert statistics.answer_seconds == 2 * seconds
    assert statistics.results == {(3, "ok"): 1, (3, "exception"): 1}


def test_clients_of_one_endpoint_that_follow_each_other_count_together(connect: Connect) -> None:
    totals = Statistics()
    with FakeServer(lambda request: [echo(request)]) as server:
        for _ in range(3):
            with connect(server.url, statistics=totals) as plc:
                assert plc.read_holding_registers(7, 1) == [7]
                assert plc.statistics is totals
    assert (totals.connects, totals.requests, totals.responses) == (3, 3, 3)


def test_statistics_of_another_type_are_refused() -> None:
    with pytest.raises(TypeError, match="statistics must be Statistics, not dict"):
        Client("tcp://127.0.0.1", statistics={})  # type: ignore[typeddict-item]
