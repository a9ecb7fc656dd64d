"""
A server as a whole: how it starts, what it refuses to start with, and how it stops.
"""

import asyncio
import errno
import socket

import pytest

from libmodbus_py import Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.ports.endpoint import parse
from tests.support.attacks import adu, connect
from tests.support.names import NEEDS_IPV6

READ, ANSWER = bytes.fromhex("03 0064 0002"), bytes.fromhex("03 04 03e8 03e9")


def test_stops_whatever_clients_do(device: Device) -> None:
    with Server(device).background("tcp://127.0.0.1:0", "rtu+tcp://127.0.0.1:0") as running:
        clients = [connect(url) for url in running.urls for _ in range(20)]
        for number, client in enumerate(clients):
            client.sendall(adu(READ)[: number % 12])
    for client in clients:
        client.close()
    with pytest.raises(ConnectionRefusedError):
        connect(running.urls[0])


def test_a_port_that_is_taken_is_a_clear_error(device: Device) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with (
            pytest.raises(ModbusConnectionError, match="in use") as caught,
            Server(device).background("tcp://127.0.0.1:0", url),
        ):
            pass
    assert caught.value.errno == errno.EADDRINUSE
    assert url in str(caught.value)


@pytest.mark.parametrize(
    ("url", "named"),
    [
        ("rtu:///dev/no-such-port", "/dev/no-such-port"),
        ("rtu:///dev/null", "not a serial port"),
        ("tcp://no-such-host.invalid:0", "no-such-host"),
    ],
)
def test_an_endpoint_that_cannot_be_opened_is_a_clear_error(
    device: Device, url: str, named: str
) -> None:
    with (
        pytest.raises(ModbusConnectionError, match=named),
        Server(device).background(url),
    ):
        pass


@pytest.mark.parametrize(
    "devices", [None, [], {1: "device"}, *({unit: Device(Mapping())} for unit in (-1, 256, "1"))]
)
def test_devices_must_be_devices(devices: object) -> None:
    with pytest.raises((TypeError, ValueError), match=r"device|unit"):
        Server(devices)  # type: ignore[arg-type]


@pytest.mark.parametrize("second", ["127.0.0.2", pytest.param("[::1]", marks=NEEDS_IPV6)])
def test_serving_in_asyncio(device: Device, second: str) -> None:
    async def main() -> bytes:
        async with Server(device).serving("tcp://127.0.0.1:0", f"tcp://{second}:0") as running:
            assert [url.rpartition(":")[0] for url in running.urls] == [
                "tcp://127.0.0.1",
                f"tcp://{second}",
            ]
            reader, writer = await asyncio.open_connection("127.0.0.1", parse(running.urls[0]).port)
            writer.write(adu(READ))
            answer = await reader.readexactly(13)
            writer.close()
            return answer

    assert asyncio.run(main()) == adu(ANSWER)
