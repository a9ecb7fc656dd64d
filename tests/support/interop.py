"""
What the interoperability tests share: the device that every server has, what a
client asks of it, and the ids from which interop_report.py makes its table.

The same tables stand in c/server.c and c/client.c.
"""

import contextlib
import subprocess
from collections.abc import Callable, Generator, Iterable, Iterator
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pytest

from libmodbus_py import Client, Device, IllegalDataAddress, Mapping, Server
from libmodbus_py.ports.endpoint import Endpoint, parse
from libmodbus_py.protocol.pdu import ServerId
from libmodbus_py.tools.testing.wires import SerialWire, TcpWire
from tests.support.cases import Check, each
from tests.support.certificates import Pki

UNIT = 17
BAUDRATE = 115200
TIMEOUT = 5.0  # seconds; for answers that do come

COILS = range(10, 2110)
DISCRETE_INPUTS = range(20, 2120)
HOLDING_REGISTERS = range(100, 400)
INPUT_REGISTERS = range(200, 400)
RECORDS = range(300)  # of file 4; file 3 has the records 9 and 10 only
FIFOS: dict[int, list[int]] = {100: [440, 4740], 101: [], 102: list(range(31))}
EXCEPTION_STATUS = 0x6D
SERVER_ID = ServerId(b"\x01", True, b"libmodbus-py")
# Regular identification takes three pages, for 240 bytes are almost one.
IDENTIFICATION: dict[str | int, str | bytes] = {
    "VendorName": "vendor",
    "ProductCode": "code",
    "MajorMinorRevision": "V2.11",
    "VendorUrl": "u" * 240,
    "UserApplicationName": "application",
    128: "private",
}
OBJECTS = dict(
    zip((0, 1, 2, 3, 6, 128), (str(item).encode() for item in IDENTIFICATION.values()), strict=True)
)
# Nobody has these: old ones of Modicon, a reserved one, and two for users.
UNKNOWN_FUNCTIONS = (9, 18, 65, 90, 100)


def coil(address: int) -> bool:
    return address % 3 == 0


def discrete_input(address: int) -> bool:
    return address % 5 < 2


def holding_register(address: int) -> int:
    return 1000 + address


def input_register(address: int) -> int:
    return 65535 - address


def record(number: int) -> int:
    return 5000 + number


def cells(value: Callable[[int], int], first: int, count: int) -> list[int]:
    return [value(address) for address in range(first, first + count)]


def make_device() -> Device:
    mapping = Mapping(COILS, DISCRETE_INPUTS, HOLDING_REGISTERS, INPUT_REGISTERS)
    mapping.coils[:] = map(coil, COILS)
    mapping.discrete_inputs[:] = map(discrete_input, DISCRETE_INPUTS)
    mapping.holding_registers[:] = map(holding_register, HOLDING_REGISTERS)
    mapping.input_registers[:] = map(input_register, INPUT_REGISTERS)
    return Device(
        mapping,
        files={4: map(record, RECORDS), 3: {9: 0x33CD, 10: 0x0040}},
        fifos=FIFOS,
        identification=IDENTIFICATION,
        server_id=SERVER_ID,
        exception_status=EXCEPTION_STATUS,
    )


def restore(device: Device) -> None:
    """Set what the tables and files hold to what `make_device` has put there."""
    mapping = device.mapping
    mapping.coils[:] = map(coil, COILS)
    mapping.holding_registers[:] = map(holding_register, HOLDING_REGISTERS)
    device.files[4].write(0, tuple(map(record, RECORDS)))
    device.files[3].write(9, (0x33CD, 0x0040))


def restore_through(context: Client, function: int) -> None:
    """The same for the tables of another server, after a function that writes."""
    if function in (5, 15):
        for first in (10, 1060):
            context.write_coils(first, cells(coil, first, 1050))
    if function in (6, 16, 22, 23):
        for first in (100, 200, 300):
            context.write_registers(first, cells(holding_register, first, 100))


# A case of a table, and its id.
Case = TypeVar("Case")
Record = Callable[[str, object], None]


