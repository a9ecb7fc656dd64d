"""
What a connection counts: what became of each request, and how long answers took.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Context, ModbusError, RtuContext, pdu
from libmodbus_py.client.statistics import RESULTS, TIME_BOUNDS, Statistics
from libmodbus_py.protocol.framing import crc16
from tests.support.clients import Connect
from tests.support.fake import FakeServer, FakeUnit, echo, mbap, refusing, url_of

REQUEST = pdu.ReadHoldingRegisters(5, 1)
WRITE = pdu.WriteRegister(5, 7)


def refused(request: bytes) -> list[bytes]:
    return [mbap(request, bytes([request[7] | 0x80, 2]))]


def good(request: bytes) -> list[bytes]:
    return [echo(request)] if request[7] == 3 else [request]


def late(seconds: float) -> Callable[[bytes], list[bytes]]:
    def answer(request: bytes) -> list[bytes]:
        time.sleep(seconds)
        return good(request)

    return answer


def silent(request: bytes) -> list[bytes]:
    return []


def short(request: bytes) -> list[bytes]:
    return [mbap(request, b"\x03\x04\0\1")]


def check(statistics: Statistics) -> None:
    """What must hold when nothing is in flight."""
    assert {result for _, result in statistics.results} <= set(RESULTS)
    results = statistics.results.items()
    sent = sum(count for (_, result), count in results if result != "unsent")
    answered = sum(count for (_, result), count in results if result in ("ok", "exception"))
    assert sent == statistics.requests
    assert answered == statistics.responses == sum(statistics.answer_times)
    refusals = sum(count for (_, result), count in results if result == "exception")
    assert refusals == statistics.exceptions


def test_each_request_has_one_result(connect: Connect) -> None:
    answers = [good, good, refused, good, silent, short, None, good]
    with FakeServer(*answers) as server, connect(server.url, timeout=0.3) as plc:
        for request in (REQUEST, WRITE, REQUEST, REQUEST, REQUEST, WRITE, REQUEST, REQUEST):
            with suppress(ModbusError):
                plc.execute(request)
        assert plc.statistics.results == {
            (3, "ok"): 3,
            (6, "ok"): 1,
            (3, "exception"): 1,
            (3, "timeout"): 1,
            (6, "invalid"): 1,
            (3, "lost"): 1,
        }
        check(plc.statistics)


def test_repetitions_have_results_of_their_own(connect: Connect) -> None:
    with FakeServer(silent, good) as server, connect(server.url, timeout=0.2, retries=3) as plc:
        plc.execute_many([REQUEST])
        assert plc.statistics.results == {(3, "timeout"): 1, (3, "ok"): 1}
        check(plc.statistics)


def test_what_nobody_waits_for_any_more_is_cancelled(connect: Connect) -> None:
    """The first failure ends a batch; the answers to the others come, and are dropped."""
    with FakeServer(refused, good) as server, connect(server.url, timeout=1) as plc:
        with pytest.raises(ModbusError):
            plc.execute_many([REQUEST] * 8, max_in_flight=4)
        results = dict(plc.statistics.results)
        assert results.pop((3, "exception")) == 1
        assert set(results) <= {(3, "cancelled"), (3, "ok")}
        check(plc.statistics)


def test_what_was_not_sent_is_told_from_the_rest(connect: Connect) -> None:
    with refusing() as bound:
        plc = connect(url_of(bound), timeout=0.2)
        for _ in range(2):
            with pytest.raises(ModbusError):
                plc.execute(REQUEST)
        plc.execute_many([REQUEST, WRITE], return_exceptions=True)
        assert plc.statistics.results == {(3, "unsent"): 3, (6, "unsent"): 1}
        assert plc.statistics.requests == 0
        plc.close()
        check(plc.statistics)


def test_a_cancelled_request_is_counted_so() -> None:
    async def cancel() -> Statistics:
        async with AsyncClient(server.url, timeout=5) as plc:
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await plc.execute(REQUEST)
            assert plc.statistics.results == {(3, "cancelled"): 1}
            await plc.execute(REQUEST)
            return plc.statistics

    with FakeServer(silent, good) as server:
        statistics = asyncio.run(cancel())
    assert statistics.results == {(3, "cancelled"): 1, (3, "ok"): 1}
    check(statistics)


@pytest.mark.parametrize("native", [True, False])
def test_an_interrupted_request_is_counted_so(native: bool) -> None:
    def interrupt(request: bytes) -> list[bytes]:
        os.kill(os.getpid(), signal.SIGINT)
        return []

    options: Any = {"timeout": 5, "native": native}
    with FakeServer(interrupt, good) as server, Context.from_url(server.url, **options) as plc:
        with pytest.raises(KeyboardInterrupt):
            plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "cancelled"): 1}
        plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "cancelled"): 1, (3, "ok"): 1}
        check(plc.statistics)


def test_a_broadcast_is_silent() -> None:
    with FakeUnit(silent) as unit, RtuContext(unit.path, unit=0, turnaround=0.01) as plc:
        plc.write_register(5, 7)
        assert plc.statistics.results == {(6, "silent"): 1}
        check(plc.statistics)


@pytest.mark.parametrize("native", [True, False])
def test_lines_count_as_networks_do(native: bool) -> None:
    def read(request: bytes) -> list[bytes]:
        frame = request[:2] + b"\x02\0\x07"
        return [frame + struct.pack("<H", crc16(frame))]

    answers = [read, read, read, silent]
    with FakeUnit(*answers) as unit, RtuContext(unit.path, timeout=0.3, native=native) as plc:
        for _ in range(3):
            assert plc.execute(REQUEST) == [7]
        with pytest.raises(ModbusError):
            plc.execute(REQUEST)
        assert plc.statistics.results == {(3, "ok"): 3, (3, "timeout"): 1}
        check(plc.statistics)


def test_answer_times_are_those_that_passed(connect: Connect) -> None:
    """From sending to the answer: within what the caller measured, and no less than the wait."""
    answers = [good, late(0.06), late(0.3), good]
    with FakeServer(*answers) as server, connect(server.url, timeout=5) as plc:
        start = time.monotonic()
        for _ in answers:
            plc.execute(REQUEST)
        passed = time.monotonic() - start
        statistics = plc.statistics
        assert 0.36 <= statistics.answer_seconds <= passed
        times = statistics.answer_times
        slower = {bound: sum(times[at + 1 :]) for at, bound in enumerate(TIME_BOUNDS)}
        assert slower[0.05] >= 2
        assert slower[0.25] >= 1
        assert slower[10.0] == 0
        check(statistics)


def test_connecting_is_no_time_of_an_answer() -> None:
    """A request that waits for the connection has not been sent."""

    async def ask(listener: socket.socket) -> None:
        plc = AsyncClient(url_of(listener), timeout=20)
        asked = asyncio.create_task(plc.execute(REQUEST))
        await asyncio.sleep(0.25)
        freed = time.monotonic()
        listener.accept()[0].close()
        listener.settimeout(20)
        peer, _ = await asyncio.to_thread(listener.accept)
        with peer:
            peer.settimeout(20)
            peer.sendall(echo(await asyncio.to_thread(peer.recv, 260)))
            assert await asked == [5]
        assert 0 < plc.statistics.answer_seconds <= time.monotonic() - freed
        await plc.close()

    with socket.socket() as listener, socket.socket() as filler:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)  # room for one: the next one is let in when it asks again
        filler.connect(listener.getsockname())
        asyncio.run(ask(listener))


def test_all_results_are_explained() -> None:
    for result in RESULTS:
        assert f'"{result}"' in (Statistics.__doc__ or "")
