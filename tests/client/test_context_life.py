"""
Contexts over their life: arguments, connecting, threads, forks, many descriptors, closing.
"""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import signal
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from libmodbus_py import (
    AsciiContext,
    Context,
    Device,
    Mapping,
    ModbusError,
    RtuContext,
    Server,
    TcpContext,
)
from tests.support.collecting import new_garbage_only
from tests.support.peers import FakeServer, FakeUnit, mbap, until

NATIVE = pytest.mark.parametrize("native", [True, False])


@pytest.fixture
def port(device: Device) -> Iterator[int]:
    with Server(device).background("tcp://127.0.0.1:0") as running:
        yield int(running.urls[0].rpartition(":")[2])


def echo_address(request: bytes) -> list[bytes]:
    return [mbap(request, b"\x03\x02" + request[8:10])]


# --- arguments -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: TcpContext(""), "host"),
        (lambda: TcpContext(None), "host"),  # type: ignore[arg-type]
        (lambda: TcpContext("a\0b"), "host"),
        (lambda: TcpContext("127.0.0.1", 0), "port"),
        (lambda: TcpContext("127.0.0.1", 65536), "port"),
        (lambda: TcpContext("127.0.0.1", "502"), "port"),  # type: ignore[arg-type]
        (lambda: TcpContext("127.0.0.1", framing="mbap"), "framing"),  # type: ignore[arg-type]
        (lambda: RtuContext(""), "device"),
        (lambda: RtuContext(3), "device"),  # type: ignore[arg-type]
        (lambda: RtuContext("/dev/x", 0), "baudrate"),
        (lambda: RtuContext("/dev/x", 9600.5), "baudrate"),  # type: ignore[arg-type]
        (lambda: RtuContext("/dev/x", parity="x"), "parity"),  # type: ignore[arg-type]
        (lambda: RtuContext("/dev/x", data_bits=9), "data_bits"),
        (lambda: RtuContext("/dev/x", stop_bits=3), "stop_bits"),
        (lambda: RtuContext("/dev/x", rs485="yes"), "rs485"),  # type: ignore[arg-type]
        (lambda: AsciiContext("/dev/x", rts_delay=-1), "rts_delay"),
    ],
)
def test_bad_argument_is_named(make, named) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises((ValueError, TypeError), match=named):
        make()


# --- connecting --------------------------------------------------------------------------


def refused_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


# --- threads, forks, descriptors -----------------------------------------------------------


@NATIVE
def test_threads_share_a_context(native: bool) -> None:
    with (
        FakeServer(echo_address) as server,
        TcpContext("127.0.0.1", server.port, native=native) as context,
        ThreadPoolExecutor(4) as pool,
    ):

        def ask(address: int) -> bool:
            return context.read_holding_registers(address, 1) == [address]

        assert all(pool.map(ask, range(500)))


@NATIVE
def test_fork_leaves_the_parent_alone_and_the_child_connects_anew(native: bool) -> None:
    with (
        FakeUnit() as unit,
        RtuContext(unit.path, 9600) as serial,
        Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], native=native) as context,
    ):
        assert context.read_holding_registers(0, 2) == [0, 0]
        before = termios.tcgetattr(unit._slave)
        child = os.fork()
        if child == 0:
            code = 1
            try:
                context.close()
                serial.close()
                with Context.from_url(running.urls[0]) as own:
                    code = own.read_holding_registers(0, 2) != [0, 0]
            finally:
                os._exit(code)
        assert os.waitpid(child, 0)[1] == 0
        assert termios.tcgetattr(unit._slave) == before
        assert context.read_holding_registers(0, 2) == [0, 0]
        assert context.late_answers == 0


def test_context_used_in_the_child_does_not_disturb_the_parent(port: int) -> None:
    with TcpContext("127.0.0.1", port) as context:
        assert context.read_holding_registers(100, 1) == [1000]
        child = os.fork()
        if child == 0:
            code = 1
            try:
                code = any(context.read_holding_registers(101, 1) != [1001] for _ in range(50))
            finally:
                os._exit(code)
        for _ in range(50):
            assert context.read_holding_registers(100, 1) == [1000]
        assert os.waitpid(child, 0)[1] == 0


MANY_DESCRIPTORS = """
import os, resource, sys
from libmodbus_py import *
resource.setrlimit(resource.RLIMIT_NOFILE, (4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
taken = [os.open("/dev/null", os.O_RDONLY) for _ in range(1100)]
from libmodbus_py.tools.testing.wires import SerialWire
mapping = Mapping(holding_registers=range(5, 10))
with SerialWire() as wire, Server(Device(mapping)).background(
    "tcp://127.0.0.1:0", f"rtu://{wire.server}"
) as running:
    for context in (
        Context.from_url(running.urls[0]),
        Context.from_url(running.urls[0], native=True),
        RtuContext(wire.client, native=True),
    ):
        with context:
            for value in range(5):
                context.write_register(6, value)
                assert context.read_holding_registers(5, 3) == [0, value, 0]
print("ok")
"""


def test_descriptors_beyond_1024_do_not_abort_the_process() -> None:
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    assert hard >= 2048, "this test needs a hard limit of 2048 descriptors"
    done = subprocess.run(
        [sys.executable, "-c", MANY_DESCRIPTORS], capture_output=True, text=True, timeout=30
    )
    assert done.stdout == "ok\n", done.stderr


def test_no_descriptor_is_left_behind(port: int) -> None:
    def use() -> None:
        for native in (True, False):
            with TcpContext("127.0.0.1", port, native=native) as context:
                context.read_coils(10, 1)
        with contextlib.suppress(ModbusError):
            TcpContext("127.0.0.1", refused_port()).connect()
        with contextlib.suppress(ModbusError):
            RtuContext("/dev/null").connect()
        with FakeUnit() as unit:
            RtuContext(unit.path).connect()  # forgotten, not closed
        gc.collect()

    with new_garbage_only():
        use()
        before = len(os.listdir("/proc/self/fd"))
        for _ in range(10):
            use()
        # The server, which runs in this process, closes its ends a moment later.
        until(lambda: len(os.listdir("/proc/self/fd")) <= before)


# --- closing -------------------------------------------------------------------------------


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """SIGINT interrupts, though a shell that runs the tests in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_in_a_request_leaves_a_usable_context() -> None:
    with (
        FakeServer(lambda request: [], echo_address) as server,
        TcpContext("127.0.0.1", server.port, timeout=600, native=False) as context,
    ):
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            context.read_holding_registers(3, 1)
        assert context.read_holding_registers(4, 1) == [4]


@pytest.mark.parametrize("rs485", ["rts-up", "rts-down"])
def test_rts_direction_control_still_carries_requests(rs485: str) -> None:
    answer = bytes.fromhex("0103020007") + bytes.fromhex("f986")
    with (
        FakeUnit(lambda request: [answer]) as unit,
        RtuContext(unit.path, rs485=rs485, rts_delay=0.001) as context,  # type: ignore[arg-type]
    ):
        for _ in range(3):
            assert context.read_holding_registers(0, 1) == [7]
