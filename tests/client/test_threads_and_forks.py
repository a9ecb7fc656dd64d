"""
Clients among threads and forks, and what is left of those that nobody closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import gc
import os
import pickle
import resource
import signal
import socket
import sys
import termios
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    ModbusConnectionError,
    RtuContext,
    TcpContext,
    pdu,
)
from tests.support.clients import ALL, BLOCKING, NATIVE, asking, read
from tests.support.peers import FakeServer, FakeUnit, answer, peer_at, until
from tests.support.scripted import run as run_watched


def tcp(request: bytes) -> list[bytes]:
    return [answer(request[at : at + 12], "tcp") for at in range(0, len(request), 12)]


def rtu(request: bytes) -> list[bytes]:
    return [answer(request, "rtu")]


# --- forks ------------------------------------------------------------------------------------


def in_child(act: Callable[[], object], meanwhile: Callable[[], object] = lambda: None) -> int:
    """Fork, do it in the child, and give its exit status: 0, 1 for an error, -14 for a hang."""
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(10)
        try:
            act()
        except BaseException as error:
            print(repr(error), file=sys.stderr)
            os._exit(1)
        os._exit(0)
    meanwhile()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@BLOCKING
def test_a_child_sends_nothing_of_what_its_parent_asks(kind: str) -> None:
    """The fork comes while another thread writes many things one after the other."""
    written: list[bytes] = []
    halfway = threading.Event()

    def slowly(request: bytes) -> Iterator[bytes]:
        if request[7] == 6:
            written.append(request[8:12])
            if len(written) == 5:
                halfway.set()
            time.sleep(0.01)
            yield request
        else:
            yield answer(request, "tcp")

    # Each connection has a thread of its own.
    with Threaded(slowly) as port:
        context = TcpContext("127.0.0.1", port, native=kind == "native")
        requests = [pdu.WriteRegister(address, 1) for address in range(40)]
        writer = threading.Thread(
            target=context.execute_many, args=(requests,), kwargs={"max_in_flight": 1}
        )
        writer.start()
        halfway.wait()

        def read() -> None:
            assert context.read_holding_registers(7, 1) == [7]

        assert in_child(read) == 0
        writer.join()
        assert len(written) == 40
        assert context.read_holding_registers(8, 1) == [8]
        context.close()


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@BLOCKING
def test_a_fork_in_a_hook_leaves_both_with_contexts_that_work(kind: str) -> None:
    statuses: list[int] = []

    def fork(traced: Any) -> None:
        if traced.direction == "sent" and not statuses:
            statuses.append(-1)
            child = os.fork()
            if child == 0:
                return
            statuses[0] = child

    with Threaded(lambda request: [answer(request, "tcp")]) as port:
        context = TcpContext("127.0.0.1", port, native=kind == "native", trace=fork, timeout=2)
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


@NATIVE
def test_a_child_that_asks_and_closes_leaves_its_parent_alone(native: bool) -> None:
    """Both ask at the same time; neither connection nor settings of the port are the child's."""
    with (
        FakeUnit(rtu) as unit,
        RtuContext(unit.path, 9600, native=native) as line,
        Threaded(tcp) as port,
        TcpContext("127.0.0.1", port, native=native) as context,
    ):
        assert context.read_holding_registers(1, 1) == [1]
        assert line.read_holding_registers(1, 1) == [1]
        before = termios.tcgetattr(unit._slave)

        def ask(address: int) -> None:
            for _ in range(50):
                assert context.read_holding_registers(address, 1) == [address]

        def ask_and_close() -> None:
            ask(2)
            context.close()
            line.close()

        assert in_child(ask_and_close, meanwhile=lambda: ask(1)) == 0
        assert termios.tcgetattr(unit._slave) == before
        ask(3)
        assert line.read_holding_registers(3, 1) == [3]
        assert (context.statistics.connects, line.statistics.connects) == (1, 1)


class Threaded:
    """A server with a thread for each connection."""

    def __init__(self, reply: Callable[[bytes], Any]) -> None:
        self._reply = reply
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._accept, daemon=True)

    def __enter__(self) -> int:
        self._thread.start()
        port: int = self._listener.getsockname()[1]
        return port

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                peer, _ = self._listener.accept()
                threading.Thread(target=self._talk, args=(peer,), daemon=True).start()

    def _talk(self, peer: socket.socket) -> None:
        with peer, contextlib.suppress(OSError):
            while request := peer.recv(12):
                for piece in self._reply(request):
                    peer.sendall(piece)


# --- threads and tasks --------------------------------------------------------------------------


