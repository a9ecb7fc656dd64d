"""
Tests in one thread on a network in memory.
"""

from __future__ import annotations

import struct

import pytest

from libmodbus_py import Context, Device, Fault, Mapping, ModbusTimeoutError, Server

from .stage import Stage

REGISTERS = {0: range(500, 510)}
READ = bytes.fromhex("0001 0000 0006 11 03 0002 0001")


def served() -> Server:
    return Server({17: Device(Mapping(holding_registers=REGISTERS))})


@pytest.mark.parametrize("url", ["tcp://10.0.0.1:0", "udp://10.0.0.1:0", "rtu:///dev/line"])
def test_a_blocking_client_and_a_server_in_one_thread(url: str) -> None:
    with (
        Stage(),
        served().background(url) as running,
        Context.from_url(running.urls[0], unit=17, timeout=3) as plc,
    ):
        assert plc.read_holding_registers(2, 2) == [502, 503]


def test_time_passes_only_while_the_test_waits() -> None:
    late = {None: [Fault("delay", seconds=500)]}
    server = Server({17: Device(Mapping(holding_registers=REGISTERS))}, late)
    with Stage() as stage, server.background("tcp://10.0.0.1:0") as running:
        with stage.talk(running.urls[0], "10.0.0.2") as client:
            client.sendall(READ)
            before = stage.now
            stage.pass_time(0)
            assert stage.now == before
            assert client.recv(100)[-2:] == struct.pack(">H", 502)
            assert stage.now - before == pytest.approx(500, abs=0.001)
        with (
            Context.from_url(running.urls[0], unit=17, timeout=100) as plc,
            pytest.raises(ModbusTimeoutError),
        ):
            plc.read_holding_registers(0, 1)
        assert stage.now - before >= 600


def test_datagrams_can_have_forged_sources() -> None:
    server = served()
    with Stage() as stage, server.background("udp://10.0.0.1:0", "udp://10.0.0.2:0") as running:
        first, second = (int(url.rpartition(":")[2]) for url in running.urls)
        stage.send_datagram(READ, ("10.0.0.2", second), ("10.0.0.1", first))
        stage.send_datagram(READ, ("192.0.2.7", 4711), ("10.0.0.1", first))
        stage.pass_time(1)
        # The second server takes the answer to the first datagram for a request, and refuses it;
        # this refusal is the last request.
        assert server.statistics.requests == 4
        assert server.statistics.refused == 1
