"""
libmodbus's own unit tests, as Debian's libmodbus-dev ships them, with contexts as the other side.

Its client runs whole against a slave by hand, and contexts ask its server what that client asks.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    Mapping,
    ModbusTimeoutError,
    RtuContext,
    ServerDeviceBusy,
    TcpContext,
    pdu,
)
from libmodbus_py.framing import crc16
from libmodbus_py.low_level import lib
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.c_programs import compile_c
from tests.support.cases import each
from tests.support.contexts import AnyContext, context_at, slave_by_hand
from tests.support.interop import BAUDRATE, UNIT, program

EXAMPLES = Path("/usr/share/doc/libmodbus-dev/examples")

# Of unit-test.h.
COILS, DISCRETE_INPUTS = range(0x130, 0x130 + 0x25), range(0x1C4, 0x1C4 + 0x16)
HOLDING_REGISTERS, INPUT_REGISTERS = range(0x160, 0x160 + 0x20), range(0x108, 0x109)
COIL_BYTES, INPUT_BYTES = bytes.fromhex("CD6BB20E1B"), bytes.fromhex("ACDB35")
BUSY, WRONG_SENDER, SLOW, PIECES = 0x170, 0x171, 0x172, 0x173
WRONG_COUNT = 2
HALF, PIECE = 0.5, 0.005


def bits(data: bytes, count: int) -> list[bool]:
    return [bool(data[at // 8] >> at % 8 & 1) for at in range(count)]


def adapted(name: str, folder: Path, changes: dict[str, str]) -> Path:
    """Compile one of the programs with other places in it."""
    source = EXAMPLES / f"{name}.c"
    if not source.exists():
        pytest.skip(f"{source} is not there: this system installs no documentation")
    text = source.read_text(encoding="utf-8")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    copy = folder / source.name
    copy.write_text(text, encoding="utf-8")
    return compile_c(copy, folder / name, f"-I{EXAMPLES}", "-w")


# --- its client -------------------------------------------------------------------------------


LONGER_WAITS = {
    "modbus_set_response_timeout(ctx, 0, 600000)": "modbus_set_response_timeout(ctx, 0, 950000)",
    "modbus_set_byte_timeout(ctx, 0, 7000)": "modbus_set_byte_timeout(ctx, 0, 500000)",
    "usleep(400000)": "usleep(900000)",
    "usleep(11 * 5000)": "usleep(11 * 50000)",
}
"""On a busy machine the answers of the slave come later, all of them."""


class UnitTestSlave:
    """Answers as unit-test-server.c does, which misbehaves at certain addresses."""

    def __init__(self) -> None:
        self.mapping = Mapping(COILS, DISCRETE_INPUTS, HOLDING_REGISTERS, INPUT_REGISTERS)
        self.mapping.discrete_inputs[:] = bits(INPUT_BYTES, len(DISCRETE_INPUTS))
        self.mapping.input_registers[:] = [0x000A]

    def __call__(self, slave: AnyContext, request: bytes) -> None:
        head = slave.header_length
        function, address = request[head], int.from_bytes(request[head + 1 : head + 3], "big")
        count = int.from_bytes(request[head + 3 : head + 5], "big")
        is_serial = isinstance(slave, RtuContext)
        if function == 3 and count == WRONG_COUNT:
            body = request[: head + 4] + bytes([WRONG_COUNT - 1])
            request = body + crc16(body).to_bytes(2, "little") if is_serial else body
        elif function == 3 and address == BUSY:
            slave.reply_exception(request, ServerDeviceBusy.code)
            return
        elif function == 3 and address == WRONG_SENDER:
            # With transaction 0, and on a line as another unit.
            raw = bytes([UNIT + 1 if is_serial else 0xFF, 3, 2, 0, 0])
            lib.modbus_send_raw_request(slave.modbus, raw, len(raw))
            return
        elif function == 3 and address == SLOW:
            time.sleep(HALF)
        elif function == 3 and address == PIECES and not is_serial:
            for byte in request[:2] + bytes.fromhex("0000 0005 FF 03 02 0000"):
                time.sleep(PIECE)
                with contextlib.suppress(OSError):
                    os.write(slave.socket, bytes([byte]))
            return
        elif (function, address) in ((5, COILS.start + 2), (6, BUSY)):
            slave.reply_exception(request, IllegalDataValue.code)
            return
        slave.reply(request, self.mapping)


def lines_of(client: Path, kind: str) -> list[str]:
    done = subprocess.run([client, kind], capture_output=True, timeout=120)
    return done.stdout.decode("latin-1").splitlines()


def passed(lines: list[str]) -> int:
    return sum(line.endswith("OK") for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "host"), [("tcp", "127.0.0.1"), ("tcppi", "::1")])
def test_the_client_passes_against_a_slave_by_hand(kind: str, host: str, tmp_path: Path) -> None:
    slave = TcpContext(host, 0)
    with slave_by_hand(slave, UnitTestSlave()):
        changes = LONGER_WAITS | {
            'new_tcp("127.0.0.1", 1502)': f'new_tcp("127.0.0.1", {slave.port})',
            'new_tcp_pi("::1", "1502")': f'new_tcp_pi("::1", "{slave.port}")',
        }
        lines = lines_of(adapted("unit-test-client", tmp_path, changes), kind)
    assert "ALL TESTS PASS WITH SUCCESS." in lines, "\n".join(lines[-12:])
    assert passed(lines) >= 100


@pytest.mark.slow
def test_the_client_passes_on_a_line_up_to_a_frame_that_is_none(tmp_path: Path) -> None:
    """
    The byte count of that frame contradicts its length, and a slave here does not answer it.

    modbus_receive reports a wrong CRC, after which unit-test-server.c answers nevertheless.
    """
    with SerialWire() as wire:
        slave = RtuContext(wire.server, BAUDRATE, "N", unit=UNIT)
        with slave_by_hand(slave, UnitTestSlave()):
            client = adapted(
                "unit-test-client", tmp_path, LONGER_WAITS | {"/dev/ttyUSB1": wire.client}
            )
            lines = lines_of(client, "rtu")
    (error,) = (at for at, line in enumerate(lines) if "assertion error" in line)
    assert any("function 0x10: write 0 values" in line for line in lines[error - 4 : error])
    assert passed(lines) >= 85


# --- its server -------------------------------------------------------------------------------

SHOW_PORT = """
    s = modbus_tcp_listen(ctx, 1);
    {
        struct sockaddr_in place;
        socklen_t size = sizeof place;
        getsockname(s, (struct sockaddr *) &place, &size);
        fprintf(stderr, "%d\\n", ntohs(place.sin_port));
    }
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Path:
    changes = {
        '#include "unit-test.h"': '#include "unit-test.h"\n#include <netinet/in.h>',
        'new_tcp("127.0.0.1", 1502)': 'new_tcp("127.0.0.1", 0)',
        "        s = modbus_tcp_listen(ctx, 1);": SHOW_PORT,
        '"/dev/ttyUSB0"': "argv[2]",
    }
    return adapted("unit-test-server", tmp_path_factory.mktemp("server"), changes)


