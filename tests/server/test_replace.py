"""Other devices and faults while a server serves: who is connected stays, and sees the new ones."""

import asyncio
import gc
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Fault,
    GatewayTargetFailedToRespond,
    Hook,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Server,
    ServerDeviceBusy,
    pdu,
)
from libmodbus_py.server import udp
from tests.simulation.lan import Lan
from tests.support.peers import until
from tests.support.transports import TRANSPORTS, serving


def holding(value: int) -> Device:
    return Device(Mapping(holding_registers={0: [value]}))


@contextmanager
def connected(transport: str, server: Server) -> Iterator[Client]:
    """A client of unit 1."""
    with serving(transport, server) as url, Client(url, unit=1, timeout=2) as client:
        yield client


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_connection_gets_added_devices_and_faults(transport: str) -> None:
    server = Server({1: holding(1)})
    with connected(transport, server) as client:
        assert client.read_holding_registers(0, 1) == [1]
        server.replace({1: holding(2), 2: holding(3)})
        until(lambda: client.read_holding_registers(0, 1) == [2])
        assert client.for_unit(2).read_holding_registers(0, 1) == [3]
        server.replace(server.devices, faults={1: [Fault("exception", code=6)]})
        until(lambda: refuses(client))
        assert client.for_unit(2).read_holding_registers(0, 1) == [3]
        server.replace(holding(4))
        until(lambda: not refuses(client))
        assert client.read_holding_registers(0, 1) == [4]
        assert client.for_unit(9).read_holding_registers(0, 1) == [4]
        if transport not in ("udp", "rtu+udp", "rtu", "ascii"):
            assert server.statistics.accepted == 1


def refuses(client: Client) -> bool:
    try:
        client.read_holding_registers(0, 1)
    except ServerDeviceBusy:
        return True
    return False


def test_an_endpoint_that_is_still_looked_up_opens_with_the_new_devices(monkeypatch) -> None:
    server = Server(holding(1))
    bound = udp.bound

    async def slowly(*args: Any) -> Any:
        server.replace(holding(2))
        return await bound(*args)

    monkeypatch.setattr(udp, "bound", slowly)
    with (
        server.background("udp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=20) as client,
    ):
        assert client.read_holding_registers(0, 1) == [2]


def test_replace_sets_the_devices_and_faults_of_a_server() -> None:
    first, fault = holding(1), Fault("no_answer")
    server = Server(first, faults={None: (fault,)})
    assert server.devices is first
    assert server.faults == {None: [fault]}
    devices = {3: holding(2)}
    server.replace(devices)
    assert server.devices is devices
    assert server.faults == {}
    server.replace({})  # every request is answered with exception 11
    assert server.devices == {}


@pytest.mark.parametrize(
    ("devices", "faults", "message"),
    [
        ({2: 5}, None, r"devices\[2\] must be a Device"),
        ({256: holding(1)}, None, r"unit must be in 0..255, not 256"),
        ({2: holding(1)}, None, r"own_unit must be a unit that has a device \(2\), not 1"),
        (holding(1), None, "own_unit cannot be given"),
        ({1: holding(1)}, {1: [5]}, "faults must be"),
        ({1: holding(1)}, {-1: [Fault("no_answer")]}, r"faults: unit must be in 0..255, not -1"),
        ({1: holding(1)}, [], "faults must be"),
    ],
)
def test_a_wrong_replacement_changes_nothing(devices: Any, faults: Any, message: str) -> None:
    before = {1: holding(1)}
    server = Server(before, faults={1: [Fault("exception", code=6, every=2)]}, own_unit=1)
    with server.background("tcp://127.0.0.1:0") as running:
        with pytest.raises((TypeError, ValueError), match=message):
            server.replace(devices, faults=faults)
        assert server.devices is before
        with Client(running.urls[0], unit=1) as client:
            assert client.read_holding_registers(0, 1) == [1]
            assert refuses(client)


def test_the_servers_own_unit_is_that_of_the_new_devices() -> None:
    server = Server({1: holding(1), 2: holding(2)}, own_unit=2)
    with (
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=255) as client,
    ):
        assert client.read_holding_registers(0, 1) == [2]
        server.replace({2: holding(3), 4: holding(4)})
        until(lambda: client.read_holding_registers(0, 1) == [3])
        with pytest.raises(GatewayTargetFailedToRespond):
            client.for_unit(1).read_holding_registers(0, 1)


