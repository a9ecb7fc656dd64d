"""Clients among threads and forks, and what is left of those that nobody closed."""

import asyncio
import contextlib
import copy
import gc
import os
import pickle
import resource
import termios
import threading
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, ModbusConnectionError, pdu
from tests.support.clients import ALL, asking, read
from tests.support.peers import LinePeer, TcpPeer, Write, peer_at, until
from tests.support.reads import on_read, on_read_at
from tests.support.scripted import run as run_watched
from tests.support.signals import in_child


def assert_read(client: Any, address: int) -> None:
    """Check that a register has its address as value."""
    assert client.read_holding_registers(address, 1) == [address]


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_child_sends_nothing_of_what_its_parent_asks() -> None:
    """The fork happens while another thread sends many writes one after the other."""
    heads: list[bytes] = []
    halfway = threading.Event()

    def slowly(request: bytes, write: Write) -> None:
        if request[7] == 6:
            heads.append(request[8:12])
            if len(heads) == 5:
                halfway.set()
            write(request, after=0.01)
        else:
            on_read(request, write)

    with TcpPeer(slowly) as peer, asking("blocking", peer.url) as context:
        requests = [pdu.WriteRegister(address, 1) for address in range(40)]
        writer = threading.Thread(target=context.execute_many, args=(requests,))
        writer.start()
        halfway.wait()

        assert in_child(lambda: assert_read(context, 7)) == 0
        writer.join()
        assert len(heads) == 40
        assert_read(context, 8)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_fork_in_a_hook_leaves_both_with_contexts_that_work() -> None:
    statuses: list[int] = []

    def fork(frame: Any) -> None:
        if frame.direction == "sent" and not statuses:
            statuses.append(-1)
            child = os.fork()
            if child == 0:
                return
            statuses[0] = child

    with TcpPeer(on_read) as peer:
        context = Client(peer.url, trace=fork, timeout=2)
        parent = os.getpid()
        try:
            with contextlib.suppress(ModbusConnectionError):
                context.read_holding_registers(1, 1)
            value = context.read_holding_registers(2, 1)
        finally:
            if os.getpid() != parent:
                os._exit(0 if value == [2] else 1)
        assert value == [2]
        assert os.waitstatus_to_exitcode(os.waitpid(statuses[0], 0)[1]) == 0
        context.close()


def test_a_child_that_asks_and_closes_leaves_its_parent_alone() -> None:
    """Both ask at the same time; neither connection nor settings of the port are the child's."""
    with (
        LinePeer(on_read_at("rtu")) as unit,
        Client(f"rtu://{unit.path}", baudrate=9600) as line,
        TcpPeer(on_read) as peer,
        Client(peer.url) as context,
    ):
        assert_read(context, 1)
        assert_read(line, 1)
        before = termios.tcgetattr(unit._slave)

        def ask(address: int) -> None:
            for _ in range(50):
                assert_read(context, address)

        def ask_and_close() -> None:
            ask(2)
            context.close()
            line.close()

        assert in_child(ask_and_close, meanwhile=lambda: ask(1)) == 0
        assert termios.tcgetattr(unit._slave) == before
        ask(3)
        assert_read(line, 3)
        assert (context.statistics.connects, line.statistics.connects) == (1, 1)


def test_a_hundred_threads_get_their_values_until_the_client_is_closed() -> None:
    """Each gets its own values until it is told that the client is closed."""

    def ask(context: Client, number: int) -> None:
        with contextlib.suppress(ModbusConnectionError):
            for address in range(number, number + 50):
                assert_read(context, address)

    with TcpPeer(on_read) as peer, ThreadPoolExecutor(100) as pool:
        for pause in (0.0, 0.002, 0.03):
            context = Client(peer.url)
            futures = [pool.submit(ask, context, number) for number in range(100)]
            time.sleep(pause)
            context.close()
            for future in futures:
                future.result(5)


@ALL
@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp", "rtu", "ascii"])
def test_clients_work_with_descriptors_beyond_1023(scheme: str, kind: str) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2048:
        pytest.skip("this system allows no more descriptors")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    descriptors: list[int] = []
    with peer_at(scheme, on_read_at(scheme)) as peer:
        try:
            while not descriptors or descriptors[-1] < 1030:
                descriptors.append(os.dup(0))
            with asking(kind, peer.url) as client:
                assert client._driver._port.descriptor > 1023
                for address in range(3):
                    assert read(client, address) == address
        finally:
            for descriptor in descriptors:
                os.close(descriptor)


def test_clients_leave_no_descriptor_or_thread_however_they_end() -> None:
    """What is left fails the test: see tests.support.leaks."""
    with TcpPeer(on_read) as server, LinePeer(on_read_at("rtu")) as unit:
        Client(f"tcp://127.0.0.1:{server.port}")  # never used
        forgotten = Client(f"tcp://127.0.0.1:{server.port}")
        assert_read(forgotten, 1)
        forgotten_line = Client(f"rtu://{unit.path}", baudrate=115200)
        assert_read(forgotten_line, 1)
        for unreachable in (Client("tcp://127.0.0.1:1"), Client("rtu:///dev/null")):
            with pytest.raises(ModbusConnectionError):
                unreachable.connect()
        before = len(os.listdir("/proc/self/fd"))
        del forgotten, forgotten_line
        gc.collect()
        assert len(os.listdir("/proc/self/fd")) < before
        until(lambda: not server._peers)


@ALL
def test_clients_can_be_neither_pickled_nor_copied_deeply(kind: str) -> None:
    with TcpPeer(on_read) as peer, asking(kind, peer.url) as client:
        for spoil in (pickle.dumps, copy.deepcopy):
            with pytest.raises(TypeError):
                spoil(getattr(client, "_plc", client))
        assert read(client, 5) == 5


def forget(url: str) -> None:
    async def ask() -> None:
        client = AsyncClient(url)
        assert await client.read_holding_registers(3, 1) == [3]

    asyncio.run(ask())
    gc.collect()


def test_a_client_that_was_not_closed_warns_and_frees_its_port() -> None:
    with LinePeer(on_read_at("rtu")) as unit:
        for times in range(2):
            with pytest.warns(ResourceWarning, match=unit.path):
                forget(unit.url)
            with Client(unit.url) as context:
                assert_read(context, times)


@pytest.mark.filterwarnings("error::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_forgotten_client_frees_its_port_where_warnings_are_errors() -> None:
    with LinePeer(on_read_at("rtu")) as unit:
        forget(unit.url)
        with Client(unit.url) as context:
            assert_read(context, 1)


@contextlib.contextmanager
def new_garbage_only() -> Iterator[None]:
    """Let `gc.collect` look only at what is made meanwhile: 1 ms each time instead of 200."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def test_a_client_forgotten_while_it_connects_leaves_nothing() -> None:
    async def main() -> None:
        for steps in range(6):
            client = AsyncClient(server.url)
            task = asyncio.create_task(client.connect())
            for _ in range(steps):
                await asyncio.sleep(0)
            task.cancel()
            await asyncio.wait([task])
            del client, task
            gc.collect()
        async with AsyncClient(server.url) as last:  # requests before it are accepted
            assert await last.read_holding_registers(1, 1) == [1]
        until(lambda: not server._peers)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        with TcpPeer(on_read) as server, new_garbage_only():
            run_watched(main())
