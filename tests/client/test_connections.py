"""Connections that cannot be made, that die, that end, and those that are made in their place."""

import asyncio
import contextlib
import errno
import os
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
    State,
    pdu,
)
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.clients import ALL, Connect, World, connecting, read
from tests.support.peers import answer, ignore, mute_port, peer_at, refusing, until, url_of
from tests.support.reads import on_read

REQUEST = pdu.ReadHoldingRegisters(5, 1)

NOBODY = "tcp://10.0.0.9:502"


@pytest.mark.parametrize(
    ("host", "number"),
    [("no-such-host.invalid", None), ("x" * 300, None), ("255.255.255.255", errno.EACCES)],
)
def test_connection_error_says_why(connect: Connect, host: str, number: int | None) -> None:
    with pytest.raises(ModbusConnectionError) as caught:
        connect(f"tcp://{host}", timeout=60).read_coils(0, 1)
    assert caught.value.__cause__ is not None
    assert number is None or caught.value.errno in (number, errno.ENETUNREACH)
    assert host[:20] in str(caught.value)


@ALL
def test_a_refused_connection_on_the_real_system(kind: str) -> None:
    with refusing() as port, connecting_to(kind, url_of(port), max_pause=30) as plc:
        with pytest.raises(ModbusConnectionError) as caught:
            plc.execute(REQUEST)
        assert caught.value.errno == errno.ECONNREFUSED
        assert caught.value.__cause__ is not None


@contextlib.contextmanager
def connecting_to(kind: str, url: str, **options: Any) -> Iterator[Any]:
    """Yield a client that is not connected yet."""
    with connecting(kind) as connect:
        plc = connect(url, **options)
        yield plc
        plc.close()


@pytest.mark.parametrize("max_pause", [0, 10])
def test_request_waits_for_the_next_attempt_if_it_has_time(world: World, max_pause: float) -> None:
    plc = world.connect(NOBODY, timeout=1, max_pause=max_pause)
    with pytest.raises(ModbusConnectionError):
        plc.connect()
    Scripted(world.network, NOBODY, on_read)
    before = world.now
    assert plc.execute(REQUEST) == [5]
    waited = world.now - before
    assert 0.08 <= waited <= 0.122 if max_pause else waited <= 0.002
    assert (plc.statistics.failed_connects, plc.statistics.connects) == (1, 1)
    plc.close()


@pytest.mark.parametrize("retries", [0, 3])
def test_a_server_that_closes_each_connection_is_reported_soon(world: World, retries: int) -> None:
    peer = world.peer("tcp", lambda request, write: write(None))
    with (
        world.connect(peer.url, timeout=60, retries=retries, max_pause=0.5) as client,
        # Before each repetition is a pause.
        world.lasting(0.0, more=3 * (1 + retries) * 0.7),
    ):
        for _ in range(3):
            with pytest.raises(ModbusError):
                read(client, 1)


def test_a_server_that_closes_each_connection_is_not_asked_without_pauses(world: World) -> None:
    """Pauses of 0.1, 0.2, 0.4 ... 25.6 s, by chance a fifth shorter or longer."""
    peer = world.peer("tcp", lambda request, write: write(None))
    with world.connect(peer.url, timeout=0.2, max_pause=30) as plc:
        for seconds, most in ((60.0, 12), (600.0, 40)):
            end = world.now + seconds
            while world.now < end:
                with pytest.raises((ModbusConnectionError, ModbusTimeoutError)):
                    plc.execute(REQUEST)
                world.sleep(0.5)
            assert peer.connections <= most


def test_a_new_request_replaces_a_connection_that_ended(world: World) -> None:
    """At once, before the client has read of the end, and later."""
    peer = world.peer("tcp", on_read)
    with world.connect(peer.url, max_pause=0) as plc:
        for number in range(1, 4):
            assert plc.execute(REQUEST) == [5]
            peer.drop_all()
            if number == 2:
                world.sleep(0.02)
        assert peer.connections == 3
        assert plc.statistics.lost >= 2


@pytest.mark.parametrize("keepalive", [45, None])
def test_options_of_the_socket_are_set(connect: Connect, keepalive: int | None) -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        connect(url_of(listener), keepalive=keepalive) as plc,
    ):
        descriptor = os.dup(plc._driver._port.descriptor)
        with socket.socket(fileno=descriptor) as connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            probes = connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            assert probes == (keepalive is not None)
            if keepalive:
                idle = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE)
                assert idle == keepalive


def test_an_unplugged_port_is_a_connection_error_and_is_opened_again(world: World) -> None:
    unit = world.peer("rtu", lambda request, write: write(answer(request, "rtu")))
    line = world.network.line("/dev/line")
    plc = world.connect(unit.url, timeout=5, max_pause=0)
    with plc:
        assert read(plc, 5) == 5
        unit.on_request = lambda request, write: line.unplug()
        with world.lasting(0.0, more=0.01), pytest.raises(ModbusConnectionError) as caught:
            read(plc, 6)
        assert caught.value.errno == errno.EIO
        with world.lasting(0.0), pytest.raises(ModbusConnectionError) as caught:
            read(plc, 7)
        assert caught.value.errno == errno.ENOENT
        line.is_unplugged = False
        unit.on_request = lambda request, write: write(answer(request, "rtu"))
        # The unit is on the other side of the port: it may still answer, so it is silent at first.
        with world.lasting(0.0, more=0.1):
            assert read(plc, 8) == 8


