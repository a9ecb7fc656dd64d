"""AsyncClient: the vocabulary over every transport, and many requests at once."""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from libmodbus_py import Device, IllegalDataAddress, Mapping, Server, pdu
from libmodbus_py.client.asynchronous import AsyncClient
from tests.simulation.scripted import Scripted
from tests.support.clients import Awaited, threadsafe
from tests.support.in_loops import run_client
from tests.support.interop import (
    TIMEOUT,
    UNIT,
    Exchange,
    c_serving,
    exchanges,
    make_device,
    refusals,
)
from tests.support.peers import Write, echo
from tests.support.pymodbus_peers import FRAMERS, pymodbus_serving
from tests.support.reads import echoes, reads
from tests.support.scripted import run
from tests.support.transports import serving


def test_wrong_arguments_are_raised_where_the_call_is_awaited() -> None:
    async def main() -> None:
        plc = AsyncClient("tcp://127.0.0.1:1")
        for asking in (plc.read_coils(-1, 1), plc.read_values("coils", 0, "int16")):  # type: ignore[arg-type]
            with pytest.raises(ValueError, match="must be"):
                await asking

    run(main())


def test_many_tasks_each_get_their_own_answer(transport: str, mapping: Mapping) -> None:
    async def main(url: str) -> None:
        async with AsyncClient(url, unit=17) as plc:
            addresses = [100 + number % 10 for number in range(60)]
            answers = await asyncio.gather(*(plc.read_holding_registers(a, 1) for a in addresses))
            assert answers == [[900 + address] for address in addresses]

    with serving(transport, Server(Device(mapping))) as url:
        run(main(url))


class Counting:
    """Answers in reverse order as soon as `batch` requests are there, or after a while."""

    def __init__(self, batch: int) -> None:
        self._batch = batch
        self._held: list[tuple[bytes, Write]] = []
        self._alarm: asyncio.TimerHandle | None = None
        self.most = 0

    def __call__(self, request: bytes, write: Write) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
        self._held.append((request, write))
        self.most = max(self.most, len(self._held))
        if len(self._held) >= self._batch:
            self._answer()
        else:
            self._alarm = asyncio.get_running_loop().call_later(0.005, self._answer)

    def _answer(self) -> None:
        while self._held:
            request, write = self._held.pop()
            write(echo(request))


@pytest.mark.parametrize("limit", [1, 2, 16])
def test_limit_of_the_client_is_used_and_honoured(limit: int) -> None:
    counting = Counting(limit)

    async def use(plc: AsyncClient, _: Scripted) -> None:
        single = [plc.read_holding_registers(address, 1) for address in range(40)]
        *answers, together = await asyncio.gather(*single, plc.execute_many(reads(60, 40)))
        assert [*answers, *together] == echoes(100)
        assert counting.most == limit

    run_client(counting, use, max_in_flight=limit)


def test_a_single_request_need_not_wait_for_a_long_batch() -> None:

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        batch = asyncio.create_task(plc.execute_many(reads(200)))
        while len(peer.requests) < 20:
            await asyncio.sleep(0.0001)
        assert await plc.read_holding_registers(999, 1) == [999]
        assert not batch.done()
        assert await batch == echoes(200)

    run_client(Counting(4), use, max_in_flight=4)


Ask = Callable[[Any], object]


def ask(url: str, what: Ask) -> None:
    """Let a thread ask a client at `url`."""

    async def main() -> None:
        async with AsyncClient(url, unit=UNIT, timeout=TIMEOUT) as plc:
            await asyncio.to_thread(what, Awaited(threadsafe(asyncio.get_running_loop()), plc))

    run(main())


def agreements(functions: range) -> list[Ask]:
    """Scenarios, each with a fresh server: standard functions, refusals, and many at once."""

    def agree(exchange: Exchange, context: Any) -> None:
        assert exchange.ask(context) == exchange.answer, exchange.name
        assert exchange.look(context) == exchange.seen, exchange.name

    def refuse(exchange: Exchange, context: Any) -> None:
        with pytest.raises(IllegalDataAddress):
            exchange.ask(context)
        assert context.read_holding_registers(399, 1) == [1399]

    def many(context: Any) -> None:
        requests = [pdu.ReadHoldingRegisters(300 + at % 100, 1) for at in range(200)]
        assert context.execute_many(requests) == [[1300 + at % 100] for at in range(200)]

    agreed = [partial(agree, item) for item in exchanges() if item.function in functions]
    refusals_ = [partial(refuse, item) for item in refusals() if item.function in functions]
    return [*agreed, *refusals_, many]


@pytest.mark.parametrize("transport", ["tcp", "rtu"])
def test_a_libmodbus_server_in_c_is_read(compiled: Callable[[str], Any], transport: str) -> None:
    for what in agreements(range(1, 44)):
        with c_serving(compiled("server"), transport) as url:
            ask(url, what)


@pytest.mark.parametrize("transport", FRAMERS)
def test_both_clients_agree_on_answers_of_pymodbus(transport: str) -> None:
    for what in agreements(range(1, 17))[:-1]:
        with pymodbus_serving(transport) as url:
            ask(url, what)


def test_both_clients_agree_on_answers_of_our_server(transport: str) -> None:
    for what in agreements(range(1, 44)):
        with serving(transport, Server(make_device())) as url:
            ask(url, what)
