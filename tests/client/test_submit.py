"""Requests that are submitted, and hooks that decide whether one is sent."""

import asyncio
import errno
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    IllegalDataAddress,
    ModbusConnectionError,
    ModbusTimeoutError,
    pdu,
)
from libmodbus_py.client.sender import Sender
from libmodbus_py.ports.port import Port
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.ports.sockets import StreamPort
from libmodbus_py.ports.trace import Traced
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.scripted import Scripted
from tests.support.clients import World
from tests.support.driver import Driver
from tests.support.in_loops import run_client, run_peer
from tests.support.peers import Write, answering, echo, ignore, mbap
from tests.support.reads import on_read, on_read_at

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


async def test_what_cannot_be_sent_is_refused_at_once() -> None:
    client = AsyncClient("rtu:///dev/nowhere")
    with pytest.raises(TypeError):
        Sender(client).submit(1, b"\3", lambda: None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="broadcast"):
        Sender(client).submit(0, READ, lambda: None)
    await client.close()


class Gate:
    """Says whether anything may be sent; counts how often it was asked."""

    def __init__(self, is_open: bool = True) -> None:
        self.is_open = is_open
        self.asked = 0

    def __call__(self) -> bool:
        self.asked += 1
        return self.is_open

    def shut(self, *_: object) -> None:
        self.is_open = False


def refused(outcome: object) -> bool:
    return isinstance(outcome, ModbusConnectionError) and outcome.errno == errno.EPERM


def test_nothing_connects_or_is_sent_until_it_may() -> None:
    gate = Gate(is_open=False)

    async def main(peer: Scripted) -> None:
        plc = AsyncClient(peer.url, may_send=gate)
        with pytest.raises(ModbusConnectionError, match="may_send allows no request") as caught:
            await plc.read_holding_registers(7, 1)
        assert refused(caught.value)
        assert peer.connections == 0
        gate.is_open = True
        assert await plc.read_holding_registers(7, 1) == [7]
        asked = gate.asked
        assert await plc.read_holding_registers(8, 1) == [8]
        assert gate.asked > asked
        gate.is_open = False
        with pytest.raises(ModbusConnectionError, match="may_send"):
            await plc.read_holding_registers(7, 1)
        await plc.close()
        assert len(peer.requests) == 2

    run_peer(on_read, main)


@pytest.mark.parametrize(
    ("options", "sent"), [({"max_in_flight": 1}, 1), ({"connect_delay": 0.1}, 0)]
)
def test_those_that_wait_are_not_sent_once_it_is_over(options: Any, sent: int) -> None:
    """They wait for a slot, or for the delay after connecting: asked at their start it was yes."""
    gate = Gate()

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        asking = [asyncio.create_task(plc.read_holding_registers(7, 1)) for _ in range(3)]
        await asyncio.sleep(0.03)
        gate.shut()
        outcomes = await asyncio.gather(*asking, return_exceptions=True)
        assert len(peer.requests) == sent
        assert sum(map(refused, outcomes)) == 3 - sent

    run_client(on_read_at("tcp", after=0.1), use, may_send=gate, **options)


def test_false_is_no_mistake_and_all_but_true_and_false_is(caplog) -> None:
    for allowed in (False, True):
        driver = Driver(may_send=lambda allowed=allowed: allowed)
        assert driver.ask(1).is_done is not allowed
        assert caplog.records == []
    for mistake in (lambda: 1, lambda: 0, lambda: None, lambda: "yes", lambda: 1 / 0 > 0):
        (outcome,) = Driver(may_send=mistake).ask(1).outcomes
        assert refused(outcome)
        assert "may_send" in str(outcome)
        assert caplog.records
        caplog.clear()


def test_it_is_for_asyncio_alone() -> None:
    with pytest.raises(TypeError, match="may_send"):
        Client("tcp://127.0.0.1", may_send=Gate())  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="may_send must be a function"):
        AsyncClient("tcp://127.0.0.1", may_send=1)  # type: ignore[typeddict-item]


@pytest.mark.parametrize("when", ["given", "traced"])
def test_nothing_goes_while_a_line_is_turned_round(when, monkeypatch) -> None:
    """With RTS the frame leaves later than it was given to the port."""
    gate = Gate()
    send = SerialPort.send

    def stopping(self: SerialPort, adus: list[bytes], now: float) -> None:
        send(self, adus, now)
        gate.shut()

    async def main(wire: SerialWire) -> None:
        url = f"rtu://{wire.client}?baudrate=115200&rs485=rts-up&rts_delay=0.05"
        trace = gate.shut if when == "traced" else None
        async with AsyncClient(url, may_send=gate, timeout=10, trace=trace) as plc:
            with pytest.raises(ModbusConnectionError) as caught:
                await plc.read_holding_registers(0, 1)
            assert refused(caught.value)

    monkeypatch.setattr(SerialPort, "send", stopping if when == "given" else send)
    with SerialWire() as wire:
        asyncio.run(main(wire))
        assert wire.sent_by("client") == b""


def test_what_could_not_be_sent_is_not_traced(world: World, monkeypatch) -> None:
    """The connection ends when the frame is to be sent."""

    def fail(self: Port, adus: list[bytes], now: float) -> None:
        raise ModbusConnectionError("reset", errno=errno.ECONNRESET)

    traced: list[Traced] = []
    with world.client_of("tcp", on_read, trace=traced.append) as plc:
        with monkeypatch.context() as patch:
            patch.setattr(StreamPort, "send", fail)
            with pytest.raises(ModbusConnectionError):
                plc.read_holding_registers(5, 1)
        assert traced == []
        assert plc.read_holding_registers(5, 1) == [5]
        assert [each.direction for each in traced] == ["sent", "received"]
