"""
libmodbus's own unit tests, as Debian's libmodbus-dev ships them.

Its client runs whole against slaves by hand and servers; contexts and clients ask its server what
that client asks.
"""

import contextlib
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

from libmodbus_py import (
    Client,
    Device,
    Fault,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    Mapping,
    ModbusTimeoutError,
    RtuContext,
    Server,
    ServerDeviceBusy,
    TcpContext,
    pdu,
)
from libmodbus_py.framing import crc16
from libmodbus_py.low_level import lib
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.hosts import host_and_port
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
    """Compile one of the programs with another host and port in its source."""
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
    process = subprocess.run([client, kind], capture_output=True, timeout=120)
    return process.stdout.decode("latin-1").splitlines()


def passed(lines: list[str]) -> int:
    return sum(line.endswith("OK") for line in lines)


class UnitTestDevice(Device):
    """A device that answers as unit-test-server.c does, with the same faults."""

    faults: ClassVar = {
        None: [
            # Those of single addresses do not count in the read of all and one more.
            Fault("exception", function=3, table="holding_registers", address=0x180, code=2),
            Fault("exception", function=3, table="holding_registers", address=BUSY, code=6),
            Fault("exception", function=5, table="coils", address=COILS.start + 2, code=3),
            Fault("exception", function=6, table="holding_registers", address=BUSY, code=3),
            Fault("wrong_transaction", table="holding_registers", address=WRONG_SENDER),
            Fault("wrong_unit", table="holding_registers", address=WRONG_SENDER),
            Fault("delay", table="holding_registers", address=SLOW, seconds=HALF),
            Fault("trickle", table="holding_registers", address=PIECES, seconds=PIECE),
        ]
    }

    def __init__(self) -> None:
        server_id = pdu.ServerId(b"\xb4", True, b"LMB3.1.6")
        super().__init__(UnitTestSlave().mapping, server_id=server_id)

    def answer(self, pdu: bytes, *caller: Any) -> bytes:
        if pdu[0] == 3 and pdu[3:] == bytes([0, WRONG_COUNT]):
            pdu = pdu[:4] + bytes([WRONG_COUNT - 1])
        return super().answer(pdu, *caller)


@contextlib.contextmanager
def unit_test_server(kind: str, peer: str) -> Iterator[dict[str, str]]:
    """Run a slave by hand or a `Server`, and yield the changes that lead the client there."""
    host = {"tcp": "127.0.0.1", "tcppi": "::1"}.get(kind, "")
    with contextlib.ExitStack() as stack:
        wire = None if host else stack.enter_context(SerialWire())
        if peer == "slave":
            slave: AnyContext = (
                RtuContext(wire.server, BAUDRATE, "N", unit=UNIT) if wire else TcpContext(host, 0)
            )
            stack.enter_context(slave_by_hand(slave, UnitTestSlave()))
            port = getattr(slave, "port", 0)
        else:
            device: Any = {UNIT: UnitTestDevice()} if wire else UnitTestDevice()
            url = f"rtu://{wire.server}" if wire else f"tcp://{host_and_port(host, 0)}"
            server = Server(device, faults=UnitTestDevice.faults)
            port = parse(stack.enter_context(server.background(url)).urls[0]).port
        changes = {
            'new_tcp("127.0.0.1", 1502)': f'new_tcp("127.0.0.1", {port})',
            'new_tcp_pi("::1", "1502")': f'new_tcp_pi("::1", "{port}")',
        }
        if wire:
            changes["/dev/ttyUSB1"] = wire.client
        yield changes


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tcp", "tcppi", "rtu"])
@pytest.mark.parametrize("peer", ["slave", "server"])
def test_the_unit_test_client_of_libmodbus_passes(kind: str, peer: str, tmp_path: Path) -> None:
    with unit_test_server(kind, peer) as changes:
        client = adapted("unit-test-client", tmp_path, LONGER_WAITS | changes)
        lines = lines_of(client, kind)
    assert "ALL TESTS PASS WITH SUCCESS." in lines, "\n".join(lines[-12:])
    assert passed(lines) >= 100


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


Asking = AnyContext | Client


@contextlib.contextmanager
def asking(server: Path, transport: str, face: str = "context", **options: Any) -> Iterator[Any]:
    """Run the server, which ends with its first connection, and yield who asks it."""
    settings = {"unit": UNIT, "timeout": 2.0, **options}

    def asker(url: str) -> contextlib.AbstractContextManager[Asking]:
        return Client(url, **settings) if face == "client" else context_at(url, **settings)

    if transport == "tcp":
        with subprocess.Popen(
            [server, "tcp"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stderr is not None
            port = int(process.stderr.readline())
            with asker(f"tcp://127.0.0.1:{port}") as asks:
                yield asks
            process.wait(30)
        return
    with SerialWire() as wire, program(server, "rtu", wire.server):
        url = f"rtu://{wire.client}?baudrate={BAUDRATE}"
        with context_at(url, timeout=0.1) as context:
            while True:  # until the server has opened its end
                with contextlib.suppress(ModbusTimeoutError):
                    context.read_coils(COILS.start, 1)
                    break
        with asker(url) as asks:
            yield asks


def first(addresses: range) -> int:
    return addresses.start


def behind(addresses: range) -> int:
    return addresses.stop


Ask = Callable[[Any], object]

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
    (lambda c: c.read_holding_registers(first(HOLDING_REGISTERS), 3), [0x022B, 0x0001, 0x0064]),
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


each_transport = pytest.mark.parametrize("transport", ["tcp", "rtu"])
each_face = pytest.mark.parametrize("face", ["context", "client"])


@pytest.mark.slow
@each_transport
@each_face
def test_the_server_answers_what_its_client_asks(server: Path, transport: str, face: str) -> None:
    with asking(server, transport, face) as asks:
        for check, (ask, answer) in each(ANSWERS):
            with check:
                assert ask(asks) == answer
        for check, (ask, kind) in each(REFUSALS):
            with check, pytest.raises(kind):
                ask(asks)
        if transport == "tcp":
            with pytest.raises(IllegalFunction):
                asks.execute(pdu.RawRequest(0x42))
        if face == "client":
            return
        asks.unit = UNIT + 1
        asks.response_timeout = 0.1
        if transport == "tcp":  # the server of libmodbus answers any unit
            assert asks.read_holding_registers(first(HOLDING_REGISTERS), 1) == [0x17]
        else:
            with pytest.raises(ModbusTimeoutError):
                asks.read_holding_registers(first(HOLDING_REGISTERS), 1)


FAILURES: dict[str, tuple[float, int, int, type[Exception]]] = {
    "a wrong count": (2.0, first(HOLDING_REGISTERS), WRONG_COUNT, InvalidResponse),
    "another sender": (2.0, WRONG_SENDER, 1, InvalidResponse),
    "too slow": (0.2, SLOW, 1, ModbusTimeoutError),
}
"""Timeout, address, count, and the error."""


@pytest.mark.slow
@each_transport
@each_face
@pytest.mark.parametrize("name", FAILURES)
def test_requests_fail_where_the_server_misbehaves(server: Path, transport: str, face: str, name):
    timeout, address, count, kind = FAILURES[name]
    if name == "another sender" and (face, transport) == ("client", "tcp"):
        kind = ModbusTimeoutError  # the answer of another request, which may be a late one
    with asking(server, transport, face, timeout=timeout) as asks:
        with pytest.raises(kind) as caught:
            asks.read_holding_registers(address, count)
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