def try_cases(
    record: Record, cases: Iterable[tuple[str, Case]]
) -> Generator[tuple[Check, Case], None, None]:
    """
    Yield each case with its check, as `each` does, and record under its id what became of it.
    `record`: the fixture record_property, whose records interop_report.py reads; `cases`: each with
    its id, of `case_id`.
    """
    for check, (name, case) in each(cases, lambda case: case[0]):
        yield check, case
        record(name, "failed" if check.error else "passed")


def case_id(peer: str, role: str, transport: str, function: int, *more: str) -> str:
    """
    Name a test, or a case of one, as interop_report.py reads it. Such a name is
    "mbpoll-server-tcp-fc03-most". `peer`: the other program; `role`: "client" or "server": what
    this package is; `transport`: the scheme of the URL; `function`: the function code; `more`: what
    else tells it from its neighbours. "refused" says that an exception is the right answer,
    "pinned" that the peer errs.
    """
    return "-".join([peer, role, transport, f"fc{function:02}", *more])


class Place(NamedTuple):
    """Where a client finds our server."""

    end: Endpoint
    wire: SerialWire | TcpWire

    @property
    def function(self) -> int:
        """The code of the first request that went over the wire."""
        return self.wire.sent_by("client")[7 if self.end.framing == "tcp" else 1]


@contextlib.contextmanager
def our_server(transport: str, devices: Device | dict[int, Device]) -> Iterator[Place]:
    """Serve the devices; the place is the client's end of a wire to the server."""
    server = Server(devices)
    if transport.endswith("tcp"):
        with (
            server.background(f"{transport}://127.0.0.1:0") as running,
            TcpWire(parse(running.urls[0]).port) as wire,
        ):
            yield Place(parse(f"{transport}://127.0.0.1:{wire.port}"), wire)
        return
    with SerialWire() as wire:
        query = f"baudrate={BAUDRATE}"
        with server.background(f"{transport}://{wire.server}?{query}"):
            yield Place(parse(f"{transport}://{wire.client}?{query}"), wire)


@contextlib.contextmanager
def our_tls_server(pki: Pki, devices: Device | dict[int, Device]) -> Iterator[TcpWire]:
    """Serve the devices over TLS; clients connect to the wire, which sees the records."""
    server = Server(devices, security=pki.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        TcpWire(parse(running.urls[0]).port) as wire,
    ):
        yield wire


@contextlib.contextmanager
def program(*command: object) -> Iterator[subprocess.Popen[str]]:
    """Run a program with pipes for input and output until the block ends."""
    words = [str(word) for word in command]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def c_serving(server: Path, transport: str) -> Iterator[str]:
    """Run the server of libmodbus, and yield the URL of a client."""
    with contextlib.ExitStack() as stack:
        where: tuple[object, ...] = ("tcp", 0)
        if transport == "rtu":
            wire = stack.enter_context(SerialWire())
            where = ("rtu", wire.server, BAUDRATE, UNIT)
        process = stack.enter_context(program(server, *where))
        assert process.stdout is not None
        word, port = process.stdout.readline().split()
        assert word == "ready"
        if transport == "rtu":
            yield f"rtu://{wire.client}?baudrate={BAUDRATE}"
        else:
            yield f"tcp://127.0.0.1:{port}"


def connected(url: str, **options: Any) -> Client:
    """Return a client of ours for the unit there."""
    return Client(url, **{"unit": UNIT, "timeout": TIMEOUT, **options})


class Exchange(NamedTuple):
    """One request of a client; what a write has done is seen by a read."""

    function: int
    name: str
    ask: Callable[[Client], object]
    answer: object = None
    look: Callable[[Client], object] = lambda context: None
    seen: object = None


def call(method: str, *arguments: Any) -> Callable[[Client], Any]:
    """Return what calls a method of a client."""
    return methodcaller(method, *arguments)