@contextlib.contextmanager
def asking(server: Path, transport: str, **options: Any) -> Iterator[AnyContext]:
    """Run the server, which ends with its first connection, and yield a context for it."""
    chosen = {"timeout": 2.0, **options}
    if transport == "tcp":
        with subprocess.Popen(
            [server, "tcp"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stderr is not None
            port = int(process.stderr.readline())
            with context_at(f"tcp://127.0.0.1:{port}", **chosen) as context:
                yield context
            process.wait(30)
        return
    with (
        SerialWire() as wire,
        program(server, "rtu", wire.server),
        context_at(f"rtu://{wire.client}", **chosen) as context,
    ):
        assert isinstance(context, RtuContext)
        while True:  # until the server has opened its end
            with contextlib.suppress(ModbusTimeoutError):
                context.response_timeout = 0.1
                context.read_coils(COILS.start, 1)
                break
        context.response_timeout = chosen["timeout"]
        yield context


def first(addresses: range) -> int:
    return addresses.start


def behind(addresses: range) -> int:
    return addresses.stop


Ask = Callable[[AnyContext], object]

ANSWERS: list[tuple[Ask, object]] = [
    (lambda c: c.write_coil(first(COILS), True), None),
    (lambda c: c.read_coils(first(COILS), 1), [True]),
    (lambda c: c.write_coils(first(COILS), bits(COIL_BYTES, len(COILS))), None),
    (lambda c: c.read_coils(first(COILS), len(COILS)), bits(COIL_BYTES, len(COILS))),
    (
        lambda c: c.read_discrete_inputs(first(DISCRETE_INPUTS), len(DISCRETE_INPUTS)),
        bits(INPUT_BYTES, len(DISCRETE_INPUTS)),
    ),
    (lambda c: c.write_register(first(HOLDING_REGISTERS), 0x1234), None),
    (lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), 1), [0x1234]),
    (lambda c: c.write_registers(first(HOLDING_REGISTERS), [0x022B, 0x0001, 0x0064]), None),
    (
        lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), 3),
        [0x022B, 0x0001, 0x0064],
    ),
    (
        lambda c: c.read_write_registers(
            first(HOLDING_REGISTERS), 3, first(HOLDING_REGISTERS) + 1, [0, 0]
        ),
        [0x022B, 0, 0],
    ),
    (lambda c: c.read_input_registers(first(INPUT_REGISTERS), 1), [0x000A]),
    (lambda c: c.write_register(first(HOLDING_REGISTERS), 0x12), None),
    (lambda c: c.mask_write_register(first(HOLDING_REGISTERS), 0xF2, 0x25), None),
    (lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), 1), [0x17]),
    (lambda c: c.report_server_id().running, True),
    (lambda c: c.execute(pdu.ReadHoldingRegisters(first(HOLDING_REGISTERS), 1)), [0x17]),
]
"""The requests of unit-test-client.c that are answered, in its order, with the answers."""

