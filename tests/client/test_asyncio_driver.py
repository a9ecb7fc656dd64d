"""The asyncio client at the edges of its port: sends that fail or take a while, and its clock."""

import asyncio
import contextlib
import os
import time
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, ModbusConnectionError, State, pdu
from libmodbus_py.client.sender import Sender
from tests.simulation.ports import memory_port
from tests.simulation.scripted import Scripted, Write
from tests.support.driver import value
from tests.support.in_loops import run_client
from tests.support.peers import FakeServer, TcpPeer, echo
from tests.support.scripted import run


def answer_rtu(request: bytes, write: Write) -> None:
    write(value(int.from_bytes(request[2:4], "big")), 0.01)


def answer_tcp(request: bytes, write: Write) -> None:
    write(request[:4] + b"\0\5" + request[6:8] + b"\2" + request[8:10], 0.01)


@pytest.mark.parametrize("rs485", ["rts-up", "rts-down"])
def test_a_line_with_a_turnaround_delay_is_sent_to_after_the_delay(rs485: str) -> None:
    async def use(plc: AsyncClient, peer: Scripted) -> None:
        for address in (3, 4):
            start = peer.network.events.now
            assert await plc.read_holding_registers(address, 1) == [address]
            assert peer.times[-1] - start >= 0.25
        assert len(peer.requests) == 2

    run_client(answer_rtu, use, f"rtu:///dev/line?unit=1&rs485={rs485}&rts_delay=0.25")


def test_a_failed_send_is_raised_at_once_and_the_next_uses_another_connection(monkeypatch):
    kind = memory_port("tcp")
    send = kind.send
    errors = [True]

    def fail(port: Any, adus: list[bytes], now: float) -> None:
        if errors:
            errors.clear()
            raise ModbusConnectionError("Broken pipe", errno=32)
        send(port, adus, now)

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        monkeypatch.setattr(kind, "send", fail)
        start = peer.network.events.now
        with pytest.raises(ModbusConnectionError, match="Broken pipe"):
            await plc.read_holding_registers(1, 1)
        assert peer.network.events.now == start
        assert plc.statistics.lost == 1
        assert await plc.read_holding_registers(2, 1) == [2]
        assert peer.connections == 2

    run_client(answer_tcp, use, retries=0)


def test_bytes_the_system_does_not_take_are_sent_later() -> None:
    """A host that reads slowly: the rest follows as soon as there is room."""

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        plc._driver._port._socket.capacity = 7  # type: ignore[attr-defined]
        reads = [plc.read_holding_registers(address, 1) for address in range(20)]
        assert await asyncio.gather(*reads) == [[address] for address in range(20)]
        assert len(peer.requests) == 20

    run_client(answer_tcp, use, max_in_flight=16)


def test_requests_of_one_moment_are_sent_together() -> None:
    """One turn of the loop, and as few calls of the system as can be."""
    pieces: list[bytes] = []

    def tap(place: str, number: int, is_client: bool, data: bytes) -> None:
        if is_client:
            pieces.append(data)

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        await plc.read_holding_registers(0, 1)
        peer.network.tap = tap
        await asyncio.gather(*(plc.read_holding_registers(number, 1) for number in range(8)))
        assert len(b"".join(pieces)) == 8 * 12
        assert len(pieces) <= 3

    run_client(answer_tcp, use, max_in_flight=16)


def test_a_client_that_waits_for_nothing_sets_no_alarm() -> None:
    """An idle client must not wake the machine."""

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        await plc.read_holding_registers(0, 1)
        await asyncio.sleep(60)
        happened = peer.network.events.happened
        await asyncio.sleep(3600)
        assert peer.network.events.happened == happened

    run_client(answer_tcp, use)


REQUEST = pdu.ReadHoldingRegisters(5, 1)


def test_another_event_loop_is_refused() -> None:
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


@pytest.mark.parametrize("pending", [False, True])
def test_a_loop_that_was_closed_before_its_client_leaves_no_warning(pending, caplog):
    """All that needs no loop works, and the descriptor is closed with the last handle."""
    loop = asyncio.new_event_loop()

    async def use() -> None:
        assert await plc.read_holding_registers(7, 1) == [7]
        if pending:
            Sender(plc).submit(1, REQUEST, lambda: None)

    with FakeServer(lambda request: [echo(request)], lambda request: []) as server:
        plc: Any = AsyncClient(server.url)
        loop.run_until_complete(use())
        plc._driver._alarm.cancel()  # the timer would be left behind
        loop.close()
        plc.timeout = 0.5
        assert (plc.for_unit(2).timeout, plc.state) == (0.5, State.CONNECTED)
        descriptor = plc._driver._port.descriptor
        with pytest.warns(ResourceWarning, match="was not closed"):
            plc = None
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(descriptor)
    assert caplog.records == []


def test_values_of_a_watch_are_returned_as_its_client_returns_values() -> None:
    plc, other = Client("tcp://192.0.2.1"), AsyncClient("tcp://192.0.2.1")
    items = [("coils", 0, 8)]
    with pytest.raises(TypeError, match="'AsyncPolls' object is not an iterator"):
        next(other.watch(items, every=1))  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="'BlockingPolls' object is not an async iterator"):
        anext(plc.watch(items, every=1))  # type: ignore[call-overload]
    plc.close()


def test_a_clock_that_replaces_the_clock_of_the_loop_counts(monkeypatch) -> None:
    async def ask(url: str) -> None:
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "time", lambda: 1e6 + time.monotonic())
        async with AsyncClient(url, timeout=30) as plc:
            assert await plc.read_holding_registers(5, 1) == [5]

    with TcpPeer(lambda request, write: write(echo(request), after=0.1)) as peer:
        asyncio.run(ask(peer.url))
