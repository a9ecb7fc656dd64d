"""Callers that are cancelled, at any step of the loop, while they wait. Others are not affected."""

import asyncio
import contextlib
import random
from typing import Any

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError, ModbusError, State, TracedFrame, pdu
from libmodbus_py.client.call import Call
from tests.simulation.scripted import Scripted
from tests.support.cases import each_case
from tests.support.driver import LINE, TCP, Driver
from tests.support.in_loops import run_client, run_peer
from tests.support.peers import TcpPeer, Write, echo
from tests.support.reads import on_read, on_read_at
from tests.support.replies import answer

REQUEST = pdu.ReadHoldingRegisters(5, 1)


def test_cancelled_requests_take_no_answer_of_later_ones() -> None:
    async def use(plc: AsyncClient, peer: Scripted) -> None:
        for _ in range(3):
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.02):
                    await plc.read_holding_registers(1, 1)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(plc.execute_many([REQUEST] * 9), 0.02)
            assert await plc.read_holding_registers(2, 1) == [2]
        assert plc.statistics.late_answers == 9
        assert (peer.connections, plc.statistics.timeouts) == (1, 0)
        assert len(peer.requests) == 12

    run_client(on_read_at("tcp", after=0.2), use, max_in_flight=2)


def test_cancelled_callers_do_not_end_the_connecting_of_others() -> None:
    async def main(peer: Scripted) -> None:
        plc = AsyncClient(peer.url)
        tasks = [asyncio.create_task(plc.execute(REQUEST)) for _ in range(3)]
        joining = asyncio.create_task(plc.connect())
        await asyncio.sleep(0)
        assert plc.state is State.CONNECTING
        tasks[0].cancel()
        tasks[2].cancel()
        joining.cancel()
        assert await tasks[1] == [5]
        await asyncio.sleep(60)
        assert len(peer.requests) == 1
        await plc.close()

    run_peer(on_read, main)


def test_an_answer_read_in_the_same_turn_as_a_cancellation_goes_to_no_other_request() -> None:
    async def main(peer: Scripted) -> None:
        def note(frame: TracedFrame) -> None:
            if frame.direction == "received" and not reading.done():
                reading.cancel("no longer needed")

        async with AsyncClient(peer.url, trace=note) as plc:
            reading = asyncio.create_task(plc.read_holding_registers(1, 1))
            with pytest.raises(asyncio.CancelledError, match="no longer needed"):
                await reading
            assert await plc.read_holding_registers(2, 1) == [2]
            assert (plc.statistics.responses, plc.statistics.late_answers) == (2, 0)

    run_peer(on_read, main)


@pytest.mark.parametrize("options", [{"request_spacing": 0.2}, {"connect_delay": 0.2}])
def test_a_request_cancelled_during_a_pause_is_not_sent(options: dict[str, Any]) -> None:
    async def main(peer: Scripted) -> None:
        before = peer.network.events.now
        async with AsyncClient(peer.url, **options) as plc:
            if "request_spacing" in options:
                await plc.read_holding_registers(0, 1)
            task = asyncio.create_task(plc.read_holding_registers(1, 1))
            await asyncio.sleep(0.02)
            task.cancel()
            assert await plc.read_holding_registers(2, 1) == [2]
            assert peer.network.events.now == pytest.approx(before + 0.2, abs=0.002)
            assert 1 not in [request[9] for request in peer.requests]

    run_peer(on_read, main)


@each_case("url", [LINE, TCP])
@each_case("order", ["as given", "reverse", "random"])
def test_thousands_of_waiting_requests_cost_few_comparisons_each(url, order, monkeypatch) -> None:
    """Comparisons of requests are counted: removed one by one from a list, millions."""
    driver, compared = Driver(url, max_in_flight=1), 0

    def equal(one: object, other: object) -> bool:
        nonlocal compared
        compared += 1
        return one is other

    present = driver.ask(1)
    batches = [driver.batch(2) for _ in range(3000)]
    for batch in batches:
        driver.connection.submit(batch, 0.0)
    if order == "reverse":
        batches.reverse()
    elif order == "random":
        random.Random(1).shuffle(batches)
    last = batches.pop(1500)
    monkeypatch.setattr(Call, "__eq__", equal)
    monkeypatch.setattr(Call, "__hash__", object.__hash__)
    for batch in batches:
        driver.connection.withdraw(batch, 0.0)
    assert compared < 30_000
    assert len(driver.connection.queue.waiting) <= 2
    driver.come(answer(driver))
    driver.come(answer(driver))
    assert (present.outcomes, last.outcomes) == ([[1]], [[2]])
    assert driver.is_at_rest


