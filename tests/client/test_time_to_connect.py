"""
How long connecting may take: as long as those wait who asked for the connection, each with a
timeout of its own.
"""

from __future__ import annotations

import asyncio
import errno
import socket

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError, ModbusTimeoutError, State, pdu
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.clients import Simulated, connecting
from tests.support.peers import dead
from tests.support.reads import good

REQUEST = pdu.ReadHoldingRegisters(5, 1)
HOST = "10.0.0.9"
URL = f"tcp://{HOST}:502"


@pytest.mark.parametrize("own", [0.1, 5.0])
def test_an_attempt_lasts_as_long_as_the_timeout_of_its_request(
    world: Simulated, own: float
) -> None:
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


@pytest.mark.parametrize("timeouts", [(0.3, 5.0), (5.0, 0.3)])
def test_each_that_waits_has_its_own_time(timeouts: tuple[float, float]) -> None:
    network = Network()
    network.unreachable.add(HOST)

    async def main() -> None:
        async with asyncio.timeout(60):
            client = AsyncClient(URL, timeout=20)
            start = asyncio.get_running_loop().time()
            found = await asyncio.gather(*(outcome(client, timeout) for timeout in timeouts))
            assert [(round(at - start, 2), what) for at, what in found] == [
                (timeout, errno.ETIMEDOUT) for timeout in timeouts
            ]
            await client.close()

    network.run(main)


def test_who_has_more_time_than_the_attempt_gets_another() -> None:
    network = Network()
    network.unreachable.add(HOST)
    Scripted(network, URL, good)

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


@pytest.mark.parametrize("pause", [0.0, 30.0])
def test_who_has_too_little_time_for_another_is_told_at_once(pause: float) -> None:
    """The pause before the next attempt is 0.08 s at least, or none."""
    network = Network()
    network.unreachable.add(HOST)

    async def main() -> None:
        async with asyncio.timeout(60):
            client = AsyncClient(URL, timeout=20, max_pause=pause)
            start = asyncio.get_running_loop().time()
            found = await asyncio.gather(outcome(client, 0.3), outcome(client, 0.35))
            assert [what for _, what in found] == [errno.ETIMEDOUT] * 2
            assert found[1][0] - start == pytest.approx(0.3 if pause else 0.35, abs=0.011)
            await client.close()

    network.run(main)


@pytest.mark.parametrize("kind", ["python", "asyncio"])
def test_each_address_of_a_name_gets_a_share_of_the_time_of_the_request(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first is dead; with half of the client's timeout for it no request came to the second."""
    with dead() as port, socket.create_server(("127.0.0.1", 0)) as server:
        found = [
            (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", each))
            for each in (port, server.getsockname()[1])
        ]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
        with connecting(kind) as connect:
            client = connect("tcp://two.invalid", timeout=600)
            with pytest.raises(ModbusTimeoutError):
                client.execute(REQUEST, timeout=1)
            client.close()