REFUSALS: list[tuple[Ask, type[Exception]]] = [
    *((ask, IllegalDataAddress) for ask in (
        lambda c: c.read_coils(0, 1),
        lambda c: c.read_coils(first(COILS), len(COILS) + 1),
        lambda c: c.read_discrete_inputs(0, 1),
        lambda c: c.read_discrete_inputs(first(DISCRETE_INPUTS), len(DISCRETE_INPUTS) + 1),
        lambda c: c.read_holding_registers(0, 1),
        lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), len(HOLDING_REGISTERS) + 1),
        lambda c: c.read_input_registers(0, 1),
        lambda c: c.read_input_registers(first(INPUT_REGISTERS), len(INPUT_REGISTERS) + 1),
        lambda c: c.write_coil(0, True),
        lambda c: c.write_coil(behind(COILS), True),
        lambda c: c.write_coils(0, [True]),
        lambda c: c.write_coils(behind(COILS), [True] * len(COILS)),
        lambda c: c.write_register(0, 0),
        lambda c: c.write_register(behind(HOLDING_REGISTERS), 0),
        lambda c: c.write_registers(0, [0]),
        lambda c: c.write_registers(behind(HOLDING_REGISTERS), [0, 0, 0]),
        lambda c: c.mask_write_register(0, 0xF2, 0x25),
        lambda c: c.mask_write_register(behind(HOLDING_REGISTERS), 0xF2, 0x25),
        lambda c: c.read_write_registers(0, 1, 0, [0]),
        lambda c: c.read_write_registers(behind(HOLDING_REGISTERS), 3, 1, [0]),
    )),
    *((ask, IllegalDataValue) for ask in (
        lambda c: c.write_coil(first(COILS) + 2, True),
        lambda c: c.write_register(BUSY, 0x42),
        lambda c: c.execute(pdu.RawRequest(3, bytes.fromhex("0160 0000"))),
        lambda c: c.execute(pdu.RawRequest(1, bytes.fromhex("0160 07d1"))),
        lambda c: c.execute(pdu.RawRequest(16, bytes.fromhex("0160 0000 00"))),
        lambda c: c.execute(pdu.RawRequest(23, bytes.fromhex("0160 007e 0000 0001 02 1234"))),
    )),
    (lambda c: c.read_holding_registers(BUSY, 3), ServerDeviceBusy),
    *((ask, ValueError) for ask in (
        lambda c: c.read_coils(first(COILS), 2001),
        lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), 126),
        lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), 0),
        lambda c: c.write_coils(first(COILS), [True] * 1969),
        lambda c: c.write_registers(first(HOLDING_REGISTERS), [0] * 124),
    )),
]  # fmt: skip
"""Those that are refused, and how."""


@pytest.mark.slow
@pytest.mark.parametrize("transport", ["tcp", "rtu"])
def test_contexts_get_from_the_server_what_its_client_gets(server: Path, transport: str) -> None:
    with asking(server, transport) as context:
        for check, (ask, answer) in each(ANSWERS):
            with check:
                assert ask(context) == answer
        for check, (ask, kind) in each(REFUSALS):
            with check, pytest.raises(kind):
                ask(context)
        if transport == "tcp":
            with pytest.raises(IllegalFunction):
                context.execute(pdu.RawRequest(0x42))
        context.unit = UNIT + 1
        context.response_timeout = 0.1
        if transport == "tcp":  # the server of libmodbus answers any unit
            assert context.read_holding_registers(first(HOLDING_REGISTERS), 1) == [0x17]
        else:
            with pytest.raises(ModbusTimeoutError):
                context.read_holding_registers(first(HOLDING_REGISTERS), 1)


FAILURES: dict[str, tuple[dict[str, Any], int, int, type[Exception]]] = {
    "a wrong count": ({}, first(HOLDING_REGISTERS), WRONG_COUNT, InvalidResponse),
    "another sender": ({}, WRONG_SENDER, 1, InvalidResponse),
    "too slow": ({"timeout": 0.2}, SLOW, 1, ModbusTimeoutError),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAILURES)
@pytest.mark.parametrize("transport", ["tcp", "rtu"])
def test_contexts_fail_where_the_server_misbehaves(server: Path, transport: str, name: str) -> None:
    options, address, count, kind = FAILURES[name]
    with asking(server, transport) as context:
        context.response_timeout = options.get("timeout", 2.0)
        with pytest.raises(kind) as caught:
            context.read_holding_registers(address, count)
        assert re.search(f"ReadHoldingRegisters.address={address}", str(caught.value))


@pytest.mark.slow
def test_byte_timeouts_are_those_of_libmodbus(server: Path) -> None:
    for timeout, answers in {0.001: False, 1.0: True, 0.0: True}.items():
        with asking(server, "tcp", unit=255) as context:
            context.byte_timeout = timeout
            if answers:
                assert context.read_holding_registers(PIECES, 1) == [0]
            else:
                with pytest.raises(ModbusTimeoutError):
                    context.read_holding_registers(PIECES, 1)