def exchanges() -> Iterator[Exchange]:
    """The standard functions, with few values and with as many as there may be."""
    for function, method, cell, few, most in (
        (1, "read_coils", coil, (12, 3), (10, 2000)),
        (2, "read_discrete_inputs", discrete_input, (20, 9), (20, 2000)),
        (3, "read_holding_registers", holding_register, (399, 1), (100, 125)),
        (4, "read_input_registers", input_register, (200, 2), (275, 125)),
    ):
        for name, span in (("few", few), ("most", most)):
            yield Exchange(function, name, call(method, *span), cells(cell, *span))
    coils, registers = partial(call, "read_coils"), partial(call, "read_holding_registers")
    other = [not value for value in cells(coil, 11, 1968)]
    most_coils = [coil(10), *other, coil(11 + 1968)]
    few_coils = [True, True, False, True, False]
    most_registers = [1100, *range(123), 1224]
    for function, name, ask, look, outcome in (
        (5, "on", call("write_coil", 10, True), coils(10, 2), [True, coil(11)]),
        (5, "off", call("write_coil", 12, False), coils(12, 2), [False, coil(13)]),
        (6, "few", call("write_register", 101, 65535), registers(100, 3), [1100, 65535, 1102]),
        (15, "few", call("write_coils", 13, [True, False, True]), coils(12, 5), few_coils),
        (15, "most", call("write_coils", 11, other), coils(10, 1970), most_coils),
        (16, "few", call("write_registers", 398, [0, 65535]), registers(397, 3), [1397, 0, 65535]),
        (16, "most", call("write_registers", 101, range(123)), registers(100, 125), most_registers),
        # 1250 is 04E2h
        (
            *(22, "few", call("mask_write_register", 250, 0x00F0, 0xA50F)),
            *(registers(249, 3), [1249, 0xA5EF, 1251]),
        ),
    ):
        yield Exchange(function, name, ask, None, look, outcome)
    ask = call("read_write_registers", 100, 2, 101, [7])
    yield Exchange(23, "few", ask, [1100, 7], registers(101, 2), [7, 1102])
    ask = call("read_write_registers", 100, 125, 104, range(121))
    answer = [1100, 1101, 1102, 1103, *range(121)]
    yield Exchange(23, "most", ask, answer, registers(224, 2), [120, 1225])


def refusals() -> Iterator[Exchange]:
    """Requests for addresses that the device does not have, the standard functions all."""
    for function, ask in (
        (1, call("read_coils", 3000, 1)),
        (2, call("read_discrete_inputs", 2119, 20)),
        (3, call("read_holding_registers", 399, 2)),
        (4, call("read_input_registers", 199, 2)),
        (5, call("write_coil", 3000, True)),
        (6, call("write_register", 99, 1)),
        (15, call("write_coils", 2109, [True] * 20)),
        (16, call("write_registers", 399, [1, 2])),
        (22, call("mask_write_register", 400, 0, 0)),
        (23, call("read_write_registers", 100, 1, 400, [1])),
    ):
        yield Exchange(function, "refused", ask)


def check_all(context: Client) -> None:
    """Assert that a client gets the answers and the refusals of the standard functions."""
    for check, exchange in each(exchanges(), lambda case: f"{case.function}-{case.name}"):
        with check:
            assert exchange.ask(context) == exchange.answer
            assert exchange.look(context) == exchange.seen
            restore_through(context, exchange.function)
    for exchange in refusals():
        with pytest.raises(IllegalDataAddress):
            exchange.ask(context)


def of_a_client(
    peer: str, transport: str, cases: Iterable[Exchange]
) -> Iterator[tuple[str, Exchange]]:
    """Yield each case of a client of ours with its id."""
    for case in cases:
        yield case_id(peer, "client", transport, case.function, case.name), case


def check_answers(url: str, peer: str, cases: Iterable[Exchange], record: Record) -> None:
    """Assert that clients get each answer of a server, and that it does what it is asked."""
    for check, exchange in try_cases(record, of_a_client(peer, parse(url).scheme, cases)):
        with check, connected(url) as context:
            for _ in range(2):
                assert exchange.ask(context) == exchange.answer
                assert exchange.look(context) == exchange.seen
            restore_through(context, exchange.function)


def check_refusals(url: str, peer: str, record: Record) -> None:
    """Assert that clients raise what a server refuses, and go on."""
    for check, exchange in try_cases(record, of_a_client(peer, parse(url).scheme, refusals())):
        # A line is silent for a timeout where an answer could be that of the request before.
        with check, connected(url, timeout=2.0) as context:
            for _ in range(2):
                with pytest.raises(IllegalDataAddress) as caught:
                    exchange.ask(context)
                assert caught.value.function == exchange.function
            assert context.read_holding_registers(399, 1) == [1399]
            restore_through(context, exchange.function)