def test_a_cancelled_batch_leaves_other_requests_their_answers() -> None:
    """Whatever the request waits for: the connection, its slot or its answer."""

    async def main(peer: Scripted) -> None:
        for is_kept in (True, False):
            for steps in range(12):
                async with AsyncClient(peer.url, max_in_flight=2, timeout=2) as client:
                    if not is_kept:
                        peer.drop_all()
                    others = [
                        asyncio.create_task(client.read_holding_registers(address, 1))
                        for address in range(3)
                    ]
                    batch = asyncio.create_task(
                        client.execute_many(
                            [pdu.ReadHoldingRegisters(address, 1) for address in range(256)]
                        )
                    )
                    last = asyncio.create_task(client.read_holding_registers(9, 1))
                    for _ in range(steps):
                        await asyncio.sleep(0)
                    batch.cancel()
                    outcomes = await asyncio.gather(*others, last, return_exceptions=True)
                    if is_kept:
                        assert outcomes == [[0], [1], [2], [9]]
                    with contextlib.suppress(asyncio.CancelledError, ModbusConnectionError):
                        assert len(await batch) == 256
                    assert await client.read_holding_registers(5, 1) == [5]

    run_peer(on_read, main)


@pytest.mark.parametrize("seed", range(10))
def test_tasks_cancelled_at_random_leave_others_their_answers(seed: int) -> None:
    chance = random.Random(seed)

    def slowly(request: bytes, write: Write) -> None:
        write(echo(request), after=chance.choice([0, 0, 0.001, 0.01, 0.05]))

    async def one(client: AsyncClient) -> None:
        for _ in range(20):
            address = chance.randrange(1000)
            with contextlib.suppress(TimeoutError, ModbusError):
                async with asyncio.timeout(chance.choice([0, 0.0005, 0.005, 0.03, 1])):
                    values = await client.read_holding_registers(address, 1)
                    assert values == [address]

    async def use(client: AsyncClient, peer: Scripted) -> None:
        await asyncio.gather(*(one(client) for _ in range(10)))
        client.timeout = 1
        assert await client.read_holding_registers(77, 1) == [77]

    run_client(slowly, use, timeout=0.04)


def test_a_client_connects_again_after_a_cancelled_attempt() -> None:
    """The caller, or all tasks of the package: the client can connect again."""

    async def main(peer: Scripted) -> None:
        for steps in range(8):
            for everybody in (False, True):
                client = AsyncClient(peer.url, timeout=1)
                connecting = asyncio.create_task(client.read_holding_registers(5, 1))
                for _ in range(steps):
                    await asyncio.sleep(0)
                for task in asyncio.all_tasks() if everybody else ():
                    if "libmodbus_py" in task.get_coro().cr_code.co_filename:  # type: ignore[union-attr]
                        task.cancel()
                connecting.cancel()
                await asyncio.wait([connecting])
                assert await client.read_holding_registers(6, 1) == [6]
                await client.close()

    run_peer(on_read, main)


@pytest.mark.parametrize("hook", ["on_state", "trace"])
@pytest.mark.parametrize("at", range(4))
def test_a_callback_that_raises_a_cancellation_leaves_a_working_client(at: int, hook: str) -> None:
    calls = iter(range(1000))

    def fail(*_: object) -> None:
        if next(calls) == at:
            raise asyncio.CancelledError

    async def main(peer: TcpPeer) -> None:
        options: dict[str, Any] = {hook: fail}
        client = AsyncClient(peer.url, timeout=0.2, **options)
        for address in range(4):
            with contextlib.suppress(ModbusError, asyncio.CancelledError):
                assert await client.read_holding_registers(address, 1) == [address]
        for address in range(3):
            assert await client.read_holding_registers(address, 1) == [address]
        with contextlib.suppress(asyncio.CancelledError):
            await client.close()

    # On the real system, for the loop may log what the hook raises.
    with TcpPeer(on_read) as peer:
        asyncio.run(main(peer))


def test_a_client_can_be_closed_while_it_connects() -> None:
    async def main(peer: Scripted) -> None:
        for turns in range(6):
            plc = AsyncClient(peer.url)
            task = asyncio.create_task(plc.execute(REQUEST))
            for _ in range(turns):
                await asyncio.sleep(0)
            await plc.close()
            with contextlib.suppress(ModbusConnectionError):
                await task

    run_peer(on_read, main)
