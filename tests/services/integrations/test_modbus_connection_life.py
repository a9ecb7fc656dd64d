"""Connections of the backend that are lost, cut, cancelled, closed and misused."""

from __future__ import annotations

import asyncio
import functools
import gc
import inspect
import os
import threading
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py.protocol.framing import Frame, make_framer
from tests.support import peers as fake
from tests.support.peers import FakeServer, FakeUnit, LinePeer, mute_port
from tests.support.scripted import Scripted, Write, answer, echo, ignore, run

theirs: Any = pytest.importorskip(
    "modbus_connection", reason="the backend of modbus-connection needs Python 3.12"
)

backend: Any = pytest.importorskip("libmodbus_py.services.integrations.modbus_connection")

LONG, SHORT = 5.0, 0.2


def tcp(port: int, timeout: float = LONG, **times: float) -> Any:
    params = theirs.ModbusTcpParams(host="127.0.0.1", port=port)
    return backend.ModbusConnection(params, timeout=timeout, **times)


def on_line(line: LinePeer) -> Any:
    return backend.ModbusConnection(theirs.ModbusSerialParams(device=line.path), timeout=SHORT)


def read(connection: Any, address: int = 7) -> Any:
    return connection.for_unit(1).read_holding_registers(address, 1)


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(LONG):
        while not condition():
            await asyncio.sleep(0.001)


def served(
    on_request: Callable[[bytes, Write], object] = echo, timeout: float = LONG, **times: float
) -> Callable[[Any], Any]:
    """Let a test have a server and a connection to it, its first arguments."""

    def decorated(test: Any) -> Any:
        @functools.wraps(test)
        def run_it(**others: Any) -> None:
            async def go() -> None:
                async with Scripted(on_request).serving() as server:
                    connection = tcp(server.port, timeout, **times)
                    await test(server, connection, **others)
                    await connection.close()

            run(go())

        _, _, *parameters = inspect.signature(test).parameters.values()
        run_it.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return run_it

    return decorated


def hang_up(server: Scripted) -> Callable[[bytes, Write], object]:
    return lambda request, write: server.drop_all()


@served()
async def test_a_loss_during_a_request_fails_it_and_is_reported_once(
    server: Scripted, connection: Any
) -> None:
    losses: list[bool] = []
    connection.on_connection_lost(lambda: losses.append(connection.connected))
    await read(connection)
    server.on_request = hang_up(server)
    with pytest.raises(theirs.ModbusConnectionError, match=r"^read_holding_registers\(7, 1\)"):
        await read(connection)
    await asyncio.sleep(0)
    assert losses == [False]
    assert len(server.requests) == 2  # none was sent twice
    server.on_request = echo
    assert await read(connection) == [7]
    assert server.connections == 2
    await connection.close()
    await asyncio.sleep(0)
    assert losses == [False]  # closing is not a loss


@served()
async def test_a_loss_of_an_idle_connection_is_reported(server: Scripted, connection: Any) -> None:
    losses: list[None] = []
    connection.on_connection_lost(lambda: losses.append(None))
    await read(connection)
    server.drop_all()
    await until(lambda: losses)
    assert not connection.connected
    assert "connection lost" in connection.last_error


@served()
async def test_on_connection_lost_ends_a_connection_until_the_next_request(
    server: Scripted, connection: Any
) -> None:
    connection._on_connection_lost(None)  # there is none
    await read(connection)
    connection._on_connection_lost(None)
    assert not connection.connected
    assert await read(connection) == [7]
    assert server.connections == 2
    await connection.close()
    connection._on_connection_lost(None)


