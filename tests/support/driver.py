"""
A connection driven by a list of times and bytes: no socket, no port, no sleep.

The check bytes of answers are computed here, from the specification, and not by the package.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError, pdu
from libmodbus_py.client.call import Batch, Call, Timeouts
from libmodbus_py.client.connection import Transactions
from libmodbus_py.client.history import forget_lines
from libmodbus_py.client.options import checked_options
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.port import make_port

TCP = "tcp://192.0.2.1"
LINE = "rtu:///dev/nowhere?silence=0"
ASCII = "ascii:///dev/nowhere"

LOST = ModbusConnectionError("closed by the other side", errno=104)


class Driver:
    """
    What a driver does, with a clock that the test moves. `url`: whose connection; nothing is
    opened. The line has been open for long; `is_new` for one that was just opened; `after`: another
    client, which was closed in the same process; `options`: of the client; 16 may be in flight
    where frames carry ids. `now`: seconds since the connection stood; `sent`: all ADUs that went
    out, oldest first, and `times` when.
    """

    def __init__(
        self,
        url: str = TCP,
        *,
        is_open: bool = True,
        is_new: bool = False,
        after: Driver | None = None,
        **options: Any,
    ) -> None:
        if after is None:
            forget_lines()
        endpoint = parse(url)
        most = 16 if endpoint.framing in ("tcp", "udp") else 1
        settings = {"max_in_flight": most, **options}
        self.settings = checked_options(endpoint, settings)
        port = make_port(endpoint, self.settings)
        self.is_udp = endpoint.scheme == "udp"
        self.connection = Transactions(endpoint, self.settings, port)
        self.matching: Any = self.connection.matching
        self.life = self.connection.life
        self.statistics = self.connection.statistics
        self.notices = self.connection.notices
        self.timeouts = Timeouts(
            self.settings["timeout"], self.settings["retries"], self.settings["busy_retries"]
        )
        self.now = after.now if after else 0.0
        self.is_new = is_new
        self.sent: list[bytes] = []
        self.times: list[float] = []
        if is_open:
            self.open()

    def open(self) -> None:
        self.life.connecting()
        self.connection.opened(self.now)
        if not self.is_new:
            self.matching._is_opened = self.matching._is_unknown = False
        self.start()

    def fail(self) -> None:
        """An attempt to connect."""
        self.life.connecting()
        self.connection.failed(ModbusConnectionError("refused", errno=111), self.now)

    def lose(self, error: ModbusConnectionError = LOST, *, by_itself: bool = True) -> None:
        self.connection.lost(error, self.now, by_itself=by_itself)

    def leave_broken(self) -> None:
        """As the drivers do when the connection wants another connection."""
        assert self.connection.broken is not None
        self.lose(self.connection.broken, by_itself=False)

    def replace_broken(self) -> None:
        """Leave a connection that wants another one, and open that."""
        self.leave_broken()
        self.open()

    def reconnect(self, *, by_itself: bool = True) -> None:
        """Lose the connection, and open another one."""
        self.lose(by_itself=by_itself)
        self.open()

    def forget(self) -> None:
        """Let `sent` and `times` begin with the next request."""
        self.sent.clear()
        self.times.clear()

    def ask(self, *requests: Any, unit: int = 1, one_by_one: bool = True, **options: Any) -> Batch:
        """Send requests; a number stands for a read of the register at this address."""
        batch = self.batch(*requests, unit=unit, one_by_one=one_by_one, **options)
        self.connection.submit(batch, self.now)
        self.start()
        return batch

    def join(self, **timeouts: Any) -> Call:
        """Wait for the connection only."""
        call = Call(1, None, self.timeouts.but(timeouts.get("timeout"), None))
        self.connection.submit(call, self.now)
        self.start()
        return call

    def batch(
        self,
        *requests: Any,
        unit: int = 1,
        one_by_one: bool = True,
        go_on: bool = False,
        is_broadcast: bool = False,
        **timeouts: Any,
    ) -> Batch:
        settings = self.settings
        usual = {
            "timeout": settings["timeout"],
            "retries": settings["retries"],
            "busy_retries": settings["busy_retries"],
        }
        return Batch(
            unit,
            [read(request) if isinstance(request, int) else request for request in requests],
            Timeouts(**{**usual, **timeouts}) if timeouts else self.timeouts,
            one_by_one=one_by_one or settings["max_in_flight"] == 1,
            go_on=go_on,
            is_broadcast=is_broadcast,
        )

    def cancel(self, batch: Batch) -> None:
        self.connection.withdraw(batch, self.now)
        self.start()

    def start(self) -> None:
        while self.connection.start(self.now, self.receive):
            pass
        self.notices.give()

    def receive(self, adus: list[bytes], now: float) -> None:
        self.sent += adus
        self.times += [now] * len(adus)

    def come(self, *pieces: bytes) -> None:
        for piece in pieces:
            if self.connection.take([piece], self.now):
                self.start()
            self.connection.settle(self.now)
            self.start()

    def wait(self, seconds: float) -> None:
        """Let time pass, and ring at every alarm on the way; one that never stops is a fault."""
        end, rung = round(self.now + seconds, 9), 0
        while (at := self.matching.alarm) <= end + 1e-9:
            rung = rung + 1 if at <= self.now else 0
            assert rung < 10, "the alarm rings for ever"
            self.now = max(self.now, at)
            self.connection.tick(self.now)
            self.connection.settle(self.now)
            self.start()
        self.now = max(self.now, end)

    def wait_until(self, at: float) -> None:
        self.wait(at - self.now)

    def wait_for(self, count: int) -> None:
        """Until so many requests were sent."""
        while len(self.sent) < count:
            at = self.matching.alarm
            assert at < 1000, f"{len(self.sent)} of {count} requests were sent"
            self.wait_until(at)

    @property
    def has_ids(self) -> bool:
        has_ids: bool = self.matching.has_ids
        return has_ids

    @property
    def is_at_rest(self) -> bool:
        """True if nothing is left of all that was asked."""
        connection = self.connection
        return not connection.in_flight and not connection.is_wanted


def read(address: int) -> pdu.ReadHoldingRegisters:
    return pdu.ReadHoldingRegisters(address, 1)


def tcp(request: bytes, body: str | None = None, *, unit: int | None = None, **id: int) -> bytes:
    """Answer a request; a read of a register with its address."""
    data = b"\x03\x02" + request[8:10] if body is None else bytes.fromhex(body)
    number = id.get("number", int.from_bytes(request[:2], "big"))
    size = (1 + len(data)).to_bytes(2, "big")
    head = number.to_bytes(2, "big") + id.get("protocol", 0).to_bytes(2, "big") + size
    return head + bytes([request[6] if unit is None else unit]) + data


def rtu(body: str) -> bytes:
    """Append the CRC (serial line, 6.2.2)."""
    data = bytes.fromhex(body)
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return data + crc.to_bytes(2, "little")


def value(number: int, unit: int = 1) -> bytes:
    """The answer to a read of one register, in RTU."""
    return rtu(f"{unit:02X} 03 02 {number:04X}")


def ascii_frame(body: str, end: bytes = b"\r\n") -> bytes:
    """Write digits and their LRC (serial line, 6.2.1)."""
    data = bytes.fromhex(body)
    return b":" + (data + bytes([-sum(data) % 256])).hex().upper().encode() + end


@contextlib.contextmanager
def small_memory() -> Iterator[None]:
    """Check that the block keeps 64 KiB of memory at most."""
    tracemalloc = pytest.importorskip("tracemalloc", reason="PyPy does not measure memory")
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[0] < 0x10000
    finally:
        tracemalloc.stop()


def kinds(batch: Batch) -> list[Any]:
    """Results, and of failures their types."""
    return [type(item) if isinstance(item, Exception) else item for item in batch.outcomes]
