"""
Faults that close a connection: what comes before, and what is not executed after.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import Context, ModbusConnectionError, Server
from libmodbus_py.protocol.framing import Frame, RtuFramer
from libmodbus_py.tools.faults.fault import Fault
from tests.simulation.stage import Stage
from tests.support.certificates import Papers, secured
from tests.tools.faults.serving import READ, adu, client_of, made_device, serving


@pytest.mark.parametrize("length", [None, 5, 512])
@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_what_comes_before_the_connection_closes(
    stage: Stage, scheme: str, length: int | None
) -> None:
    fault = Fault("disconnect", function=3, length=length)
    with serving(stage, scheme, {1: [fault]}) as url, stage.talk(url) as connection:
        if scheme == "tcp":
            connection.sendall(adu(b"\x01\0\0\0\x01", 7) + adu(READ, 8))
            before, answer = adu(b"\x01\x01\0", 7), adu(b"\x03\x02\x02\x2b", 8)
        else:
            framer = RtuFramer("client")
            connection.sendall(framer.encode(Frame(1, READ)))
            before, answer = b"", framer.encode(Frame(1, b"\x03\x02\x02\x2b"))
        assert connection.receive(100) == before + answer[: length or 0]


def test_what_is_asked_behind_a_closed_connection_is_not_executed(stage: Stage) -> None:
    device, other = made_device(), made_device()
    write = b"\x06\0\x01\0\x09"
    with (
        serving(
            stage, "tcp", {1: [Fault("disconnect", function=3)]}, units={1: device, 2: other}
        ) as url,
        stage.talk(url) as connection,
    ):
        requests = adu(write.replace(b"\1", b"\0")) + adu(READ) + adu(write) + adu(write, 1, 2)
        connection.sendall(requests)
        assert connection.receive(100) == adu(b"\x06\0\0\0\x09")
        # The server answers others, so it has dealt with these.
        with client_of(url, 2, timeout=5000) as client:
            client.read_coils(0, 1)
    assert device.mapping.holding_registers[0:2] == [9, 0]
    assert other.mapping.holding_registers[1] == 0


def test_a_disconnect_comes_after_answers_that_are_kept_back(stage: Stage) -> None:
    faults = [Fault("delay", function=1, seconds=100), Fault("disconnect", function=3, length=512)]
    with serving(stage, "tcp", {1: faults}) as url, stage.talk(url) as connection:
        connection.sendall(adu(b"\x01\0\0\0\x01", 1) + adu(READ, 2) + adu(READ, 3))
        expected = adu(b"\x01\x01\0", 1) + adu(b"\x03\x02\x02\x2b", 2)
        assert connection.receive(100) == expected


def test_garbage_and_disconnects_of_datagrams(stage: Stage) -> None:
    faults = [
        Fault("garbage", function=3, data=b"\xaa", place="behind"),
        Fault("disconnect", function=1, length=4),
    ]
    device = made_device()
    with Server(device, {1: faults}).background("udp://10.0.0.1:0") as running:
        datagrams = stage.talk(running.urls[0])
        datagrams.send(adu(READ, 5))
        assert datagrams.recv(100) == adu(b"\x03\x02\x02\x2b", 5) + b"\xaa"
        datagrams.send(adu(b"\x01\0\0\0\x01", 6))
        assert datagrams.recv(100) == adu(b"\x01\x01\0", 6)[:4]


def test_a_disconnect_closes_a_tunnel(tmp_path: Path) -> None:
    server = Server({1: made_device()}, {1: [Fault("disconnect", every=2, length=5)]})
    with (
        secured(server, Papers(tmp_path)) as url,
        Context.from_url(url, unit=1, timeout=5) as client,
    ):
        assert client.read_holding_registers(0, 1) == [555]
        with pytest.raises(ModbusConnectionError):
            client.read_holding_registers(0, 1)
        assert client.read_holding_registers(0, 1) == [555]
        assert server.statistics.handshakes == 2
