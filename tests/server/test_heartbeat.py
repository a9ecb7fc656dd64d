"""Masters that write the same again and again, as a heartbeat: no echo, each is carried out."""

from typing import Any

import pytest

from libmodbus_py import Client
from libmodbus_py.low_level import ffi, lib
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.lan import Lan, LanClient, LineEnd
from tests.support.cases import each
from tests.support.driver import ascii_frame, rtu
from tests.support.lan_server import unit_one

FRAMES = {"rtu": rtu, "ascii": ascii_frame}
COUNT = 20
TCP = "10.0.0.1:502"
URLS = {
    "rtu": "rtu:///dev/line?baudrate=115200",
    "ascii": "ascii:///dev/line?baudrate=115200",
    "rtu+tcp": f"rtu+tcp://{TCP}",
    "ascii+tcp": f"ascii+tcp://{TCP}",
}

# Requests and their responses (application protocol, 6.5, 6.6, 6.8, 6.11, 6.12 and 6.16).
HEARTBEATS = {
    "01 05 0001 FF00": "01 05 0001 FF00",
    "01 06 0001 0003": "01 06 0001 0003",
    "01 08 0000 A537": "01 08 0000 A537",
    "01 0F 0001 0002 01 03": "01 0F 0001 0002",
    "01 10 0001 0001 02 0003": "01 10 0001 0001",
    "01 16 0001 00FF 0000": "01 16 0001 00FF 0000",
}

# Seconds between an answer and the next request: none, the silence of the specification above
# 19200 bit/s, what a USB adapter keeps, and a usual heartbeat.
PAUSES = [0.0, 0.00175, 0.02, 1.0]


class Master:
    """Asks on a line or a connection, and returns what is answered."""

    def __init__(self, lan: Lan, url: str) -> None:
        endpoint = parse(url)
        self._lan = lan
        self._line = LineEnd(lan.line(endpoint.path)) if endpoint.is_serial else None
        self._talker: LanClient | None = None if endpoint.is_serial else lan.client(url, timeout=3)

    def ask(self, request: bytes, size: int) -> bytes:
        if self._line is None:
            assert self._talker is not None
            self._talker.sendall(request)
            return self._talker.receive(size)
        self._line.heard = b""
        self._line.write(request)
        self._lan.until(lambda: len(self._line.heard) >= size, 3)
        return self._line.heard

    def close(self) -> None:
        if self._talker is not None:
            self._talker.close()


def beat(master: Master, frame: Any, request: str) -> None:
    answer = frame(HEARTBEATS[request])
    assert master.ask(frame(request), len(answer)) == answer


@pytest.mark.parametrize("scheme", URLS)
@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize("pause", PAUSES)
def test_each_of_many_equal_writes_is_executed(lan: Lan, scheme, is_gateway, pause) -> None:
    url, frame = URLS[scheme], FRAMES[scheme.partition("+")[0]]
    for check, request in each(HEARTBEATS):
        with check, unit_one(url, is_gateway=is_gateway) as (server, writes):
            master = Master(lan, url)
            for _ in range(COUNT):
                beat(master, frame, request)
                lan.pass_time(pause)
            master.close()
            assert len(writes) == (0 if request[3:5] == "08" else COUNT)
            assert server.statistics.echoes == 0
            assert server.statistics.bad_frames == 0


@pytest.mark.parametrize("scheme", URLS)
def test_each_write_of_a_heartbeat_between_reads_is_executed(lan: Lan, scheme: str) -> None:
    """The answer of the first read shows that there is no echo."""
    url, frame = URLS[scheme], FRAMES[scheme.partition("+")[0]]
    with unit_one(url) as (server, writes):
        master = Master(lan, url)
        for _ in range(COUNT):
            assert master.ask(frame("01 03 0000 0001"), len(frame("01 03 02 0000")))
            beat(master, frame, "01 06 0001 0003")
        master.close()
        assert len(writes) == COUNT
        assert server.statistics.echoes == 0


@pytest.mark.parametrize("scheme", FRAMES)
@pytest.mark.parametrize("query", ["silence=0", "silence=0&echo=0", "baudrate=115200"])
def test_each_write_of_a_heartbeat_on_a_real_port_is_executed(scheme: str, query: str) -> None:
    """Without a pause, by a client of this package; bytes take no time there."""
    with (
        SerialWire() as wire,
        unit_one(f"{scheme}://{wire.server}?{query}") as (server, writes),
        Client(f"{scheme}://{wire.client}?{query}&unit=1&timeout=3&retries=0") as plc,
    ):
        for _ in range(COUNT):
            plc.write_register(1, 3)
    assert len(writes) == COUNT
    assert server.statistics.echoes == 0


@pytest.mark.parametrize("query", ["silence=0", "baudrate=115200"])
def test_each_write_of_libmodbus_as_the_master_is_executed(query: str) -> None:
    """Which leaves no pause between an answer and its next request."""
    beats = {
        "write_bit": lambda line: lib.modbus_write_bit(line, 1, 1) == 1,
        "write_register": lambda line: lib.modbus_write_register(line, 1, 3) == 1,
        "write_bits": lambda line: lib.modbus_write_bits(line, 1, 2, b"\1\1") == 2,
        "write_registers": lambda line: (
            lib.modbus_write_registers(line, 1, 1, ffi.new("uint16_t[]", [3])) == 1
        ),
        "mask_write": lambda line: lib.modbus_mask_write_register(line, 1, 0xFF, 0) != -1,
    }
    with SerialWire() as wire, unit_one(f"rtu://{wire.server}?{query}") as (server, writes):
        line = lib.modbus_new_rtu(wire.client.encode(), 115200, b"N", 8, 1)
        try:
            lib.modbus_set_slave(line, 1)
            lib.modbus_set_response_timeout(line, 3, 0)
            assert lib.modbus_connect(line) == 0
            for check, name in each(beats):
                writes.clear()
                with check:
                    assert all(beats[name](line) for _ in range(COUNT))
                    assert len(writes) == COUNT
        finally:
            lib.modbus_close(line)
            lib.modbus_free(line)
    assert server.statistics.echoes == 0
