"""A server on a serial line: noise, requests to others, and a port that is unplugged."""

import asyncio
import itertools
import os
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, ModbusTimeoutError, Server, listen
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server import serial as serial_server
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.serial import SerialServer
from libmodbus_py.server.server import Devices
from libmodbus_py.server.service import SessionState
from libmodbus_py.server.units import Units
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.lan import Lan, LineEnd
from tests.support.driver import ascii_frame, rtu
from tests.support.lan_server import unit_one
from tests.support.peers import LinePeer, ignore, until


@pytest.mark.parametrize("noise", [b"\x00", b"\xff\xff", b"\x01\x03", bytes(range(40)), b":0103"])
@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_serial_server_answers_the_next_request_after_noise(kind: str, noise: bytes) -> None:
    device = Device(Mapping(holding_registers=2))
    with (
        SerialWire() as wire,
        Server({1: device}).background(f"{kind}://{wire.server}?baudrate=115200"),
        Client(f"{kind}://{wire.client}?baudrate=115200", timeout=0.5) as context,
    ):
        for _ in range(3):
            os.write(context._driver._port.descriptor, noise)
            assert context.read_holding_registers(0, 2) == [0, 0]


NOISES = [b"", b"\0", b"\xff\xff", b"\2\3\x10", b"\2\x10\0\0", b"\xf8\0\x7e\x80"]


@pytest.mark.parametrize("is_gateway", [False, True])
def test_requests_between_noise_are_executed_once_each(lan: Lan, is_gateway: bool) -> None:
    """The master sends the next request as soon as it has the answer."""
    with unit_one("rtu:///dev/line?baudrate=115200", is_gateway=is_gateway) as (server, writes):
        master = LineEnd(lan.line("/dev/line"))
        for number, (behind, before) in enumerate(itertools.product(NOISES, NOISES), 1):
            master.heard = b""
            request = rtu(f"01 10 0000 0002 04 {number:04X} 0003")
            master.write(before + request + behind)
            started = lan.now
            while master.heard != rtu("01 10 0000 0002"):
                lan.pass_time(0.001)
                assert lan.now < started + 0.1, (before, behind)
            lan.pass_time(0.002)
            assert [write.values for write in writes[number - 1 :]] == [(number, 3)]
        assert server.statistics.requests == len(NOISES) ** 2


class OddEnd(LineEnd):
    """A unit whose frames end with one byte."""

    is_unit = True

    def __init__(self, lan: Lan, end: bytes) -> None:
        super().__init__(lan.line("/dev/line"))
        self._end = end

    def hear(self, data: bytes) -> None:
        self.write(ascii_frame("01 03 02 0007", self._end))


@pytest.mark.parametrize("end", [b"\r", b"\n"])
def test_ascii_frames_that_end_with_cr_or_lf_alone_are_accepted(lan: Lan, end: bytes) -> None:
    with unit_one("ascii:///dev/line"):
        master = LineEnd(lan.line("/dev/line"))
        master.write(ascii_frame("01 03 0000 0001", end))
        lan.pass_time(0.2)
        assert master.heard == ascii_frame("01 03 02 0000")
    OddEnd(lan, end)
    with Client("ascii:///dev/line", unit=1, timeout=1.0) as asks:
        assert asks.read_holding_registers(0, 1) == [7]
    separator, exchanges = listen.Separator("ascii"), []
    for at, pdu in enumerate(["01 03 0000 0001", "01 03 02 0007"] * 2):
        exchanges += separator.feed(ascii_frame(pdu, end), at * 0.2)
        exchanges += separator.tick(at * 0.2 + 0.15)
    assert [exchange.kind for exchange in exchanges] == ["answered"] * 2


def is_answered(context: Client) -> bool:
    try:
        return context.read_holding_registers(100, 1) == [1000]
    except ModbusTimeoutError:
        return False


