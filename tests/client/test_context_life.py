"""
Contexts over their life: arguments, connecting, threads, forks, many descriptors, closing.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import termios
from collections.abc import Iterator

import pytest

from libmodbus_py import (
    AsciiContext,
    Context,
    Device,
    Mapping,
    RtuContext,
    Server,
    TcpContext,
)
from tests.support.peers import FakeUnit, mbap

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


# --- threads, forks, descriptors -----------------------------------------------------------


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
