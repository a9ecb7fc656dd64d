"""
Gateways with the programs of others at their ends: pymodbus, libmodbus and mbpoll.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymodbus.server import ModbusTcpServer

from libmodbus_py import Context, Device, ExceptionResponse, Gateway, Route
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.tools.testing.wires import SerialWire
from tests.interop.test_interop_libmodbus import C_CLIENT_CALLS, C_CLIENT_REFUSALS
from tests.interop.test_interop_pymodbus import (
    COUNTING,
    Asked,
    asked,
    asked_beside_the_tables,
    pymodbus_client,
)
from tests.interop.test_interop_pymodbus_server import in_background, simulated_device
from tests.support.cases import each
from tests.support.gateways import passage
from tests.support.interop import (
    BAUDRATE,
    UNIT,
    Exchange,
    Place,
    cells,
    exchanges,
    holding_register,
    make_device,
    program,
    refusals,
    restore,
    restore_through,
)

# The other side is a line of another kind.
SIDES = {"tcp": "rtu", "rtu": "tcp"}

# What a device answers on a serial line only.
COUNTED_ON_LINES = {("rtu", 8, "restart"), ("rtu", 8, "messages")}


def cases(front: str) -> Iterator[Asked]:
    """Yield all that pymodbus can, there."""
    for case in (*asked(), *asked_beside_the_tables()):
        if front in case.transports and (front, case.function, case.name) not in COUNTED_ON_LINES:
            yield case


@pytest.mark.parametrize("front", SIDES)
def test_pymodbus_client_and_a_device_agree_through_it(front: str) -> None:
    device = make_device()
    with passage(front, SIDES[front], {UNIT: device}) as through, ExitStack() as own:
        for check, case in each(cases(front), lambda case: f"{case.function}-{case.name}"):
            with check:
                at, its = through, device
                if case.function in COUNTING:
                    its = make_device()
                    at = own.enter_context(passage(front, SIDES[front], {UNIT: its}))
                restore(its)
                agree(case, front, Place(parse(at.url), at.wire), its)  # type: ignore[arg-type]
            own.close()


def agree(case: Asked, front: str, place: Place, device: Device) -> None:
    with pymodbus_client(front, place) as client:
        response = case.ask(client)
    assert not response.isError(), response
    if case.function not in (11, 12):  # what a device counts, a gateway's line counts, too
        assert case.answer(response) == case.expected
    assert case.look(device) == case.seen


@contextlib.contextmanager
def before(line: str) -> Iterator[Context]:
    """A context, and a gateway to a line."""
    with (
        Gateway([Route(line)]).background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], unit=UNIT, timeout=5) as context,
    ):
        yield context


def check(context: Context, exchange: Exchange) -> None:
    assert exchange.ask(context) == exchange.answer
    assert exchange.look(context) == exchange.seen


def make_pymodbus_server() -> ModbusTcpServer:
    return ModbusTcpServer(simulated_device(), address=("127.0.0.1", 0))


def test_context_and_pymodbus_server_agree_through_it() -> None:
    with in_background(make_pymodbus_server) as server:
        port = server.transport.sockets[0].getsockname()[1]
        with before(f"tcp://127.0.0.1:{port}?timeout=2") as context:
            for verdict, exchange in each(exchanges(), lambda case: f"{case.function}-{case.name}"):
                with verdict:
                    check(context, exchange)
                    restore_through(context, exchange.function)


@contextlib.contextmanager
def before_c_server(server: Path, transport: str) -> Iterator[Context]:
    with contextlib.ExitStack() as stack:
        if transport == "tcp":
            process = stack.enter_context(program(server, "tcp", 0))
        else:
            wire = stack.enter_context(SerialWire())
            process = stack.enter_context(program(server, "rtu", wire.server, BAUDRATE, UNIT))
        assert process.stdout is not None
        word, port = process.stdout.readline().split()
        assert word == "ready"
        line = f"tcp://127.0.0.1:{port}?timeout=2"
        if transport == "rtu":
            line = f"rtu://{wire.client}?baudrate={BAUDRATE}&timeout=2"
        yield stack.enter_context(before(line))


@pytest.mark.parametrize("transport", SIDES)
def test_context_and_c_server_agree_through_it(
    compiled: Callable[[str], Path], transport: str
) -> None:
    with before_c_server(compiled("server"), transport) as context:
        for verdict, exchange in each(exchanges(), lambda case: f"{case.function}-{case.name}"):
            with verdict:
                check(context, exchange)
                restore_through(context, exchange.function)
        for exchange in refusals():
            with pytest.raises(ExceptionResponse):
                exchange.ask(context)


@pytest.mark.parametrize("front", SIDES)
def test_c_client_is_content_with_a_device_behind_it(
    compiled: Callable[[str], Path], front: str
) -> None:
    with passage(front, SIDES[front]) as through:
        end = parse(through.url)
        where = [end.port] if front == "tcp" else [end.path, BAUDRATE]
        command = [str(word) for word in (compiled("client"), front, *where, UNIT)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=50)
    said = done.stdout.splitlines()
    for function in C_CLIENT_CALLS:
        assert f"FC {function} ok" in said
    for function in C_CLIENT_REFUSALS:
        assert f"FC {function} refused" in said


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_mbpoll_reads_and_writes_through_it() -> None:
    device = make_device()
    with passage("tcp", "rtu", {UNIT: device}) as through:
        end = parse(through.url)
        words = ["mbpoll", "-m", "tcp", "-p", end.port, "-a", UNIT, "-0", "-1", "-o", 5, "-t", 4]
        for more in (["-r", 100, "-c", 125, end.host], ["-r", 101, end.host, 4711]):
            command = [str(word) for word in (*words, *more)]
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=20, stdin=subprocess.DEVNULL
            )
            assert done.returncode == 0, done.stdout
            for at, value in enumerate(cells(holding_register, 100, 125 if "-c" in more else 0)):
                assert f"[{100 + at}]: \t{value}" in done.stdout
        assert device.mapping.holding_registers[101] == 4711
