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
    Server,
    pdu,
)
from libmodbus_py.client.asynchronous import AsyncClient
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.peers import FakeUnit, refusing, url_of
from tests.support.scripted import run

REQUEST = pdu.ReadHoldingRegisters(5, 1)


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
