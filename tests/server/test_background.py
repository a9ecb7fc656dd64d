"""
A server in a thread: Ctrl-C at any moment while it starts, serves or ends leaves nothing, and
hooks that end the program end the server.
"""

import asyncio
import contextlib
import dis
import gc
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from libmodbus_py import Access, Device, Mapping, Server
from libmodbus_py.binding.library import replier
from libmodbus_py.serve import Running
from tests.support.attacks import PATIENCE, READ_ONE, adu, ask, connect, receive

URLS = ("tcp://127.0.0.1:0", "udp://127.0.0.1:0")


# After these the interpreter looks for signals, and after no others.
LOOKS = ("RESUME", "CALL", "CALL_KW", "CALL_FUNCTION_EX", "JUMP_BACKWARD", "POP_JUMP_BACKWARD")


class Interrupting:
    """Raises KeyboardInterrupt at one of all the moments when the main thread may get it."""

    def __init__(self, at: int) -> None:
        self.steps = 0
        self._at = at
        self._latest: dict[int, str] = {}

    def __call__(self, frame: FrameType, event: str, _: object) -> Any:
        frame.f_trace_opcodes = True
        if event == "opcode":
            before = self._latest.get(id(frame), "")
            self._latest[id(frame)] = dis.opname[frame.f_code.co_code[frame.f_lasti]]
            if before.startswith(LOOKS):
                self.steps += 1
                if self.steps == self._at:
                    raise KeyboardInterrupt
        elif event == "return":
            self._latest.pop(id(frame), None)
        return self


def steps_of(server: Server, at: int) -> int:
    """Start and stop a server; give how many steps that took."""
    interrupting = Interrupting(at)
    sys.settrace(interrupting)
    try:
        with server.background(*URLS):
            pass
    finally:
        sys.settrace(None)
    return interrupting.steps


def left() -> tuple[int, int]:
    """Threads and descriptors of this process."""
    return len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))


def is_left(counts: tuple[int, int]) -> bool:
    """Return True if there are no more soon: the system takes a moment to end a thread."""
    deadline = time.monotonic() + PATIENCE
    while left() > counts:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.002)
    return True


def test_ctrl_c_at_any_step_leaves_nothing() -> None:
    """In a process of its own, because modules of others, such as logging, are hit, too."""
    code = "from tests.server.test_background import interrupt_each_step; interrupt_each_step()"
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", code]
    process = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=100)
    assert process.returncode == 0, process.stderr


def interrupt_each_step() -> None:
    server = Server(Device(Mapping()))
    with server.background(*URLS):
        pass
    before = left()
    total = steps_of(server, at=-1)
    assert total > 20
    gc.collect()
    for at in range(1, total + 1):
        with contextlib.suppress(KeyboardInterrupt):
            steps_of(server, at)
        assert is_left(before), f"after step {at} of {total}"


CTRL_C = """
import os, signal, sys, threading, time
from libmodbus_py import Device, Mapping, Server

def ring(*_):
    if rings:
        rings.pop()
        raise KeyboardInterrupt

rings = []
signal.signal(signal.SIGALRM, ring)
server = Server(Device(Mapping()))
with server.background("tcp://127.0.0.1:0", "udp://127.0.0.1:0"):
    pass
before = len(os.listdir("/proc/self/fd"))
raised = 0
for number in range(400):
    rings = [None] * (1 + number % 2)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, 1e-5 + number // 2 * 2e-5, 1e-4)
            with server.background("tcp://127.0.0.1:0", "udp://127.0.0.1:0"):
                time.sleep(0.01)
        finally:
            rings.clear()
    except KeyboardInterrupt:
        raised += 1
    signal.setitimer(signal.ITIMER_REAL, 0)
deadline = time.monotonic() + 10
while threading.active_count() > 1 and time.monotonic() < deadline:
    time.sleep(0.01)
print(raised, threading.active_count(), len(os.listdir("/proc/self/fd")) - before)
"""


def test_ctrl_c_once_or_twice_leaves_nothing() -> None:
    process = subprocess.run([sys.executable, "-c", CTRL_C], capture_output=True, text=True)
    assert process.stdout == "400 1 0\n", process.stderr


NEVER_LEFT = """
from libmodbus_py import Device, Mapping, Server
manager = Server(Device(Mapping())).background("tcp://127.0.0.1:0")
manager.__enter__()
"""


def test_a_program_ends_although_a_block_of_its_server_is_open() -> None:
    command = [sys.executable, "-c", NEVER_LEFT]
    process = subprocess.run(command, capture_output=True, timeout=PATIENCE)
    assert (process.returncode, process.stderr) == (0, b"")


def test_the_garbage_collector_does_not_wait_for_a_forgotten_server() -> None:
    """The server may wait for a lock, such as a mapping's, that the collector's thread holds."""
    is_blocked, goes_on = threading.Event(), threading.Event()
    results: list[bool] = []

    def hook(access: Access) -> None:
        is_blocked.set()
        results.append(goes_on.wait(PATIENCE))

    before = left()
    server = Server(Device(Mapping(holding_registers=1), before_read=hook))
    circle: list[Any] = [server.background("tcp://127.0.0.1:0")]
    circle.append(circle)
    with connect(circle[0].__enter__().urls[0]) as client:
        client.sendall(adu(READ_ONE))
        assert is_blocked.wait(PATIENCE)
        del circle
        gc.collect()
        goes_on.set()
        assert receive(client, 11) == ANSWER
        assert receive(client, 1) == b""
    assert results == [True]
    assert is_left(before)


