"""Gateways with the programs of others at their ends: pymodbus, libmodbus and mbpoll."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Gateway, Route
from libmodbus_py.ports.endpoint import parse
from tests.interop.test_interop_libmodbus import C_CLIENT_CALLS, C_CLIENT_REFUSALS, run_c_client
from tests.interop.test_interop_mbpoll import (
    HOLDING_REGISTERS,
    mbpoll,
    needs_mbpoll,
    printed_values,
)
from tests.interop.test_interop_pymodbus import (
    COUNTING,
    Asked,
    agree,
    asked,
    asked_beside_the_tables,
)
from tests.support.cases import each
from tests.support.gateways import passage
from tests.support.interop import (
    UNIT,
    c_serving,
    check_all,
    connected,
    holding_register,
    make_device,
    restore,
)
from tests.support.pymodbus_peers import pymodbus_client, pymodbus_serving

# The other side is a line of another kind.
SIDES = {"tcp": "rtu", "rtu": "tcp"}

# What a device answers on a serial line only.
COUNTED_ON_LINES = {("rtu", 8, "restart"), ("rtu", 8, "messages")}


def name_of(case: Any) -> str:
    return f"{case.function}-{case.name}"


def cases(front: str) -> Iterator[Asked]:
    """Yield all that pymodbus can, there."""
    for case in (*asked(), *asked_beside_the_tables()):
        if case.function in (11, 12):  # what a device counts, a gateway's line counts, too
            yield case._replace(answer=lambda response: None, expected=None)
        elif front in case.transports and (front, case.function, case.name) not in COUNTED_ON_LINES:
            yield case


@pytest.mark.parametrize("front", SIDES)
def test_a_pymodbus_client_and_a_device_agree_through_a_gateway(front: str) -> None:
    device = make_device()
    with passage(front, SIDES[front], {UNIT: device}) as through, ExitStack() as own:
        for check, case in each(cases(front), name_of):
            with check:
                at, its = through, device
                if case.function in COUNTING:
                    its = make_device()
                    at = own.enter_context(passage(front, SIDES[front], {UNIT: its}))
                restore(its)
                with pymodbus_client(at.url) as client:
                    agree(case, client, its)
            own.close()


@contextlib.contextmanager
def before(line: str) -> Iterator[Client]:
    """A context, and a gateway to a line."""
    line += ("&" if "?" in line else "?") + "timeout=2"
    with (
        Gateway([Route(line)]).background("tcp://127.0.0.1:0") as running,
        connected(running.urls[0]) as context,
    ):
        yield context


def test_a_context_and_a_pymodbus_server_agree_through_a_gateway() -> None:
    with pymodbus_serving("tcp") as line, before(line) as context:
        check_all(context)


@pytest.mark.parametrize("transport", SIDES)
def test_a_context_reads_a_c_server_through_it(compiled: Callable[[str], Path], transport) -> None:
    with c_serving(compiled("server"), transport) as line, before(line) as context:
        check_all(context)


@pytest.mark.parametrize("front", SIDES)
def test_all_calls_of_a_c_client_succeed_through_a_gateway(compiled: Callable[[str], Path], front):
    with passage(front, SIDES[front]) as through:
        output = run_c_client(compiled("client"), parse(through.url))
    assert {f"FC {function} ok" for function in C_CLIENT_CALLS} <= output
    assert {f"FC {function} refused" for function in C_CLIENT_REFUSALS} <= output


@needs_mbpoll
def test_mbpoll_reads_and_writes_through_a_gateway() -> None:
    device = make_device()
    with passage("tcp", "rtu", {UNIT: device}) as through:
        end = parse(through.url)
        read = mbpoll(end, HOLDING_REGISTERS, 100, count=125)
        assert printed_values(read) == {at: holding_register(at) for at in range(100, 225)}
        assert mbpoll(end, HOLDING_REGISTERS, 101, write=(4711,)).returncode == 0
        assert device.mapping.holding_registers[101] == 4711