def test_a_callback_that_raises_has_no_effect_on_others() -> None:
    complaints: list[Any] = []

    async def go() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, error: complaints.append(error))
        async with Scripted(echo).serving() as server:
            connection = tcp(server.port)
            connection.on_connection_lost(lambda: 1 // 0)
            server.on_request = hang_up(server)
            with pytest.raises(theirs.ModbusConnectionError):
                await read(connection)
            server.on_request = echo
            assert await read(connection) == [7]
            await connection.close()

    asyncio.run(go())
    assert [type(complaint["exception"]) for complaint in complaints] == [ZeroDivisionError]


@served(timeout=SHORT)
async def test_a_late_answer_is_not_taken_for_the_next(server: Scripted, connection: Any) -> None:
    requests: list[bytes] = []

    def late(request: bytes, write: Write) -> None:
        requests.append(request)
        for entry in requests if len(requests) > 1 else []:
            write(answer(entry))

    server.on_request = late
    with pytest.raises(theirs.ModbusTimeoutError):
        await read(connection, 1)
    assert await read(connection, 2) == [2]
    assert connection.statistics.late_answers == 1
    assert server.connections == 1


def test_a_late_answer_on_a_line_is_not_taken_for_the_next() -> None:
    def frame(value: int) -> list[bytes]:
        return [make_framer("rtu", "server").encode(Frame(1, bytes([3, 2, 0, value])))]

    async def go() -> None:
        connection = on_line(line)
        assert await read(connection, 9) == [9]
        with pytest.raises(theirs.ModbusTimeoutError):
            await read(connection, 1)
        asking = asyncio.create_task(read(connection, 2))
        await asyncio.sleep(SHORT / 4)
        line.write(*frame(1))
        assert await asking == [2]
        await connection.close()

    with FakeUnit(lambda _: frame(9), lambda _: [], lambda _: frame(2)) as line:
        run(go())


@served()
async def test_one_request_is_in_flight_at_a_time_whoever_asks(server: Scripted, connection: Any):
    open_now: list[bytes] = []
    most = 0

    def slowly(request: bytes, write: Write) -> None:
        nonlocal most
        open_now.append(request)
        most = max(most, len(open_now))

        def done() -> None:
            open_now.remove(request)
            write(answer(request))

        asyncio.get_running_loop().call_later(0.002, done)

    server.on_request = slowly
    values = await asyncio.gather(*(read(connection, number) for number in range(20)))
    assert values == [[number] for number in range(20)]
    assert (most, server.connections) == (1, 1)


@pytest.mark.parametrize("turns", range(12))
@served()
async def test_cancelled_reads_do_not_mix_answers(server: Scripted, connection: Any, turns: int):
    """No lock stays locked, and no connection answers the wrong request."""
    asking = asyncio.create_task(read(connection, 1))
    for _ in range(turns):
        await asyncio.sleep(0)
    asking.cancel()
    await asyncio.wait([asking])
    assert await read(connection, 2) == [2]


@pytest.mark.parametrize("turns", [1, 2, 3, 5, 8])
def test_a_cancelled_connect_leaves_nothing(turns: int) -> None:
    async def go() -> None:
        async with Scripted(echo).serving() as server:
            connecting = asyncio.create_task(
                backend.connect_tcp("127.0.0.1", port=server.port, timeout=LONG)
            )
            for _ in range(turns):
                await asyncio.sleep(0)
            connecting.cancel()
            await asyncio.wait([connecting])
            if not connecting.cancelled():
                await connecting.result().close()
            await until(lambda: server.writers)
            await until(lambda: all(writer.transport.is_closing() for writer in server.writers))

    run(go())


def test_closing_while_it_connects_fails_the_request() -> None:
    async def go() -> None:
        connection = tcp(port, SHORT)
        asking = asyncio.create_task(read(connection))
        await asyncio.sleep(SHORT / 4)
        await connection.close()
        with pytest.raises(theirs.ModbusTimeoutError, match="no connection"):
            await asking
        with pytest.raises(theirs.ClientClosedError, match=r"^read_holding_registers\(7, 1\): "):
            await read(connection)

    with mute_port() as port:
        run(go())


@served(ignore)
async def test_closing_cancels_a_request_without_an_answer(server: Scripted, connection: Any):
    asking = asyncio.create_task(read(connection))
    await until(lambda: server.requests)
    await connection.close()
    with pytest.raises(theirs.ModbusConnectionError):
        await asking


def test_many_reconnections_leave_nothing() -> None:
    @served()
    async def reconnect(server: Scripted, connection: Any) -> None:
        for number in range(60):
            await read(connection)
            if number % 3:
                await connection.disconnect()
            else:
                server.drop_all()
                await until(lambda: not connection.connected)
        assert connection.statistics.connects == 60
        await until(lambda: not connection._later)

    gc.collect()
    files, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    reconnect()
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) <= files
    assert threading.active_count() <= threads


