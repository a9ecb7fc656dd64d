"""Against mbpoll, a command line client: what it prints, and what it leaves behind."""

import re
import shutil
import subprocess
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py.ports.endpoint import Endpoint
from tests.support.interop import (
    BAUDRATE,
    UNIT,
    case_id,
    cells,
    coil,
    discrete_input,
    holding_register,
    input_register,
    make_device,
    our_server,
)

needs_mbpoll = pytest.mark.skipif(
    shutil.which("mbpoll") is None, reason="mbpoll is not installed: apt install mbpoll"
)
pytestmark = needs_mbpoll

TRANSPORTS = ("tcp", "rtu")
COILS, DISCRETE_INPUTS, INPUT_REGISTERS, HOLDING_REGISTERS = 0, 1, 3, 4  # its -t

Polled = subprocess.CompletedProcess[str]


def mbpoll(
    end: Endpoint, table: int, first: int, *, count: int | None = None, write: tuple[int, ...] = ()
) -> Polled:
    """Run mbpoll once, with addresses from 0 on."""
    if end.transport == "tcp":
        line, where = ["-m", "tcp", "-p", end.port], end.host
    else:
        line, where = ["-m", "rtu", "-b", BAUDRATE, "-P", "even"], end.path
    command = ["mbpoll", *line, "-a", UNIT, "-0", "-1", "-o", 5, "-t", table, "-r", first]
    if count is not None:
        command += ["-c", count]
    return subprocess.run(
        [str(word) for word in (*command, where, *write)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=20,
    )


def printed_values(process: Polled) -> dict[int, int]:
    """Read the lines of mbpoll, such as "[100]: 65535 (-1)"."""
    lines = re.findall(r"^\[(\d+)\]:\s+(\d+)", process.stdout, re.MULTILINE)
    return {int(address): int(value) for address, value in lines}


def over_each_transport(names: str, cases: dict[tuple[int, str], tuple[object, ...]]) -> object:
    return pytest.mark.parametrize(
        ("transport", "function", *names.split()),
        [
            pytest.param(
                transport,
                function,
                *values,
                id=case_id("mbpoll", "server", transport, function, name),
            )
            for (function, name), values in cases.items()
            for transport in TRANSPORTS
        ],
    )


@over_each_transport(
    "table first count value",
    {
        (1, "few"): (COILS, 12, 3, coil),
        (1, "most"): (COILS, 10, 125, coil),
        (2, "few"): (DISCRETE_INPUTS, 20, 9, discrete_input),
        (2, "most"): (DISCRETE_INPUTS, 1995, 125, discrete_input),
        (3, "few"): (HOLDING_REGISTERS, 399, 1, holding_register),
        (3, "most"): (HOLDING_REGISTERS, 100, 125, holding_register),
        (4, "few"): (INPUT_REGISTERS, 200, 2, input_register),
        (4, "most"): (INPUT_REGISTERS, 275, 125, input_register),
    },
)
def test_mbpoll_prints_the_values_of_our_table(
    transport: str, function: int, table: int, first: int, count: int, value: Callable[[int], int]
) -> None:
    with our_server(transport, {UNIT: make_device()}) as place:
        process = mbpoll(place.end, table, first, count=count)
        assert (process.returncode, process.stderr) == (0, "")
        values = dict(zip(range(first, first + count), cells(value, first, count), strict=True))
        assert printed_values(process) == values
        assert place.function == function


@over_each_transport(
    "table first values",
    {
        (5, "on"): (COILS, 10, (1,)),
        (5, "off"): (COILS, 12, (0,)),
        (15, "few"): (COILS, 13, (1, 1, 0, 1)),
        (6, "few"): (HOLDING_REGISTERS, 101, (65535,)),
        (16, "few"): (HOLDING_REGISTERS, 396, (0, 1, 258, 65535)),
        (16, "most"): (HOLDING_REGISTERS, 100, tuple(range(123))),
    },
)
def test_mbpoll_writes_into_our_table(
    transport: str, function: int, table: int, first: int, values: tuple[int, ...]
) -> None:
    device = make_device()
    tables: dict[int, Any] = {
        COILS: device.mapping.coils,
        HOLDING_REGISTERS: device.mapping.holding_registers,
    }
    with our_server(transport, {UNIT: device}) as place:
        process = mbpoll(place.end, table, first, write=values)
        assert (process.returncode, process.stderr) == (0, "")
        assert f"Written {len(values)} references." in process.stdout
        assert tables[table][first : first + len(values)] == list(values)
        assert place.function == function


@over_each_transport(
    "table first write",
    {
        (1, "refused"): (COILS, 3000, ()),
        (2, "refused"): (DISCRETE_INPUTS, 19, ()),
        (3, "refused"): (HOLDING_REGISTERS, 400, ()),
        (4, "refused"): (INPUT_REGISTERS, 199, ()),
        (5, "refused"): (COILS, 2110, (1,)),
        (6, "refused"): (HOLDING_REGISTERS, 99, (1,)),
        (15, "refused"): (COILS, 2109, (1, 1)),
        (16, "refused"): (HOLDING_REGISTERS, 399, (1, 2)),
    },
)
def test_mbpoll_says_that_an_address_is_illegal(
    transport: str, function: int, table: int, first: int, write: tuple[int, ...]
) -> None:
    with our_server(transport, {UNIT: make_device()}) as place:
        process = mbpoll(place.end, table, first, write=write)
        assert process.returncode == 1
        assert process.stderr.rstrip().endswith("failed: Illegal data address")
        assert printed_values(process) == {}
        assert place.function == function