def test_a_broadcast_goes_to_the_new_devices(lan: Lan) -> None:
    server = Server({1: holding(1), 2: holding(1)})
    line = "rtu:///dev/line"
    with server.background(line), Client(line, unit=1, timeout=50) as client:
        assert client.read_holding_registers(0, 1) == [1]
        server.replace({1: holding(0), 3: holding(0)})
        assert client.read_holding_registers(0, 1) == [0]
        client.for_unit(0).write_register(0, 7)
        assert client.for_unit(3).read_holding_registers(0, 1) == [7]
        with pytest.raises(ModbusTimeoutError):
            client.for_unit(2).read_holding_registers(0, 1)


@pytest.mark.parametrize("transport", ["rtu", "rtu+tcp"])
def test_counters_and_event_log_stay_with_their_unit(transport: str) -> None:
    server = Server({1: holding(1)})
    with connected(transport, server) as client:
        count = client.diagnostics
        for _ in range(3):
            client.read_holding_registers(0, 1)
        assert count(pdu.SubFunction.SERVER_MESSAGE_COUNT) == 4
        server.replace({1: holding(2)})
        until(lambda: client.read_holding_registers(0, 1) == [2])
        assert count(pdu.SubFunction.SERVER_MESSAGE_COUNT) > 5


def test_a_hook_may_replace_the_devices_of_its_server() -> None:
    """In the middle of a chunk: later requests of the chunk use the new devices, in order."""

    def swap(_: object) -> None:
        server.replace({1: holding(9)}, faults={1: [Fault("exception", code=6, function=1)]})

    mapping = Mapping(holding_registers={0: [1, 2]}, coils=1)
    server = Server({1: Device(mapping, before_read=Hook(swap, holding_registers=range(1, 2)))})
    for scheme in ("tcp", "rtu+tcp"):
        server.replace({1: Device(mapping, before_read=Hook(swap, holding_registers=range(1, 2)))})
        with server.background(f"{scheme}://127.0.0.1:0") as running:
            url = running.urls[0]
            with Client(url, unit=1, timeout=5) as client:
                assert client.read_holding_registers(0, 1) == [1]
                assert client.read_holding_registers(1, 1) == [2]
                assert client.read_holding_registers(0, 1) == [9]
                with pytest.raises(ServerDeviceBusy):
                    client.read_coils(0, 1)


def test_devices_are_replaced_repeatedly_while_a_hundred_clients_read(lan: Lan) -> None:
    """Nobody is disconnected, or gets anything but an answer of one of the devices."""
    server = Server({1: holding(0)})
    values: set[int] = set()

    async def poll(url: str, stop: asyncio.Event) -> int:
        count = 0
        async with AsyncClient(url, unit=1, timeout=30) as client:
            while not stop.is_set():
                try:
                    (value,) = await client.read_holding_registers(0, 1)
                    values.add(value)
                except ServerDeviceBusy:
                    pass
                count += 1
        return count

    async def all_of_it(url: str) -> list[int]:
        stop = asyncio.Event()
        polls = [asyncio.create_task(poll(url, stop)) for _ in range(100)]
        for number in range(15):
            faults = {1: [Fault("exception", code=6, every=3)]} if number % 2 else None
            server.replace({1: holding(number)}, faults=faults)  # type: ignore[arg-type]
            await asyncio.sleep(0.001)
        stop.set()
        return await asyncio.gather(*polls)

    with server.background("tcp://10.0.0.1:0") as running:
        counts = lan.wait(all_of_it(running.urls[0]))
        assert min(counts) > 15
        assert server.statistics.accepted == 100
        assert values == set(range(15))
        assert lan.until(lambda: server.statistics.connections == 0)
    gc.collect()
    assert sum(isinstance(get_object, Device) for get_object in gc.get_objects()) < 15


def test_replacing_while_a_server_ends_is_harmless() -> None:
    server = Server(holding(1))
    stop = threading.Event()
    errors: list[BaseException] = []

    def replace() -> None:
        try:
            while not stop.is_set():
                server.replace(holding(2))
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=replace)
    thread.start()
    try:
        for _ in range(20):
            with server.background("tcp://127.0.0.1:0") as running:
                port = int(running.urls[0].rpartition(":")[2])
                socket.create_connection(("127.0.0.1", port), 5).close()
    finally:
        stop.set()
        thread.join()
    assert errors == []
    assert server._answering_now == []


def test_a_fault_may_be_added_for_and_close_a_traced_connection() -> None:
    directions: list[str] = []
    server = Server(holding(1), trace=lambda each: directions.append(each.direction))
    with (
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=5) as client,
    ):
        assert client.read_holding_registers(0, 1) == [1]
        server.replace(holding(2), faults={1: [Fault("disconnect")]})
        with pytest.raises(ModbusConnectionError):
            until(lambda: client.read_holding_registers(0, 1) == [2])
        until(lambda: server.statistics.connections == 0)
    assert directions[:2] == ["received", "sent"]
