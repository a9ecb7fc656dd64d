"""
AsyncClient over its life: timeouts, cancellation, connections that come and go.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import warnings
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
    pdu,
)
from libmodbus_py.client.asynchronous import AsyncClient
from libmodbus_py.client.reconnecting import State
from libmodbus_py.testing.wires import SerialWire
from tests.support.fake import FakeUnit, refusing, url_of
from tests.support.scripted import Scripted, Write, answer, echo, ignore, run

REQUEST = pdu.ReadHoldingRegisters(5, 1)


def after(seconds: float) -> Callable[[bytes, Write], None]:
    """Answer late."""

    def on_request(request: bytes, write: Write) -> None:
        asyncio.get_running_loop().call_later(seconds, write, answer(request))

    return on_request


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(5):
        while not condition():
            await asyncio.sleep(0.001)


# --- timeouts -----------------------------------------------------------------------------


def test_timeout_can_be_changed_while_somebody_waits() -> None:
    async def main() -> None:
        async with Scripted(ignore).serving() as server, AsyncClient(server.url, timeout=9) as plc:
            waiting = asyncio.create_task(plc.execute(REQUEST))
            await until(lambda: server.requests)
            plc.timeout = 0.05
            with pytest.raises(ModbusTimeoutError):
                await waiting
            assert plc.timeout == 0.05

    run(main())


# --- cancellation ---------------------------------------------------------------------------


def test_cancelled_while_it_waits_for_its_answer() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.2)).serving() as server,
            AsyncClient(server.url, max_in_flight=2) as plc,
        ):
            for _ in range(3):
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(0.02):
                        await plc.read_holding_registers(1, 1)
                with pytest.raises(TimeoutError):
                    await asyncio.wait_for(plc.execute_many([REQUEST] * 9), 0.02)
                assert await plc.read_holding_registers(2, 1) == [2]
            assert plc.late_answers == 9
            assert (server.connections, plc.statistics.timeouts) == (1, 0)
            assert len(server.requests) == 12

    run(main())


def test_cancelled_while_it_waits_for_a_slot() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.05)).serving() as server,
            AsyncClient(server.url, max_in_flight=1) as plc,
        ):
            first = asyncio.create_task(plc.read_holding_registers(1, 1))
            second = asyncio.create_task(plc.read_holding_registers(2, 1))
            third = asyncio.create_task(plc.read_holding_registers(3, 1))
            await until(lambda: server.requests)
            second.cancel()
            assert [await first, await third] == [[1], [3]]
            assert second.cancelled()
            assert [request[9] for request in server.requests] == [1, 3]

    run(main())


def test_cancelled_while_it_waits_for_the_connection() -> None:
    async def main() -> None:
        async with (
            Scripted(echo).serving() as server,
            contextlib.aclosing(Closing(AsyncClient(server.url))) as closing,
        ):
            plc = closing.client
            waiting = [asyncio.create_task(plc.execute(REQUEST)) for _ in range(3)]
            joining = asyncio.create_task(plc.connect())
            await asyncio.sleep(0)
            assert plc.state is State.CONNECTING
            waiting[0].cancel()
            waiting[2].cancel()
            joining.cancel()
            assert await waiting[1] == [5]
            await asyncio.sleep(0.02)
            assert len(server.requests) == 1

    run(main())


class Closing:
    """Close a client at the end of a block without having connected it at its begin."""

    def __init__(self, client: AsyncClient) -> None:
        self.client = client

    async def aclose(self) -> None:
        await self.client.close()


@pytest.mark.parametrize("options", [{"request_spacing": 0.2}, {"connect_delay": 0.2}])
def test_cancelled_while_it_must_not_start_yet(options: dict[str, float]) -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server, AsyncClient(server.url, **options) as plc:  # type: ignore[arg-type]
            if "request_spacing" in options:
                await plc.read_holding_registers(0, 1)
            waiting = asyncio.create_task(plc.read_holding_registers(1, 1))
            await asyncio.sleep(0.02)
            waiting.cancel()
            assert await plc.read_holding_registers(2, 1) == [2]
            assert 1 not in [request[9] for request in server.requests]

    run(main())


def test_cancelled_at_any_moment_leaves_a_client_that_works() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.002)).serving() as server,
            AsyncClient(server.url, max_in_flight=3) as plc,
        ):
            for turn in range(60):
                tasks = [asyncio.create_task(plc.read_holding_registers(n, 1)) for n in range(6)]
                for _ in range(turn % 12):
                    await asyncio.sleep(0)
                tasks[turn % 6].cancel()
                results = await asyncio.gather(*tasks, return_exceptions=True)
                for number, result in enumerate(results):
                    is_cancelled = isinstance(result, asyncio.CancelledError)
                    assert result == [number] or (number == turn % 6 and is_cancelled)
            assert server.connections == 1

    run(main())


# --- the end -------------------------------------------------------------------------------------


def test_close_while_connecting() -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server:
            for turns in range(6):
                plc = AsyncClient(server.url)
                waiting = asyncio.create_task(plc.execute(REQUEST))
                for _ in range(turns):
                    await asyncio.sleep(0)
                await plc.close()
                with contextlib.suppress(ModbusConnectionError):
                    await waiting

    run(main())


def test_another_event_loop_is_refused_in_words() -> None:
    plc = AsyncClient("tcp://no-such-host.invalid")

    async def use() -> None:
        with contextlib.suppress(ModbusConnectionError):
            await plc.execute(REQUEST)

    run(use())
    for ask in (plc.connect, plc.close, lambda: plc.execute(REQUEST)):

        async def main(ask: Callable[[], Any] = ask) -> None:
            with pytest.raises(RuntimeError, match="another event loop"):
                await ask()

        run(main())
    with pytest.raises(RuntimeError, match="no running event loop"):
        plc.connect().send(None)


def test_no_descriptor_is_left_behind() -> None:
    async def use(url: str) -> None:
        async with AsyncClient(url) as plc:
            await plc.read_coils(0, 1)

    async def fail(plc: AsyncClient) -> None:
        with contextlib.suppress(ModbusError):
            await plc.connect()
        await plc.close()

    async def main() -> None:
        device = Device(Mapping(coils=8))
        with SerialWire() as wire, refusing() as port:
            async with Server(device).serving(
                "tcp://127.0.0.1:0", "udp://127.0.0.1:0", f"rtu://{wire.server}"
            ) as running:
                urls = [*running.urls[:2], f"rtu://{wire.client}"]
                bad = (url_of(port), "rtu:///dev/null", "udp://[::1%9]")
                before = 0
                for turn in range(200):
                    await use(urls[0])
                    if turn % 20 == 0:
                        for url in urls:
                            await use(url)
                        for url in bad:
                            await fail(AsyncClient(url, timeout=0.2))
                    if turn == 20:
                        await asyncio.sleep(0.02)
                        before = len(os.listdir("/proc/self/fd"))
                await asyncio.sleep(0.02)
                assert len(os.listdir("/proc/self/fd")) <= before

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(main())
        gc.collect()


def test_the_loop_goes_on_while_a_line_is_turned_round() -> None:
    """RTS is set 50 ms before the first bit and as long after the last."""
    answer = bytes.fromhex("01 03 02 0007 F986")

    async def main() -> None:
        turns = 0

        async def count() -> None:
            nonlocal turns
            while True:
                await asyncio.sleep(0.001)
                turns += 1

        with FakeUnit(lambda request: [answer]) as unit:
            url = f"rtu://{unit.path}?baudrate=115200&rs485=rts-up&rts_delay=0.05"
            async with AsyncClient(url) as plc:
                counting = asyncio.create_task(count())
                for _ in range(2):
                    assert await plc.read_holding_registers(0, 1) == [7]
                counting.cancel()
        assert turns > 20

    run(main())


def test_nobody_is_connected_for_who_has_left() -> None:
    async def main() -> None:
        with refusing() as port:
            plc = AsyncClient(url_of(port), timeout=1)
            with pytest.raises(ModbusConnectionError):
                await plc.connect()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.02):
                    await plc.execute(REQUEST)
            await asyncio.sleep(0.15)  # longer than the pause
            assert plc.statistics.failed_connects == 1
            await plc.close()

    run(main())
