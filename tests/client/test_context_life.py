"""
Contexts over their life: arguments, connecting, threads, forks, many descriptors, closing.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gc
import os
import pty
import resource
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from fake import FakeServer, FakeUnit, mbap

from libmodbus_py import (
    AsciiContext,
    Context,
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    RtuContext,
    Server,
    TcpContext,
)
from libmodbus_py.testing.wires import SerialWire

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
        (lambda: TcpContext("127.0.0.1", unit=256), "unit"),
        (lambda: TcpContext("127.0.0.1", unit=-1), "unit"),
        (lambda: TcpContext("127.0.0.1", timeout=0), "timeout"),
        (lambda: TcpContext("127.0.0.1", timeout="1"), "timeout"),  # type: ignore[arg-type]
        (lambda: TcpContext("127.0.0.1", timeout=float("nan")), "timeout"),
        (lambda: TcpContext("127.0.0.1", framing="mbap"), "framing"),  # type: ignore[arg-type]
        (lambda: TcpContext("127.0.0.1", turnaround=-1), "turnaround"),
        (lambda: RtuContext(""), "device"),
        (lambda: RtuContext(3), "device"),  # type: ignore[arg-type]
        (lambda: RtuContext("/dev/x", 0), "baudrate"),
        (lambda: RtuContext("/dev/x", 9600.5), "baudrate"),  # type: ignore[arg-type]
        (lambda: RtuContext("/dev/x", parity="e"), "parity"),  # type: ignore[arg-type]
        (lambda: RtuContext("/dev/x", data_bits=9), "data_bits"),
        (lambda: RtuContext("/dev/x", stop_bits=3), "stop_bits"),
        (lambda: RtuContext("/dev/x", rs485="yes"), "rs485"),  # type: ignore[arg-type]
        (lambda: AsciiContext("/dev/x", rts_delay=-1), "rts_delay"),
        (lambda: Context.from_url("tcp://"), "host"),
        (lambda: Context.from_url("tcp://127.0.0.1:99999"), "port"),
        (lambda: Context.from_url("rtu:///dev/x?speed=9600"), "speed"),
        (lambda: Context.from_url("rtu:///dev/x?baudrate=fast"), "baudrate"),
        (lambda: Context.from_url("rtu://"), "device"),
        (lambda: Context.from_url("tcp://127.0.0.1", slave=3), "slave"),
    ],
)
def test_bad_argument_is_named(make, named) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises((ValueError, TypeError), match=named):
        make()


@pytest.mark.parametrize(
    ("ask", "named"),
    [
        (lambda context: context.read_coils(-1, 1), "address must be in 0..65535"),
        (lambda context: context.read_coils(0, 2001), "count must be in 1..2000"),
        (lambda context: context.read_holding_registers(65535, 2), "must not pass 65536"),
        (lambda context: context.read_input_registers(0, 0), "count must be in 1..125"),
        (lambda context: context.write_register(0, 65536), "value must be in 0..65535"),
        (lambda context: context.write_registers(0, []), "values must hold 1..123"),
        (lambda context: context.write_registers(0, [0, -1]), r"values\[1\]"),
        (lambda context: context.write_coils(0, [True] * 1969), "values must hold 1..1968"),
        (lambda context: context.write_coil(0, "on"), "value"),
        (lambda context: context.read_file_records([(0, 0, 1)]), "file must be in 1..65535"),
        (lambda context: context.for_unit(256), "unit must be in 0..255"),
    ],
)
def test_nothing_is_sent_for_bad_arguments(ask, named) -> None:  # type: ignore[no-untyped-def]
    with FakeServer(echo_address) as server, TcpContext("127.0.0.1", server.port) as context:
        with pytest.raises((ValueError, TypeError), match=named):
            ask(context)
        assert context.read_holding_registers(5, 1) == [5]
        assert len(server.requests) == 1


# --- connecting --------------------------------------------------------------------------


def refused_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


@pytest.mark.parametrize(
    ("host", "port", "number"),
    [
        ("127.0.0.1", None, errno.ECONNREFUSED),
        ("no-such-host.invalid", 502, None),
        ("x" * 300, 502, None),
        ("255.255.255.255", 502, errno.EACCES),
    ],
)
def test_connection_error_comes_at_once_and_says_why(
    host: str, port: int | None, number: int | None
) -> None:
    port = port or refused_port()
    start = time.monotonic()
    with pytest.raises(ModbusConnectionError) as caught:
        TcpContext(host, port, timeout=5).read_coils(0, 1)
    assert time.monotonic() - start < 2
    assert isinstance(caught.value, ConnectionError)
    assert caught.value.__cause__ is not None
    if number is not None:
        assert caught.value.errno in (number, errno.ENETUNREACH)
    assert host[:20] in str(caught.value)


def test_connecting_counts_within_the_timeout() -> None:
    """A full backlog drops every further connection, as a dead host does."""
    with socket.socket() as listener, contextlib.ExitStack() as stack:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(3):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(listener.getsockname())
        start = time.monotonic()
        with pytest.raises(ModbusConnectionError) as caught:
            TcpContext("127.0.0.1", listener.getsockname()[1], timeout=0.3).connect()
        assert time.monotonic() - start < 0.35
        assert caught.value.errno == errno.ETIMEDOUT


@pytest.mark.parametrize(
    ("device", "number"),
    [
        ("/dev/no-such-port", errno.ENOENT),
        ("/", errno.EISDIR),
        ("/dev/null", errno.ENOTTY),
        (__file__, errno.ENOTTY),
    ],
)
@pytest.mark.parametrize("kind", [RtuContext, AsciiContext])
def test_what_is_no_serial_port_is_refused(
    kind: type[RtuContext] | type[AsciiContext], device: str, number: int
) -> None:
    with pytest.raises(ModbusConnectionError) as caught:
        kind(device).connect()
    assert caught.value.errno == number
    assert device in str(caught.value)


def test_port_in_use_is_refused_and_left_alone() -> None:
    with FakeUnit() as unit, RtuContext(unit.path, 9600):
        before = termios.tcgetattr(unit._slave)
        with pytest.raises(ModbusConnectionError, match="in use") as caught:
            RtuContext(unit.path, 19200).connect()
        assert caught.value.errno == errno.EBUSY
        assert termios.tcgetattr(unit._slave) == before


def test_port_left_behind_by_a_program_that_died_can_be_opened() -> None:
    with SerialWire() as wire:
        die = f"import os, libmodbus_py as m; m.RtuContext({wire.client!r}).connect(); os._exit(0)"
        subprocess.run([sys.executable, "-c", die], check=True, timeout=30)
        for _ in range(2):
            with RtuContext(wire.client):
                pass


def test_settings_come_back_when_the_port_is_closed() -> None:
    master, slave = pty.openpty()
    try:
        tty.setcbreak(slave)
        before = termios.tcgetattr(slave)
        with RtuContext(os.ttyname(slave), 57600):
            assert termios.tcgetattr(slave)[4] == termios.B57600
        assert termios.tcgetattr(slave) == before
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize("baudrate", [50, 1800, 14400, 56000, 128000, 250000, 2000000])
def test_baudrate_that_libmodbus_would_turn_into_9600_is_set(baudrate: int) -> None:
    with FakeUnit() as unit, RtuContext(unit.path, baudrate):
        termios2 = fcntl.ioctl(unit._slave, 0x802C542A, bytes(44))
        assert int.from_bytes(termios2[-4:], sys.byteorder) == baudrate


def test_unplugged_port_is_a_connection_error_at_once() -> None:
    for native in (True, False):
        with SerialWire() as wire, RtuContext(wire.client, timeout=5, native=native) as context:
            threading.Timer(0.1, wire.unplug).start()
            start = time.monotonic()
            with pytest.raises(ModbusConnectionError):
                context.read_coils(0, 1)
            assert time.monotonic() - start < 1
            with pytest.raises(ModbusConnectionError):
                context.read_coils(0, 1)


def test_three_timeouts_in_a_row_make_a_new_connection() -> None:
    with (
        FakeServer(lambda request: []) as server,
        TcpContext("127.0.0.1", server.port, timeout=0.02) as context,
    ):
        for _ in range(7):
            with pytest.raises(ModbusTimeoutError):
                context.read_coils(0, 1)
        assert server.connections == 3


# --- broadcast ---------------------------------------------------------------------------


def test_broadcast_waits_for_no_answer_and_reads_are_refused() -> None:
    def first_silent(request: bytes) -> list[bytes]:
        return []

    with (
        FakeUnit(first_silent) as unit,
        RtuContext(unit.path, unit=0, timeout=3, turnaround=0.05) as everyone,
    ):
        start = time.monotonic()
        everyone.write_register(1, 2)
        everyone.write_coils(1, [True])
        assert 0.1 <= time.monotonic() - start < 1
        with pytest.raises(ValueError, match="broadcast"):
            everyone.read_coils(0, 1)
    assert unit.requests[0][:6] == bytes.fromhex("000600010002")


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

        assert all(pool.map(ask, range(2000)))


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
from libmodbus_py.testing.wires import SerialWire
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

    use()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        use()
    assert len(os.listdir("/proc/self/fd")) <= before


# --- closing -------------------------------------------------------------------------------


def test_close_is_idempotent_and_final(port: int) -> None:
    context = TcpContext("127.0.0.1", port)
    assert not context.closed
    context.close()
    context.close()
    assert context.closed
    with pytest.raises(ModbusConnectionError, match="closed"):
        context.read_coils(0, 1)


@NATIVE
def test_close_ends_a_request_that_another_thread_waits_for(native: bool) -> None:
    with (
        FakeServer(echo_address, lambda request: []) as server,
        ThreadPoolExecutor(1) as pool,
    ):
        context = TcpContext("127.0.0.1", server.port, timeout=10, native=native)
        context.read_holding_registers(1, 1)
        waiting = pool.submit(context.read_holding_registers, 1, 1)
        while len(server.requests) < 2:
            time.sleep(0.001)
        start = time.monotonic()
        context.close()
        with pytest.raises(ModbusConnectionError):
            waiting.result()
        assert time.monotonic() - start < 1


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
        TcpContext("127.0.0.1", server.port, timeout=5, native=False) as context,
    ):
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
        start = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            context.read_holding_registers(3, 1)
        assert time.monotonic() - start < 1
        assert context.read_holding_registers(4, 1) == [4]


def test_timeout_can_be_changed() -> None:
    with (
        FakeServer(echo_address, lambda request: []) as server,
        TcpContext("127.0.0.1", server.port) as context,
    ):
        context.read_holding_registers(1, 1)
        context.timeout = 0.05
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError):
            context.read_holding_registers(1, 1)
        assert time.monotonic() - start < 0.1


def test_handles_of_several_units_share_the_connection() -> None:
    first, second = (Device(Mapping(holding_registers=1)) for _ in range(2))
    first.mapping.holding_registers[0], second.mapping.holding_registers[0] = 1, 2
    with (
        Server({1: first, 2: second}).background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0]) as context,
    ):
        other = context.for_unit(2)
        for _ in range(3):
            assert context.read_holding_registers(0, 1) == [1]
            assert other.read_holding_registers(0, 1) == [2]


@pytest.mark.parametrize("rs485", ["rts-up", "rts-down"])
def test_rts_direction_control_still_carries_requests(rs485: str) -> None:
    answer = bytes.fromhex("0103020007") + bytes.fromhex("f986")
    with (
        FakeUnit(lambda request: [answer]) as unit,
        RtuContext(unit.path, rs485=rs485, rts_delay=0.001) as context,  # type: ignore[arg-type]
    ):
        for _ in range(3):
            assert context.read_holding_registers(0, 1) == [7]


def test_kernel_rs485_on_a_port_without_it_is_refused() -> None:
    with FakeUnit() as unit, pytest.raises(ModbusConnectionError, match="RS-485") as caught:
        RtuContext(unit.path, rs485="kernel").connect()
    assert caught.value.errno == errno.ENOTTY