@BLOCKING
def test_a_hundred_threads_and_a_close(kind: str) -> None:
    """Each gets its own values until it is told that the client is closed."""
    with Threaded(lambda request: [answer(request, "tcp")]) as port:
        for pause in (0.0, 0.002, 0.03):
            context = TcpContext("127.0.0.1", port, native=kind == "native")
            outcomes: list[object] = []

            def ask(number: int, context: TcpContext = context, told: list[Any] = outcomes) -> None:
                try:
                    for address in range(number, number + 50):
                        assert context.read_holding_registers(address, 1) == [address]
                    told.append(None)
                except BaseException as error:
                    told.append(error)

            workers = [threading.Thread(target=ask, args=(number,)) for number in range(100)]
            for worker in workers:
                worker.start()
            time.sleep(pause)
            context.close()
            for worker in workers:
                worker.join(5)
            assert len(outcomes) == 100
            wrong = [
                each for each in outcomes if each and not isinstance(each, ModbusConnectionError)
            ]
            assert not wrong


# --- the process ----------------------------------------------------------------------------------


@ALL
@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp", "rtu", "ascii"])
def test_descriptors_beyond_1023(scheme: str, kind: str) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2048:
        pytest.skip("this system allows no more descriptors")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    held: list[int] = []
    with peer_at(scheme, lambda request, write: write(answer(request, scheme))) as peer:
        try:
            while not held or held[-1] < 1030:
                held.append(os.dup(0))
            with asking(kind, peer.url) as client:
                assert client._driver._port.descriptor > 1023
                for address in range(3):
                    assert read(client, address) == address
        finally:
            for descriptor in held:
                os.close(descriptor)


@NATIVE
def test_no_descriptor_or_thread_is_left_by_clients_of_any_fate(native: bool) -> None:
    """What is left fails the test: see tests.support.leaks."""
    with FakeServer(tcp) as server, FakeUnit(rtu) as unit:
        TcpContext("127.0.0.1", server.port, native=native)  # never used
        forgotten = TcpContext("127.0.0.1", server.port, native=native)
        assert forgotten.read_holding_registers(1, 1) == [1]
        forgotten_line = RtuContext(unit.path, 115200, native=native)
        assert forgotten_line.read_holding_registers(1, 1) == [1]
        for unreachable in (
            TcpContext("127.0.0.1", 1, native=native),
            RtuContext("/dev/null", native=native),
        ):
            with pytest.raises(ModbusConnectionError):
                unreachable.connect()
        before = len(os.listdir("/proc/self/fd"))
        del forgotten, forgotten_line
        gc.collect()
        assert len(os.listdir("/proc/self/fd")) < before
        until(lambda: not server._peers)


@ALL
def test_clients_can_be_neither_pickled_nor_copied_deeply(kind: str) -> None:
    with FakeServer(tcp) as server, asking(kind, f"tcp://127.0.0.1:{server.port}") as client:
        for spoil in (pickle.dumps, copy.deepcopy):
            with pytest.raises(TypeError):
                spoil(getattr(client, "_plc", client))
        assert read(client, 5) == 5


# --- clients that nobody closed --------------------------------------------------------------


def forget(unit: FakeUnit) -> None:
    async def ask() -> None:
        client = AsyncClient(f"rtu://{unit.path}?baudrate=115200")
        assert await client.read_holding_registers(3, 1) == [3]

    asyncio.run(ask())
    gc.collect()


def test_a_forgotten_client_says_so_and_frees_its_port() -> None:
    with FakeUnit(rtu) as unit:
        for times in range(2):
            with pytest.warns(ResourceWarning, match=unit.path):
                forget(unit)
            with RtuContext(unit.path, 115200) as context:
                assert context.read_holding_registers(times, 1) == [times]


@pytest.mark.filterwarnings("error::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_forgotten_client_frees_its_port_where_warnings_are_errors() -> None:
    with FakeUnit(rtu) as unit:
        forget(unit)
        with RtuContext(unit.path, 115200) as context:
            assert context.read_holding_registers(1, 1) == [1]


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
            asked = asyncio.create_task(client.connect())
            for _ in range(steps):
                await asyncio.sleep(0)
            asked.cancel()
            await asyncio.wait([asked])
            del client, asked
            gc.collect()
        async with AsyncClient(server.url) as last:  # those before it are accepted
            assert await last.read_holding_registers(1, 1) == [1]
        until(lambda: not server._peers)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        with FakeServer(lambda request: [answer(request, "tcp")]) as server, new_garbage_only():
            run_watched(main())
