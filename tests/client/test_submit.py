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
from libmodbus_py.ports.trace import TracedFrame
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.scripted import Scripted
from tests.support.clients import World
from tests.support.driver import Driver
from tests.support.in_loops import run_client, run_peer
from tests.support.peers import Write, answering, echo, ignore, mbap
from tests.support.reads import on_read, on_read_at

READ = pdu.ReadHoldingRegisters(7, 1)


def test_each_submitted_request_calls_on_done_once() -> None:
    def up_to_nine(request: bytes, write: Write) -> None:
        write(echo(request) if request[9] < 10 else mbap(request, b"\x83\x02"))

    async def use(client: AsyncClient, _: Scripted) -> None:
        indexes: list[int] = []
        submissions = [
            Sender(client).submit(
                1, pdu.ReadHoldingRegisters(at % 12, 1), lambda at=at: indexes.append(at)
            )
            for at in range(100)
        ]
        await asyncio.sleep(5)
        assert sorted(indexes) == list(range(100))
        for at, submission in enumerate(submissions):
            if at % 12 < 10:
                assert submission.outcome == [at % 12]
            else:
                assert isinstance(submission.outcome, IllegalDataAddress)

    run_client(up_to_nine, use)


def test_a_withdrawn_request_calls_no_on_done_and_its_answer_is_dropped() -> None:
    async def use(client: AsyncClient, _: Scripted) -> None:
        names: list[str] = []
        first = Sender(client).submit(1, READ, lambda: names.append("first"))
        await asyncio.sleep(0.05)
        first.withdraw()
        first.withdraw()
        second = Sender(client).submit(1, READ, lambda: names.append("second"))
        await asyncio.sleep(1)
        assert names == ["second"]
        assert second.outcome == [7]
        second.withdraw()  # too late, and without effect
        assert client.statistics.late_answers == 1

    def late(request: bytes) -> list[bytes]:
        answers.append(echo(request))
        return []

    answers: list[bytes] = []
    run_client(answering(late, lambda request: [*answers, echo(request)]), use, timeout=5)


@pytest.mark.parametrize("kind", ["nobody", "silence", "closed"])
def test_failures_call_on_done(kind: str) -> None:
    async def main(peer: Scripted) -> None:
        client = AsyncClient("tcp://10.0.0.9" if kind == "nobody" else peer.url, timeout=0.2)
        if kind == "closed":
            await client.close()
        event = asyncio.Event()
        submitted = Sender(client).submit(1, READ, event.set)
        await asyncio.wait_for(event.wait(), 5)
        error = ModbusTimeoutError if kind == "silence" else ModbusConnectionError
        assert isinstance(submitted.outcome, error)
        await client.close()

    run_peer(ignore, main)


async def test_impossible_requests_are_refused_at_once() -> None:
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


def test_without_permission_a_client_neither_connects_nor_sends() -> None:
    gate = Gate(is_open=False)

    async def main(peer: Scripted) -> None:
        plc = AsyncClient(peer.url, may_send=gate)
        with pytest.raises(ModbusConnectionError, match="may_send allows no request") as caught:
            await plc.read_holding_registers(7, 1)
        assert refused(caught.value)
        assert peer.connections == 0
        gate.is_open = True
        assert await plc.read_holding_registers(7, 1) == [7]
        count = gate.asked
        assert await plc.read_holding_registers(8, 1) == [8]
        assert gate.asked > count
        gate.is_open = False
        with pytest.raises(ModbusConnectionError, match="may_send"):
            await plc.read_holding_registers(7, 1)
        await plc.close()
        assert len(peer.requests) == 2

    run_peer(on_read, main)


@pytest.mark.parametrize(
    ("options", "count"), [({"max_in_flight": 1}, 1), ({"connect_delay": 0.1}, 0)]
)
def test_waiting_requests_are_refused_once_permission_ends(options: Any, count: int) -> None:
    """Requests wait for a slot, or for the delay after connecting; permission was given before."""
    gate = Gate()

    async def use(plc: AsyncClient, peer: Scripted) -> None:
        asking = [asyncio.create_task(plc.read_holding_registers(7, 1)) for _ in range(3)]
        await asyncio.sleep(0.03)
        gate.shut()
        outcomes = await asyncio.gather(*asking, return_exceptions=True)
        assert len(peer.requests) == count
        assert sum(map(refused, outcomes)) == 3 - count

    run_client(on_read_at("tcp", after=0.1), use, may_send=gate, **options)


def test_may_send_must_return_a_bool(caplog) -> None:
    for permission in (False, True):
        driver = Driver(may_send=lambda permission=permission: permission)
        assert driver.ask(1).is_done is not permission
        assert caplog.records == []
    for mistake in (lambda: 1, lambda: 0, lambda: None, lambda: "yes", lambda: 1 / 0 > 0):
        (outcome,) = Driver(may_send=mistake).ask(1).outcomes
        assert refused(outcome)
        assert "may_send" in str(outcome)
        assert caplog.records
        caplog.clear()


def test_may_send_is_an_option_of_asyncio_clients_alone() -> None:
    with pytest.raises(TypeError, match="may_send"):
        Client("tcp://127.0.0.1", may_send=Gate())  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="may_send must be a function"):
        AsyncClient("tcp://127.0.0.1", may_send=1)  # type: ignore[typeddict-item]


@pytest.mark.parametrize("when", ["given", "traced"])
def test_without_permission_nothing_is_sent_while_rts_is_turned(when, monkeypatch) -> None:
    """With RTS, the frame is sent some time after `send`."""
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


def test_unsent_frames_are_not_traced(world: World, monkeypatch) -> None:
    """The connection ends when the frame is to be sent."""

    def fail(self: Port, adus: list[bytes], now: float) -> None:
        raise ModbusConnectionError("reset", errno=errno.ECONNRESET)

    frames: list[TracedFrame] = []
    with world.client_of("tcp", on_read, trace=frames.append) as plc:
        with monkeypatch.context() as patch:
            patch.setattr(StreamPort, "send", fail)
            with pytest.raises(ModbusConnectionError):
                plc.read_holding_registers(5, 1)
        assert frames == []
        assert plc.read_holding_registers(5, 1) == [5]
        assert [frame.direction for frame in frames] == ["sent", "received"]
