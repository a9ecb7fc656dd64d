"""
What the interoperability tests share: the device that every server has, what a
context asks of it, and the ids from which interop_report.py makes its table.

The same tables stand in c/server.c and c/client.c.
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import NamedTuple, TypeVar

from libmodbus_py import Context, Device, Mapping, Server
from libmodbus_py.ports.endpoint import Endpoint, parse
from libmodbus_py.protocol.pdu import ServerId
from libmodbus_py.tools.testing.wires import SerialWire, TcpWire
from tests.support.cases import Check, each
from tests.support.certificates import Papers

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
    zip((0, 1, 2, 3, 6, 128), (str(each).encode() for each in IDENTIFICATION.values()), strict=True)
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


def restore_through(context: Context, function: int) -> None:
    """The same for the tables of another server, after a function that writes."""
    if function in (5, 15):
        for first in (10, 1060):
            context.write_coils(first, cells(coil, first, 1050))
    if function in (6, 16, 22, 23):
        for first in (100, 200, 300):
            context.write_registers(first, cells(holding_register, first, 100))


# --- ids ---------------------------------------------------------------------------


# A case of a table, and its id.
Case = TypeVar("Case")
Record = Callable[[str, object], None]


def tried(
    record: Record, cases: Iterable[tuple[str, Case]]
) -> Generator[tuple[Check, Case], None, None]:
    """
    Yield each case with its check, as `each` does, and record under its id what became of it.

    Args:
        record: the fixture record_property, whose records interop_report.py reads.
        cases: each with its id, of `case_id`.
    """
    for check, (name, case) in each(cases, lambda case: case[0]):
        yield check, case
        record(name, "failed" if check.error else "passed")


def case_id(peer: str, role: str, transport: str, function: int, *more: str) -> str:
    """
    Name a test, or a case of one, as interop_report.py reads it.

    Such a name is "mbpoll-server-tcp-fc03-most".

    Args:
        peer: the other program.
        role: "client" or "server": what this package is.
        transport: the scheme of the URL.
        function: the function code.
        more: what else tells it from its neighbours. "refused" says that an
            exception is the right answer, "pinned" that the peer errs.
    """
    return "-".join([peer, role, transport, f"fc{function:02}", *more])


# --- our server ----------------------------------------------------------------------


class Place(NamedTuple):
    """Where a client finds our server."""

    end: Endpoint
    wire: SerialWire | TcpWire

    @property
    def function(self) -> int:
        """The code of the first request that went over the wire."""
        sent = self.wire.sent_by("client")
        if self.end.framing == "ascii":
            return int(sent[3:5], 16)
        return sent[7 if self.end.framing == "tcp" else 1]


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
def our_tls_server(papers: Papers, devices: Device | dict[int, Device]) -> Iterator[TcpWire]:
    """Serve the devices over TLS; clients connect to the wire, which sees the records."""
    server = Server(devices, security=papers.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        TcpWire(parse(running.urls[0]).port) as wire,
    ):
        yield wire


# --- other programs --------------------------------------------------------------------


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


# --- what our contexts ask -----------------------------------------------------------------


class Exchange(NamedTuple):
    """One request of a context; what a write has done is seen by a read."""

    function: int
    name: str
    ask: Callable[[Context], object]
    answer: object = None
    look: Callable[[Context], object] = lambda context: None
    seen: object = None


def exchanges() -> Iterator[Exchange]:
    """The standard functions, with few values and with as many as there may be."""
    yield Exchange(1, "few", lambda c: c.read_coils(12, 3), cells(coil, 12, 3))
    yield Exchange(1, "most", lambda c: c.read_coils(10, 2000), cells(coil, 10, 2000))
    yield Exchange(2, "few", lambda c: c.read_discrete_inputs(20, 9), cells(discrete_input, 20, 9))
    yield Exchange(
        2, "most", lambda c: c.read_discrete_inputs(20, 2000), cells(discrete_input, 20, 2000)
    )
    yield Exchange(3, "few", lambda c: c.read_holding_registers(399, 1), [1399])
    yield Exchange(
        3, "most", lambda c: c.read_holding_registers(100, 125), cells(holding_register, 100, 125)
    )
    yield Exchange(4, "few", lambda c: c.read_input_registers(200, 2), [65335, 65334])
    yield Exchange(
        4, "most", lambda c: c.read_input_registers(275, 125), cells(input_register, 275, 125)
    )
    for name, address, value in (("on", 10, True), ("off", 12, False)):
        yield Exchange(
            5,
            name,
            lambda c, address=address, value=value: c.write_coil(address, value),
            look=lambda c, address=address: c.read_coils(address, 2),
            seen=[value, coil(address + 1)],
        )
    yield Exchange(
        6,
        "few",
        lambda c: c.write_register(101, 65535),
        look=lambda c: c.read_holding_registers(100, 3),
        seen=[1100, 65535, 1102],
    )
    yield Exchange(
        15,
        "few",
        lambda c: c.write_coils(13, [True, False, True]),
        look=lambda c: c.read_coils(12, 5),
        seen=[True, True, False, True, False],
    )
    yield Exchange(
        15,
        "most",
        lambda c: c.write_coils(11, [not value for value in cells(coil, 11, 1968)]),
        look=lambda c: c.read_coils(10, 1970),
        seen=[
            coil(10),
            *(not value for value in cells(coil, 11, 1968)),
            coil(11 + 1968),
        ],
    )
    yield Exchange(
        16,
        "few",
        lambda c: c.write_registers(398, [0, 65535]),
        look=lambda c: c.read_holding_registers(397, 3),
        seen=[1397, 0, 65535],
    )
    yield Exchange(
        16,
        "most",
        lambda c: c.write_registers(101, range(123)),
        look=lambda c: c.read_holding_registers(100, 125),
        seen=[1100, *range(123), 1224],
    )
    yield Exchange(
        22,
        "few",
        lambda c: c.mask_write_register(250, 0x00F0, 0xA50F),  # 1250 is 04E2h
        look=lambda c: c.read_holding_registers(249, 3),
        seen=[1249, 0xA5EF, 1251],
    )
    yield Exchange(
        23,
        "few",
        lambda c: c.read_write_registers(100, 2, 101, [7]),
        [1100, 7],
        look=lambda c: c.read_holding_registers(101, 2),
        seen=[7, 1102],
    )
    yield Exchange(
        23,
        "most",
        lambda c: c.read_write_registers(100, 125, 104, range(121)),
        [1100, 1101, 1102, 1103, *range(121)],
        look=lambda c: c.read_holding_registers(224, 2),
        seen=[120, 1225],
    )


def refusals() -> Iterator[Exchange]:
    """Requests for addresses that the device does not have, the standard functions all."""
    for function, ask in (
        (1, lambda c: c.read_coils(3000, 1)),
        (2, lambda c: c.read_discrete_inputs(2119, 20)),
        (3, lambda c: c.read_holding_registers(399, 2)),
        (4, lambda c: c.read_input_registers(199, 2)),
        (5, lambda c: c.write_coil(3000, True)),
        (6, lambda c: c.write_register(99, 1)),
        (15, lambda c: c.write_coils(2109, [True] * 20)),
        (16, lambda c: c.write_registers(399, [1, 2])),
        (22, lambda c: c.mask_write_register(400, 0, 0)),
        (23, lambda c: c.read_write_registers(100, 1, 400, [1])),
    ):
        yield Exchange(function, "refused", ask)