def test_an_unplugged_port_is_opened_again(device: Device, tmp_path, monkeypatch) -> None:
    """The path stays, as udev keeps it; what it leads to is another port."""
    monkeypatch.setattr(serial_server, "REOPEN_AFTER", 0.05)
    path = tmp_path / "ttyUSB0"
    with SerialWire() as first, SerialWire() as second:
        path.symlink_to(first.server)
        with Server({17: device}).background(f"rtu://{path}"):
            with Client(f"rtu://{first.client}", unit=17, timeout=0.5) as context:
                assert context.read_holding_registers(100, 1) == [1000]
            path.unlink()  # first, as the number of a pseudo-terminal is given again at once
            first.unplug()
            path.symlink_to(second.server)
            with Client(f"rtu://{second.client}", unit=17, timeout=0.1) as context:
                until(lambda: is_answered(context))


@pytest.mark.parametrize(
    ("url", "data_bits", "is_silent"),
    [("ascii://{}", 7, False), ("ascii://{}?data_bits=8", 8, False), ("rtu://{}", 8, True)],
)
def test_ascii_ports_have_seven_data_bits(device: Device, url, data_bits, is_silent) -> None:
    """Pseudo-terminals ignore the setting, so the test checks the value passed to the port."""

    async def made() -> SerialServer:
        service = Devices(Units(device))
        return SerialServer(parse(url.format("/dev/null")), service, ServerStatistics())

    port = asyncio.run(made())._port
    assert port.data_bits == data_bits
    assert (port.silence.seconds > 0) is is_silent


ANSWERS = [b"%04d" % number * 64 for number in range(1000)]


class Service:
    """Makes one session, which answers when it is told to."""

    def sessions(self, endpoint: Any, statistics: Any, later: Any = None) -> Any:
        def made(channel: Any) -> Service:
            self.channel = channel
            return self

        return made

    state = SessionState.READING

    def receive(self, data: bytes) -> int:
        return 0

    def end(self) -> None: ...

    def close(self) -> None: ...


def test_the_latest_answers_wait_up_to_the_size_of_a_port_buffer() -> None:
    service = Service()

    async def write_all(path: str, is_over: Callable[[], bool]) -> None:
        url = f"rtu://{path}?baudrate=115200&rs485=rts-up&rts_delay=0.01"
        server = SerialServer(parse(url), service, ServerStatistics())
        await server.open()
        for answer in ANSWERS:
            service.channel.write(answer)
        while not is_over():
            await asyncio.sleep(0.001)
        server.close()

    with LinePeer(ignore) as line:
        asyncio.run(write_all(line.path, lambda: ANSWERS[-1] in b"".join(line.requests)))
    requests = b"".join(line.requests)
    pieces = [requests[at : at + 256] for at in range(0, len(requests), 256)]
    assert pieces == [ANSWERS[0], *ANSWERS[-16:]]


SHORT_ANSWERS = [rtu(f"01 03 04 {number:04X} 0000") for number in range(4)]


class TimedEnd(LineEnd):
    """A line end that records bytes and the times at which they arrive."""

    def __init__(self, lan: Lan, line: Any) -> None:
        super().__init__(line)
        self.pieces: list[tuple[float, bytes]] = []
        self._lan = lan

    def hear(self, data: bytes) -> None:
        self.pieces.append((self._lan.now, data))


@pytest.mark.parametrize("baudrate", [1200, 9600, 115200])
@pytest.mark.parametrize("rest", ["", "&rs485=rts-up"])
def test_an_answer_waits_for_silence_after_the_previous_one(lan: Lan, baudrate: int, rest: str):
    service = Service()

    async def begun() -> SerialServer:
        endpoint = parse(f"rtu:///dev/line?baudrate={baudrate}{rest}")
        server = SerialServer(endpoint, service, ServerStatistics())
        await server.open()
        return server

    other = TimedEnd(lan, lan.line("/dev/line"))
    server = lan.wait(begun())
    try:
        for answer in SHORT_ANSWERS:
            service.channel.write(answer)
        lan.pass_time(2.0)
    finally:
        lan.wait(closed(server))
    assert [data for _, data in other.pieces] == SHORT_ANSWERS
    times = [at for at, _ in other.pieces]
    character = 11 / baudrate
    pause = 3.5 * character if baudrate <= 19200 else 0.00175
    for before, after in pairwise(times):
        assert after - before >= len(SHORT_ANSWERS[0]) * character + pause - 1e-6


async def closed(server: SerialServer) -> None:
    server.close()
