"""How long things take: time-outs, pauses, repetitions, broadcasts."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import pytest

from libmodbus_py import AsyncClient, Client, ModbusConnectionError, ModbusTimeoutError, State, pdu
from libmodbus_py.client.sender import Sender
from tests.simulation.scripted import Scripted
from tests.support.clients import ALL, World, asking, read
from tests.support.in_loops import run_client
from tests.support.peers import Write, answering, echo, ignore, mute_port, peer_at, until
from tests.support.reads import on_read
from tests.support.urls import CONNECTING

REQUEST = pdu.ReadHoldingRegisters(5, 1)

# What the bytes of a request and its answer take on a line, and silences.
ON_LINE = 0.01


def echoing(request: bytes) -> list[bytes]:
    return [echo(request)]


def silent(request: bytes) -> list[bytes]:
    return []


def test_timeouts_of_the_client_and_the_handle_and_the_request_apply(world: World) -> None:
    with world.client_of("tcp", answering(echoing, silent), timeout=30) as plc:
        assert plc.execute(REQUEST) == [5]
        plc.timeout = 0.2
        for ask, timeout in (
            (lambda: plc.execute(REQUEST), 0.2),
            (lambda: plc.for_unit(3, timeout=0.1).execute(REQUEST), 0.1),
            (lambda: plc.execute(REQUEST, timeout=0.05), 0.05),
        ):
            with (
                world.lasting(timeout),
                pytest.raises(ModbusTimeoutError, match=f"within {timeout} s"),
            ):
                ask()
        plc.timeout = 0.07
        assert plc.for_unit(3).timeout == 0.07
        with world.lasting(0.07), pytest.raises(ModbusTimeoutError, match=r"within 0.07 s"):
            plc.execute(REQUEST)


def test_handles_with_their_own_timeouts_share_a_connection(world: World) -> None:
    def two_units(request: bytes, write: Write) -> None:
        if request[6] == 1:
            write(echo(request))

    peer = world.peer("tcp", two_units)
    with world.connect(peer.url, timeout=20, timeouts_before_reconnect=1000) as client:
        quick = client.for_unit(2, timeout=0.05, retries=1)
        for address in range(4):
            with world.lasting(0.0):
                assert read(client, address) == address
            with world.lasting(2 * 0.05), pytest.raises(ModbusTimeoutError):
                read(quick, address)
        assert peer.connections == 1


def test_spacing_and_delay_are_kept(world: World) -> None:
    peer = world.peer("tcp", answering(echoing))
    options = {"request_spacing": 0.03, "connect_delay": 0.1, "timeout": 0.09}
    with world.connect(peer.url, **options) as plc:
        connected = world.now
        assert plc.execute_many([REQUEST] * 4) == [[5]] * 4
        assert plc.execute(REQUEST) == [5]
    assert peer.times[0] - connected == pytest.approx(0.1, abs=0.002)
    gaps = [later - earlier for earlier, later in pairwise(peer.times)]
    assert gaps == pytest.approx([0.03] * 4, abs=0.0015)
    assert min(gaps) >= 0.03 - 1e-6


def test_broadcast_waits_for_no_answer_and_reads_are_refused(world: World) -> None:
    unit = world.peer("rtu", ignore)
    url = f"{unit.url}&timeout=10&turnaround=0.05&unit=0"
    with world.connect(url) as everyone:
        with world.lasting(2 * 0.05, more=ON_LINE):
            everyone.write_register(1, 2)
            everyone.write_coils(1, [True])
        with pytest.raises(ValueError, match="broadcast"):
            everyone.read_coils(0, 1)
    assert unit.requests[0][:6] == bytes.fromhex("000600010002")


UNITS = [
    (300, ValueError),
    (256, ValueError),
    (-1, ValueError),
    (1.5, TypeError),
    (None, TypeError),
]


@ALL
@pytest.mark.parametrize(("unit", "error"), UNITS)
def test_setting_a_unit_that_does_not_exist_is_refused(kind: str, unit, error) -> None:
    with peer_at("tcp", on_read) as peer, asking(kind, peer.url) as client:
        with pytest.raises(error, match=r"unit must be .*0\.\.255"):
            client.unit = unit
        assert client.read_holding_registers(7, 1) == [7]
        assert [request[6] for request in peer.requests] == [1]


@pytest.mark.parametrize(("unit", "error"), UNITS)
def test_submitting_to_a_unit_that_does_not_exist_is_refused(unit, error) -> None:
    async def use(plc: AsyncClient, _: Scripted) -> None:
        task = asyncio.create_task(plc.read_holding_registers(7, 1))
        await asyncio.sleep(0)
        with pytest.raises(error, match=r"unit must be .*0\.\.255"):
            Sender(plc).submit(unit, pdu.ReadHoldingRegisters(1, 1), lambda: None)
        assert await task == [7]

    run_client(on_read, use)


class Silent(pdu.WriteRegister):
    """A write of a function that libmodbus knows, which the device is known not to answer."""

    __slots__ = ()
    expects_response = False


def test_a_request_without_an_answer_is_not_waited_for(world: World) -> None:
    peer = world.peer("tcp", lambda request, write: request[7] != 6 and on_read(request, write))
    with world.connect(peer.url, timeout=600) as client:
        assert client.read_holding_registers(1, 1) == [1]
        assert client.execute(Silent(3, 4)) is None
        assert client.read_holding_registers(2, 1) == [2]
        assert client.statistics.results[6, "silent"] == 1


@pytest.mark.parametrize("scheme", CONNECTING)
def test_a_shorter_timeout_of_another_thread_ends_the_wait(scheme: str) -> None:
    with (
        peer_at(scheme, ignore) as peer,
        asking("blocking", peer.url, timeout=600) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        future = pool.submit(client.read_holding_registers, 1, 1)
        until(lambda: peer.requests)
        client.timeout = 0.05
        with pytest.raises(ModbusTimeoutError, match=r"within 0\.05 s"):
            future.result()


def test_a_shorter_timeout_of_another_thread_ends_an_attempt_to_connect() -> None:
    with mute_port() as port, ThreadPoolExecutor(1) as pool:
        client = Client(f"tcp://127.0.0.1:{port}", timeout=600)
        future = pool.submit(client.connect)
        until(lambda: client.state is State.CONNECTING)
        client.timeout = 0.05
        with pytest.raises(ModbusConnectionError):
            future.result()
        client.close()


def test_a_timeout_set_again_and_again_disturbs_no_request() -> None:
    with peer_at("tcp", on_read) as peer, asking("blocking", peer.url, timeout=600) as client:
        over = threading.Event()

        def change() -> None:
            while not over.is_set():
                client.timeout = 600.0

        thread = threading.Thread(target=change)
        thread.start()
        try:
            for address in range(300):
                assert client.read_holding_registers(address, 1) == [address]
        finally:
            over.set()
            thread.join()
        assert client.statistics.connects == 1
