"""A server begins, ends, and can be entered once at a time."""

import asyncio
import errno
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import Client, Device, Gateway, Mapping, ModbusConnectionError, Route, Server
from libmodbus_py.ports.endpoint import parse
from tests.support.attacks import adu, connect
from tests.support.cases import each_case
from tests.support.names import NEEDS_IPV6

READ, ANSWER = bytes.fromhex("03 0064 0002"), bytes.fromhex("03 04 03e8 03e9")


def test_a_server_stops_whatever_its_clients_do(device: Device) -> None:
    with Server(device).background("tcp://127.0.0.1:0", "rtu+tcp://127.0.0.1:0") as running:
        clients = [connect(url) for url in running.urls for _ in range(20)]
        for number, client in enumerate(clients):
            client.sendall(adu(READ)[: number % 12])
    for client in clients:
        client.close()
    with pytest.raises(ConnectionRefusedError):
        connect(running.urls[0])


def test_a_port_in_use_is_a_clear_error(device: Device) -> None:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        url = f"tcp://127.0.0.1:{sock.getsockname()[1]}"
        with (
            pytest.raises(ModbusConnectionError, match="in use") as caught,
            Server(device).background("tcp://127.0.0.1:0", url),
        ):
            pass
    assert caught.value.errno == errno.EADDRINUSE
    assert url in str(caught.value)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("rtu:///dev/no-such-port", "/dev/no-such-port"),
        ("rtu:///dev/null", "not a serial port"),
        ("tcp://no-such-host.invalid:0", "no-such-host"),
    ],
)
def test_an_endpoint_that_cannot_be_opened_is_a_clear_error(device: Device, url, message) -> None:
    with pytest.raises(ModbusConnectionError, match=message), Server(device).background(url):
        pass


@pytest.mark.parametrize(
    "devices", [None, [], {1: "device"}, *({unit: Device(Mapping())} for unit in (-1, 256, "1"))]
)
def test_devices_must_be_devices(devices: object) -> None:
    with pytest.raises((TypeError, ValueError), match=r"device|unit"):
        Server(devices)  # type: ignore[arg-type]


@pytest.mark.parametrize("second", ["127.0.0.2", pytest.param("[::1]", marks=NEEDS_IPV6)])
def test_a_server_in_asyncio_listens_on_two_endpoints(device: Device, second: str) -> None:
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


HERE = "tcp://127.0.0.1:0"

SERVERS: dict[str, Callable[[str], Any]] = {
    "server": lambda url: Server(Device(Mapping(holding_registers=10))).background(HERE),
    "gateway": lambda url: Gateway([Route(url)]).background(HERE),
}


@pytest.mark.parametrize("kind", SERVERS)
def test_a_running_background_block_cannot_be_entered_again(kind: str) -> None:
    with SERVERS["server"]("") as behind:
        background = SERVERS[kind](behind.urls[0])
        with background as running:
            for _ in range(2):
                with pytest.raises(RuntimeError, match="call background"), background:
                    pass
            with Client(running.urls[0]) as client:
                assert client.read_holding_registers(0, 1) == [0]
        with pytest.raises(RuntimeError, match="call background"), background:
            pass


TABLES = ("coils", "discrete_inputs", "holding_registers", "input_registers")


@each_case("name", TABLES)
def test_a_view_in_a_with_statement_closes_a_copy(name: str) -> None:
    mapping = Mapping(10, 10, 10, 10)
    table = getattr(mapping, name)
    table[3] = 1
    with table.view as view:
        assert view[3] == 1
    table.view.release()
    table[4] = 1
    assert (table[3], table[4], table.view[4]) == (1, 1, 1)


PROGRAM = """
import gc, sys
from libmodbus_py import Device, Mapping, Server
counts = []
def stop(running):
    counts.append(gc.get_freeze_count())
    raise LookupError
{before}
start = gc.get_freeze_count()
for _ in range(2):
    try:
        Server(Device(Mapping(1))).serve_forever("tcp://127.0.0.1:0", on_listening=stop)
    except LookupError:
        counts.append(gc.get_freeze_count())
print(start, *counts)
"""


def counts(before: str) -> list[int]:
    """Return how much is frozen: before, and while and after each of two servers serves."""
    program = [sys.executable, "-c", PROGRAM.format(before=before)]
    process = subprocess.run(program, capture_output=True, text=True, check=True)
    return [int(word) for word in process.stdout.split()]


def test_serve_forever_unfreezes_the_objects_that_it_froze() -> None:
    start, during, after, again, at_last = counts("")
    assert during > 10_000
    assert again > 10_000
    assert after <= start
    assert at_last <= start


def test_serve_forever_keeps_the_objects_that_the_program_froze() -> None:
    start, *others = counts("gc.freeze()")
    assert start > 10_000
    # Some of the objects may be freed meanwhile.
    assert all(start - 500 <= count <= start for count in others)