@ALL
def test_a_port_unplugged_on_the_real_system_is_an_error(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "port"
    device = Device(Mapping(holding_registers=8))
    with connecting_to(kind, f"rtu://{path}?baudrate=115200", timeout=60, max_pause=0) as plc:
        with SerialWire() as wire, ThreadPoolExecutor(1) as pool:
            path.symlink_to(wire.client)
            future = pool.submit(plc.execute, REQUEST)
            until(lambda: wire.passed)
            path.unlink()  # first, as the number of a pseudo-terminal is given again at once
            wire.unplug()
            with pytest.raises(ModbusConnectionError) as caught:
                future.result()
            assert caught.value.errno == errno.EIO
        with pytest.raises(ModbusConnectionError):
            plc.execute(REQUEST)
        with SerialWire() as wire, Server(device).background(f"rtu://{wire.server}"):
            path.symlink_to(wire.client)
            assert plc.for_unit(2).execute(REQUEST) == [0]


def test_handles_of_several_units_share_the_connection(world: World) -> None:
    """Unit 0 over TCP is a unit like others."""
    peer = world.peer("tcp", on_read)
    with world.connect(peer.url, unit=0) as plc:
        handles = [plc, plc.for_unit(9), plc.for_unit(255)]
        assert [handle.read_holding_registers(7, 1) for handle in handles] == [[7]] * 3
        assert [request[6] for request in peer.requests] == [0, 9, 255]
        assert peer.connections == 1
        assert handles[1].statistics is plc.statistics
        handles[1].close()
        assert plc.closed


def test_close_is_idempotent_and_final(world: World) -> None:
    plc = world.client_of("tcp", on_read)
    assert not plc.closed
    plc.execute(REQUEST)
    plc.close()
    plc.close()
    assert plc.closed
    for ask in (plc.connect, lambda: plc.execute(REQUEST)):
        with pytest.raises(ModbusConnectionError, match="closed"):
            ask()
    outcomes = plc.execute_many([REQUEST] * 3, return_exceptions=True)
    assert [type(outcome) for outcome in outcomes] == [ModbusConnectionError] * 3


@pytest.fixture(params=["an answer", "a connection", "a pause"])
def somebody_waits(request: pytest.FixtureRequest, connect: Connect) -> Iterator[Any]:
    """A client, and a thread or task whose request lasts longer than a test may."""
    with contextlib.ExitStack() as stack:
        if request.param == "a connection":
            plc = connect(f"tcp://127.0.0.1:{stack.enter_context(mute_port())}", timeout=600)
        elif request.param == "an answer":
            plc = connect(stack.enter_context(peer_at("tcp", ignore)).url, timeout=600)
        else:
            port = stack.enter_context(refusing())
            plc = connect(url_of(port), timeout=6000, max_pause=1000)
            while plc.statistics.failed_connects < 14:  # the next pause is 800 s
                plc._driver._life.connecting()
                plc._driver._connection.failed(ModbusConnectionError("refused"), time.monotonic())
        yield plc
        plc.close()


def test_close_ends_what_others_wait_for(somebody_waits: Any) -> None:
    plc = somebody_waits
    with ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(plc.execute, REQUEST), pool.submit(plc.execute_many, [REQUEST] * 50)]
        until(lambda: plc._driver._connection.is_wanted or plc.statistics.requests)
        plc.close()
        for future in futures:
            with pytest.raises(ModbusConnectionError):
                future.result()


HOST = "10.0.0.9"
URL = f"tcp://{HOST}:502"


@pytest.mark.parametrize("own", [0.1, 5.0])
def test_an_attempt_lasts_as_long_as_the_timeout_of_its_request(world: World, own: float) -> None:
    """Or of its handle, but not as that of the client."""
    world.network.unreachable.add(HOST)
    plc = world.connect(URL, timeout=1)
    handle = plc.for_unit(3, timeout=own)
    for ask in (lambda: plc.execute(REQUEST, timeout=own), lambda: handle.execute(REQUEST)):
        with world.lasting(own), pytest.raises(ModbusConnectionError) as caught:
            ask()
        assert caught.value.errno == errno.ETIMEDOUT
        world.sleep(0.01)
        assert plc.state is State.DISCONNECTED
    assert plc.statistics.failed_connects == 2
    plc.close()


async def outcome(client: AsyncClient, timeout: float) -> tuple[float, object]:
    """Return what a request with this timeout gets, and when."""
    try:
        result: object = await client.execute(REQUEST, timeout=timeout)
    except ModbusConnectionError as error:
        result = error.errno
    return round(asyncio.get_running_loop().time(), 2), result


def test_a_request_with_more_time_gets_another_attempt() -> None:
    network = Network()
    network.unreachable.add(HOST)
    Scripted(network, URL, on_read)

    async def main() -> None:
        async with asyncio.timeout(60):
            client = AsyncClient(URL, timeout=20)
            asking = [asyncio.create_task(outcome(client, timeout)) for timeout in (0.3, 5.0)]
            await asyncio.sleep(0.35)
            network.unreachable.clear()  # after the first attempt, and before the second
            (_, short), (_, long) = await asyncio.gather(*asking)
            assert (short, long) == (errno.ETIMEDOUT, [5])
            assert client.statistics.failed_connects == 1
            await client.close()

    network.run(main)
