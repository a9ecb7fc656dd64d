"""
Requests that are submitted: told of once, whatever happens, and never waited for.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Device,
    IllegalDataAddress,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Server,
    pdu,
)
from tests.support.peers import FakeServer, dead, mbap

READ = pdu.ReadHoldingRegisters(0, 2)


def run(url: str, use: Callable[[AsyncClient], Any], **options: Any) -> Any:
    async def go() -> Any:
        async with AsyncClient(url, **options) as client:
            return await use(client)

    return asyncio.run(go())


def test_many_are_told_of_once_each() -> None:
    async def use(client: AsyncClient) -> list[Any]:
        told: list[int] = []
        done = asyncio.Event()

        def tell(number: int) -> None:
            told.append(number)
            if len(told) == 100:
                done.set()

        made = [
            client.submit(1, pdu.ReadHoldingRegisters(at % 12, 1), lambda at=at: tell(at))
            for at in range(100)
        ]
        await done.wait()
        await asyncio.sleep(0.01)
        assert sorted(told) == list(range(100))
        return [each.outcome for each in made]

    device = Device(Mapping(0, 0, 10, 0))
    device.mapping.holding_registers[:] = range(10)
    with Server({1: device}).background("tcp://127.0.0.1:0") as running:
        found = run(running.urls[0], use)
    for at, outcome in enumerate(found):
        if at % 12 < 10:
            assert outcome == [at % 12]
        else:
            assert isinstance(outcome, IllegalDataAddress)


def test_one_that_is_withdrawn_is_not_told_of_and_its_answer_dropped() -> None:
    answers = [lambda request: [], lambda request: [mbap(request, b"\3\4\0\1\0\2")]]

    async def use(client: AsyncClient) -> None:
        told: list[str] = []
        first = client.submit(1, READ, lambda: told.append("first"))
        await asyncio.sleep(0.05)
        first.withdraw()
        first.withdraw()
        second = client.submit(1, READ, lambda: told.append("second"))
        while not told:
            await asyncio.sleep(0.001)
        assert told == ["second"]
        assert second.outcome == [1, 2]
        second.withdraw()  # too late, and no harm

    with FakeServer(*answers) as server:
        run(server.url, use, timeout=5)


@pytest.mark.parametrize("kind", ["nobody", "silence", "closed"])
def test_failures_are_told_of_too(kind: str) -> None:
    async def use(url: str) -> Any:
        client = AsyncClient(url, timeout=0.2)
        try:
            if kind == "closed":
                await client.close()
            done = asyncio.Event()
            submitted = client.submit(1, READ, done.set)
            await asyncio.wait_for(done.wait(), 5)
            return submitted.outcome
        finally:
            await client.close()

    if kind == "silence":
        with socket.create_server(("127.0.0.1", 0)) as mute:
            outcome = asyncio.run(use(f"tcp://127.0.0.1:{mute.getsockname()[1]}"))
        assert isinstance(outcome, ModbusTimeoutError)
        return
    with dead() as port:
        outcome = asyncio.run(use(f"tcp://127.0.0.1:{port}"))
    assert isinstance(outcome, ModbusConnectionError)


def test_what_cannot_be_sent_is_refused_at_once() -> None:
    async def use() -> None:
        client = AsyncClient("rtu:///dev/nowhere")
        with pytest.raises(TypeError):
            client.submit(1, b"\3", lambda: None)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="broadcast"):
            client.submit(0, READ, lambda: None)
        await client.close()

    asyncio.run(use())
