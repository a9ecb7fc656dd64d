"""
Whether anything goes out is asked right before it does.
"""

from __future__ import annotations

import asyncio
import errno
import time
from typing import Any

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError, TcpContext
from tests.support.peers import FakeServer

ANSWER = bytes.fromhex("0000 0005 01 03 02 0007")


def answer(request: bytes) -> list[bytes]:
    return [request[:2] + ANSWER]


def slow(request: bytes) -> list[bytes]:
    time.sleep(0.1)
    return answer(request)


class Gate:
    def __init__(self, is_open: bool = True) -> None:
        self.is_open = is_open

    def __call__(self) -> bool:
        return self.is_open


def ask(plc: AsyncClient) -> Any:
    return plc.read_holding_registers(0, 1)


def refused(outcome: object) -> bool:
    return isinstance(outcome, ModbusConnectionError) and outcome.errno == errno.EPERM


def test_nothing_connects_or_is_sent_until_it_may() -> None:
    async def go() -> None:
        gate = Gate(is_open=False)
        plc = AsyncClient(server.url, may_send=gate)
        try:
            with pytest.raises(ModbusConnectionError, match="may_send") as caught:
                await ask(plc)
            assert refused(caught.value)
            assert server.connections == 0
            gate.is_open = True
            assert await ask(plc) == [7]
            gate.is_open = False
            with pytest.raises(ModbusConnectionError, match="may_send"):
                await ask(plc)
        finally:
            await plc.close()

    with FakeServer(answer) as server:
        asyncio.run(go())
        assert len(server.requests) == 1


@pytest.mark.parametrize("options", [{"max_in_flight": 1}, {"connect_delay": 0.1}])
def test_those_that_wait_are_not_sent_once_it_is_over(options: Any) -> None:
    """They wait for a slot, or for the delay after connecting: asked at their start it was yes."""

    async def go() -> list[Any]:
        gate = Gate()
        plc = AsyncClient(server.url, may_send=gate, **options)
        try:
            if "max_in_flight" in options:
                await plc.connect()
            asking = [asyncio.create_task(ask(plc)) for _ in range(3)]
            await asyncio.sleep(0.03)
            gate.is_open = False
            return await asyncio.gather(*asking, return_exceptions=True)
        finally:
            await plc.close()

    with FakeServer(slow) as server:
        outcomes = asyncio.run(go())
        sent = len(server.requests)
    assert sent == (1 if "max_in_flight" in options else 0)
    assert sum(map(refused, outcomes)) == 3 - sent


def test_one_that_fails_means_no(caplog: pytest.LogCaptureFixture) -> None:
    async def go() -> None:
        plc = AsyncClient(server.url, may_send=lambda: 1 / 0 > 0)
        with pytest.raises(ModbusConnectionError, match="may_send"):
            await ask(plc)
        await plc.close()

    with FakeServer(answer) as server:
        asyncio.run(go())
        assert server.connections == 0
    assert "may_send failed" in caplog.text


def test_it_is_for_asyncio_alone() -> None:
    with pytest.raises(TypeError, match="may_send"):
        TcpContext("127.0.0.1", may_send=Gate())  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="may_send must be a function"):
        AsyncClient("tcp://127.0.0.1", may_send=1)  # type: ignore[typeddict-item]