def test_two_threads_may_leave_the_block_at_once() -> None:
    before = left()
    background = Server(Device(Mapping())).background(*URLS)
    background.__enter__()
    threads = [threading.Thread(target=background.__exit__) for _ in range(2)]
    for thread in threads:
        thread.start()
    background.__exit__()
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()
    assert is_left(before)


@pytest.mark.parametrize("where", ["_thread.start_new_thread", "threading.Thread.start"])
def test_a_system_without_threads_is_an_error(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    before = left()
    background = Server(Device(Mapping())).background(*URLS)
    with monkeypatch.context() as patched:
        patched.setattr(where, refuse)
        with pytest.raises(RuntimeError, match="can't start new thread"):
            background.__enter__()
    with pytest.raises(RuntimeError, match="call background"):
        background.__enter__()
    assert is_left(before)


ENDS = [SystemExit(3), KeyboardInterrupt()]


def ending(error: BaseException) -> Server:
    """Return a server that ends the program when register 99 is read."""

    def hook(access: Access) -> None:
        if access.address == 99:
            raise error

    return Server(Device(Mapping(holding_registers=100), before_read=hook))


@contextlib.contextmanager
def raised(error: BaseException) -> Iterator[None]:
    with pytest.raises(type(error)) as caught:
        yield
    assert caught.value is error


END = adu(bytes.fromhex("03 0063 0001"))
ANSWER = adu(bytes.fromhex("03 02 0000"))


@pytest.mark.parametrize("error", ENDS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("scheme", ["tcp", "udp"])
def test_an_error_that_ends_the_program_is_raised_at_the_end_of_the_block(scheme, error) -> None:
    before = left()
    with raised(error), ending(error).background(*URLS) as running:
        end(running, scheme)
    assert is_left(before)


def end(running: Running, scheme: str) -> None:
    url = next(url for url in running.urls if url.startswith(scheme))
    with connect(running.urls[0]) as other:
        with connect(url) as client:
            client.sendall(END)
            if client.type == socket.SOCK_STREAM:
                assert receive(client, 1) == b""  # without an answer
        assert receive(other, 1) == b""  # it is closed, too


@pytest.mark.parametrize("error", ENDS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("scheme", ["tcp", "udp"])
def test_serve_forever_and_serving_raise_program_ends(scheme: str, error: BaseException) -> None:
    def serve_forever(server: Server, on_listening: Callable[[Running], object]) -> None:
        server.serve_forever(*URLS, on_listening=on_listening)

    def serving(server: Server, on_listening: Callable[[Running], object]) -> None:
        async def serve() -> None:
            async with server.serving(*URLS) as running:
                on_listening(running)
                await asyncio.sleep(PATIENCE)

        asyncio.run(serve())

    replier()  # this thread keeps its descriptors
    for way in (serve_forever, serving):
        before = left()
        asking: list[threading.Thread] = []

        def start(running: Running, asking: list[threading.Thread] = asking) -> None:
            asking.append(threading.Thread(target=end, args=(running, scheme)))
            asking[0].start()

        with raised(error):
            way(ending(error), start)
        asking[0].join(PATIENCE)
        assert is_left(before)


def test_requests_before_the_end_of_the_program_are_answered() -> None:
    """The requests arrive in the same bytes."""
    error = SystemExit(3)
    server = ending(error)
    with raised(error), server.background(*URLS) as running, connect(running.urls[0]) as client:
        client.sendall(adu(READ_ONE) + END)
        assert receive(client, 100) == ANSWER
    assert server.statistics.requests >= 1


def test_a_hook_may_end_the_block() -> None:
    before = left()
    errors: list[BaseException] = []

    def leave(access: Access) -> None:
        try:
            background.__exit__()
        except BaseException as error:
            errors.append(error)

    server = Server(Device(Mapping(holding_registers=1), before_read=leave))
    background = server.background("tcp://127.0.0.1:0")
    with background as running, connect(running.urls[0]) as client:
        ask(client, adu(READ_ONE), ANSWER)
        assert receive(client, 1) == b""
    assert errors == []
    assert is_left(before)


@pytest.mark.parametrize("error", ENDS, ids=lambda error: type(error).__name__)
def test_clients_read_in_one_turn_are_answered(error: BaseException) -> None:
    """The server is kept busy until all have asked."""
    is_blocked, goes_on = threading.Event(), threading.Event()

    def hook(access: Access) -> None:
        if access.address == 0:
            is_blocked.set()
            assert goes_on.wait(PATIENCE)
        elif access.address == 99:
            raise error

    server = Server(Device(Mapping(holding_registers=100), before_read=hook))
    with raised(error), server.background("tcp://127.0.0.1:0") as running:
        clients = [connect(running.urls[0]) for _ in range(8)]
        blocker = clients.pop()
        blocker.sendall(adu(READ_ONE))
        assert is_blocked.wait(PATIENCE)
        for number, client in enumerate(clients):
            client.sendall(END if number % 3 == 1 else adu(bytes.fromhex("03 0001 0001")))
        goes_on.set()
        answers = [receive(client, 11) for client in clients]
        for client in (blocker, *clients):
            client.close()
    assert answers == [b"" if number % 3 == 1 else ANSWER for number in range(7)]
