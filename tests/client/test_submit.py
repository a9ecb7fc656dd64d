"""
Requests that are submitted: told of once, whatever happens, and never waited for.
"""

import asyncio

import pytest

from libmodbus_py import (
    AsyncClient,
    IllegalDataAddress,
    ModbusConnectionError,
    ModbusTimeoutError,
    pdu,
)
from libmodbus_py.client.sender import Sender
from tests.simulation.scripted import Scripted
from tests.support.in_loops import run_client, run_peer
from tests.support.peers import Write, answering, echo, ignore, mbap

READ = pdu.ReadHoldingRegisters(7, 1)


def test_many_are_told_of_once_each() -> None:
    def up_to_nine(request: bytes, write: Write) -> None:
        write(echo(request) if request[9] < 10 else mbap(request, b"\x83\x02"))

    async def use(client: AsyncClient, _: Scripted) -> None:
        told: list[int] = []
        made = [
            Sender(client).submit(
                1, pdu.ReadHoldingRegisters(at % 12, 1), lambda at=at: told.append(at)
            )
            for at in range(100)
        ]
        await asyncio.sleep(5)
        assert sorted(told) == list(range(100))
        for at, each in enumerate(made):
            if at % 12 < 10:
                assert each.outcome == [at % 12]
            else:
                assert isinstance(each.outcome, IllegalDataAddress)

    run_client(up_to_nine, use)


def test_one_that_is_withdrawn_is_not_told_of_and_its_answer_dropped() -> None:
    async def use(client: AsyncClient, _: Scripted) -> None:
        told: list[str] = []
        first = Sender(client).submit(1, READ, lambda: told.append("first"))
        await asyncio.sleep(0.05)
        first.withdraw()
        first.withdraw()
        second = Sender(client).submit(1, READ, lambda: told.append("second"))
        await asyncio.sleep(1)
        assert told == ["second"]
        assert second.outcome == [7]
        second.withdraw()  # too late, and no harm
        assert client.statistics.late_answers == 1

    def late(request: bytes) -> list[bytes]:
        held.append(echo(request))
        return []

    held: list[bytes] = []
    run_client(answering(late, lambda request: [*held, echo(request)]), use, timeout=5)


@pytest.mark.parametrize("kind", ["nobody", "silence", "closed"])
def test_failures_are_told_of_too(kind: str) -> None:
    async def main(peer: Scripted) -> None:
        client = AsyncClient("tcp://10.0.0.9" if kind == "nobody" else peer.url, timeout=0.2)
        if kind == "closed":
            await client.close()
        done = asyncio.Event()
        submitted = Sender(client).submit(1, READ, done.set)
        await asyncio.wait_for(done.wait(), 5)
        expected = ModbusTimeoutError if kind == "silence" else ModbusConnectionError
        assert isinstance(submitted.outcome, expected)
        await client.close()

    run_peer(ignore, main)


def test_what_cannot_be_sent_is_refused_at_once() -> None:
    async def use() -> None:
        client = AsyncClient("rtu:///dev/nowhere")
        with pytest.raises(TypeError):
            Sender(client).submit(1, b"\3", lambda: None)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="broadcast"):
            Sender(client).submit(0, READ, lambda: None)
        await client.close()

    asyncio.run(use())