def test_another_event_loop_is_refused_with_the_message_of_modbus_connection() -> None:
    async def go_on() -> None:
        connection = connections.pop()
        with pytest.raises(theirs.ModbusConnectionError, match="another event loop"):
            await read(connection)
        with pytest.raises(theirs.ModbusConnectionError, match="another event loop"):
            await connection.close()

    def in_two_loops() -> None:
        with asyncio.Runner() as first:
            first.run(read(connections[0]))
            asyncio.run(go_on())
            gc.collect()  # while the loop is there, which its timer belongs to

    with FakeServer(lambda request: [fake.echo(request)]) as server:
        connections = [tcp(server.port)]
        with pytest.warns(ResourceWarning, match="was not closed"):
            in_two_loops()


@served(connect_delay=0.05)
async def test_a_loss_while_a_request_waits_is_repaired(server: Scripted, connection: Any) -> None:
    asking = asyncio.create_task(read(connection))
    await until(lambda: server.writers)
    server.drop_all()
    assert await asking == [7]
    assert server.connections == 2


@served()
async def test_units_0_and_255_are_asked_over_tcp(server: Scripted, connection: Any) -> None:
    for unit in (0, 255):
        assert await connection.for_unit(unit).read_holding_registers(7, 1) == [7]
    assert [request[6] for request in server.requests] == [0, 255]


def test_unit_0_of_a_line_is_a_broadcast() -> None:
    async def go() -> None:
        connection = on_line(line)
        await connection.for_unit(0).write_register(1, 2)
        with pytest.raises(ValueError, match="broadcast"):
            await connection.for_unit(0).read_holding_registers(1, 1)
        await connection.close()

    with FakeUnit(lambda request: []) as line:
        run(go())
    assert len(line.requests) == 1


@served(echo, SHORT)
async def test_a_longer_timeout_gets_a_new_connection(server: Scripted, connection: Any) -> None:
    unit = connection.for_unit(1)
    await read(connection)
    unit.require_timeout(LONG)
    await until(lambda: not connection.connected)
    await read(connection)
    assert connection._client.timeout == LONG
    unit.require_timeout(None)
    unit.require_connect_delay(0)
    unit.set_message_spacing(0.001)
    assert await read(connection) == [7]
    await unit.disconnect()
    assert not unit.connected
    assert connection.last_error == ""
    assert connection.statistics.connects == 2


def test_a_unit_with_doubt_delays_no_other_unit() -> None:
    units: list[int] = []

    def answer_for_2(request: bytes, write: fake.Write) -> None:
        units.append(request[0])
        if request[0] == 2:
            write(fake.answer(request, "rtu"))

    async def go() -> None:
        with LinePeer(answer_for_2) as line:
            connection = on_line(line)
            with pytest.raises(theirs.ModbusTimeoutError):
                await read(connection)
            again = asyncio.create_task(read(connection))
            await asyncio.sleep(0)
            assert await connection.for_unit(2).read_holding_registers(7, 1) == [7]
            assert units == [1, 2]
            with pytest.raises(theirs.ModbusTimeoutError):
                await again
            await connection.close()

    run(go())
