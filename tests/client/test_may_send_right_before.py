"""
Whether anything goes out is asked once more right before it does: a process may be stopped at any
place, such as between two lines of Python, and its lease may be over when it goes on.
"""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError
from libmodbus_py.client.connection import Transactions
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.peers import FakeServer, UdpPeer, answering, echo


class StoppedAt:
    """Stands for a process that stood still after its n-th look: from then on nothing may go."""

    def __init__(self) -> None:
        self.is_allowed = True

    def __call__(self) -> bool:
        return self.is_allowed

    def stop(self, *_: object) -> None:
        self.is_allowed = False


def good(request: bytes) -> list[bytes]:
    return [echo(request)]


def stopped_behind(monkeypatch: pytest.MonkeyPatch, name: str, gate: StoppedAt) -> None:
    """Stop the process as soon as a method of the connection has returned frames."""
    method: Callable[..., Any] = getattr(Transactions, name)

    def stopping(self: Transactions, *arguments: Any) -> Any:
        found = method(self, *arguments)
        if found:
            gate.stop()
        return found

    monkeypatch.setattr(Transactions, name, stopping)


@pytest.mark.parametrize("scheme", ["tcp", "udp"])
def test_nothing_goes_once_the_frames_were_made(
    scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = StoppedAt()
    stopped_behind(monkeypatch, "start", gate)

    async def main() -> None:
        plc = AsyncClient(server.url, may_send=gate, timeout=10)
        asking = [plc.read_holding_registers(address, 1) for address in range(3)]
        for each in await asyncio.gather(*asking, return_exceptions=True):
            assert isinstance(each, ModbusConnectionError)
            assert each.errno == errno.EPERM
        await plc.close()

    with FakeServer(good) if scheme == "tcp" else UdpPeer(answering(good)) as server:
        asyncio.run(main())
    assert server.requests == []


@pytest.mark.parametrize("when", ["before", "after"])
def test_nothing_goes_while_a_line_is_turned_round(
    when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With RTS the frame leaves later than it was given to the port."""
    gate = StoppedAt()
    send = SerialPort.send

    def stopping(self: SerialPort, adus: list[bytes], now: float) -> None:
        send(self, adus, now)
        gate.stop()

    async def main(wire: SerialWire) -> None:
        url = f"rtu://{wire.client}?baudrate=115200&rs485=rts-up&rts_delay=0.05"
        # The trace is told of a frame before that is given to the port.
        trace = gate.stop if when == "before" else None
        async with AsyncClient(url, may_send=gate, timeout=10, trace=trace) as plc:
            with pytest.raises(ModbusConnectionError) as caught:
                await plc.read_holding_registers(0, 1)
            assert caught.value.errno == errno.EPERM

    monkeypatch.setattr(SerialPort, "send", stopping if when == "after" else send)
    with SerialWire() as wire:
        asyncio.run(main(wire))
        assert wire.sent_by("client") == b""
