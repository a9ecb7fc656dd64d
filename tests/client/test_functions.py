"""Every method of both clients, with the server of this package on every transport."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self

import pytest

from libmodbus_py import (
    Access,
    Acknowledge,
    Client,
    Device,
    ExceptionResponse,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    Mapping,
    Server,
    ServerDeviceBusy,
    ServerDeviceFailure,
    pdu,
)
from libmodbus_py.errors import MemoryParityError, NegativeAcknowledge
from libmodbus_py.protocol.pdu import ServerId, SubFunction
from tests.support.cases import each_case
from tests.support.clients import Connect, making
from tests.support.peers import UNKNOWN_FUNCTION, answering, mbap
from tests.support.transports import serving

UNIT = 17


@pytest.fixture
def url(transport: str, mapping: Mapping) -> Iterator[str]:
    device = Device(
        mapping,
        files={4: range(10_000), 3: {9: 0x33CD, 10: 0x0040}},
        fifos={1246: [440, 4740], 7: [], 8: range(31), 9: range(32)},
        identification={"VendorName": "Company", 4: "Product", 0x80: b"\xff" * 244, 0x81: b"x"},
        server_id=ServerId(b"\x2a", False, b"abc"),
        exception_status=0x6D,
        canopen=lambda data: data[::-1],
    )
    with serving(transport, Server({UNIT: device})) as url:
        yield url


@pytest.fixture
def plc(connect: Connect, url: str) -> Iterator[Any]:
    with connect(url, unit=UNIT) as client:
        yield client


def test_reads_and_writes_use_all_four_tables(plc: Any, mapping: Mapping) -> None:
    for turn in range(3):
        coils = [True, False, True, True, False, False, True, True, True, False]
        assert plc.read_coils(10, 10) == coils
        assert plc.read_discrete_inputs(20, 3) == [False, True, False]
        assert plc.read_holding_registers(100, 3) == [1000, 1001, 1002]
        assert plc.read_input_registers(200, 2) == [2000, 2001]
        assert plc.write_coil(40 + turn, True) is None
        assert plc.write_coils(50, [True, False, True]) is None
        assert plc.write_register(110, 40000 + turn) is None
        assert plc.write_registers(120, [1, 2, 65535]) is None
        assert mapping.coils[40 + turn]
        assert mapping.coils[50:53] == [True, False, True]
        assert mapping.holding_registers[110] == 40000 + turn
        assert mapping.holding_registers[120:123] == [1, 2, 65535]
        assert plc.mask_write_register(120, 0xF0, 0x0F) is None
        assert plc.read_write_registers(120, 2, 121, [7]) == [0x0F, 7]
        assert mapping.holding_registers[120:122] == [0x0F, 7]
    many = [pdu.ReadHoldingRegisters(address, 1) for address in range(130, 170)]
    assert [value for [value] in plc.execute_many(many)] == mapping.holding_registers[130:170]
    points = {"a": ("holding_registers", 100, 2), "b": ("coils", 10, 2)}
    assert plc.read_many(points) == {"a": [1000, 1001], "b": [True, False]}
    assert plc.statistics.responses == plc.statistics.requests


def test_functions_without_a_table_return_their_values(plc: Any) -> None:
    for _ in range(2):
        assert plc.read_exception_status() == 0x6D
        assert plc.report_server_id() == ServerId(b"\x2a", False, b"abc")
        assert plc.diagnostics(SubFunction.RETURN_QUERY_DATA, 0xA537) == 0xA537
        assert plc.read_comm_event_counter().status == 0
        assert plc.read_comm_event_log().events[:1] == b"\x80"
        assert plc.read_fifo_queue(1246) == [440, 4740]
        assert plc.read_fifo_queue(7) == []
        assert plc.read_fifo_queue(8) == list(range(31))
        assert plc.encapsulated_transport(13, b"CANopen") == b"nepoNAC"
        assert plc.execute(pdu.RawRequest(3, b"\0\x65\0\2")) == b"\4\x03\xe9\x03\xea"
        assert plc.execute(pdu.RawRequest(7)) == b"\x6d"
    assert plc.read_file_records([(4, 1, 2), (3, 9, 2)]) == [[1, 2], [0x33CD, 0x40]]
    assert plc.write_file_records([(4, 7, [1711, 1214])]) is None
    assert plc.read_file_records([(4, 7, 2)]) == [[1711, 1214]]


def test_identification_at_every_level(plc: Any) -> None:
    basic = plc.read_device_identification()
    assert basic.conformity == 0x83
    assert basic.names == {
        "VendorName": "Company",
        "ProductCode": "Device",
        "MajorMinorRevision": "0.1",
    }
    assert list(plc.read_device_identification("regular").objects) == [0, 1, 2, 4]
    extended = plc.read_device_identification("extended").objects
    assert extended[0x80] == b"\xff" * 244
    assert list(extended) == [0, 1, 2, 4, 0x80, 0x81]
    assert plc.read_device_identification(4).objects == {4: b"Product"}
    with pytest.raises(IllegalDataAddress):
        plc.read_device_identification(5)
    with pytest.raises(ValueError, match="level"):
        plc.read_device_identification("all")


# The worked example of IEEE 754: 123456.0 is 47 F1 20 00.
VALUES = [
    ("float32", "ABCD", 123_456.0, [0x47F1, 0x2000]),
    ("float32", "CDAB", 123_456.0, [0x2000, 0x47F1]),
    ("float32", "BADC", 123_456.0, [0xF147, 0x0020]),
    ("float32", "DCBA", 123_456.0, [0x0020, 0xF147]),
    ("int16", "ABCD", -2, [0xFFFE]),
    ("int64", "ABCD", -5, [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFB]),
    ("string:4", "ABCD", "ABC", [0x4142, 0x4300]),
    ("bcd32", "ABCD", 12_345_678, [0x1234, 0x5678]),
    ("bits16", "ABCD", [True, *[False] * 14, True], [0x8001]),
]


def test_typed_values_are_written_and_read_in_any_order(plc: Any, mapping: Mapping) -> None:
    for type_, order, value, cells in VALUES:
        plc.write_value("holding_registers", 120, value, type_, order=order)
        assert mapping.holding_registers[120 : 120 + len(cells)] == cells
        mapping.input_registers[210 : 210 + len(cells)] = cells
        for table, address in (("holding_registers", 120), ("input_registers", 210)):
            assert plc.read_value(table, address, type_, order=order) == value
    for type_, values in (("float32", [3.5, -2.25, 1e10]), ("string:6", ["pump 1", "x"])):
        plc.write_values("holding_registers", 130, values, type_, order="CDAB")
        result = plc.read_values("holding_registers", 130, type_, len(values), order="CDAB")
        assert result == values


def test_refusals_name_what_was_asked(plc: Any) -> None:
    for _ in range(2):
        with pytest.raises(IllegalDataAddress) as caught:
            plc.read_holding_registers(399, 2)
        error = caught.value
        assert (error.unit, error.function, error.code) == (UNIT, 3, 2)
        assert "ReadHoldingRegisters(address=399, count=2)" in str(error)
        assert error.sent
        assert error.received
        with pytest.raises(IllegalDataValue):
            plc.read_fifo_queue(9)
        with pytest.raises(IllegalDataAddress):
            plc.read_fifo_queue(10)
        assert plc.read_holding_registers(100, 1) == [1000]
    assert plc.statistics.exceptions == 6


@each_case(
    "function", [9, 10, 13, 14, 18, 19, 25, 40, UNKNOWN_FUNCTION, 72, 90, 100, 110, 125, 127]
)
def test_unknown_codes_are_refused_and_can_be_sent(plc: Any, function: int) -> None:
    with pytest.raises(IllegalFunction) as caught:
        plc.execute(pdu.RawRequest(function, b"\x01\x02\x03"))
    assert caught.value.function == function


def test_a_client_is_a_context_for_any_url(url: str) -> None:
    with Client(url, unit=UNIT, timeout=2) as client:
        assert isinstance(client, Client)
        assert client.read_holding_registers(100, 3) == [1000, 1001, 1002]
        assert (client.unit, client.timeout) == (UNIT, 2)
        assert client.url == Client(url).url
        assert repr(client) == f"<Client {client.url}, unit {UNIT}, connected>"


@pytest.mark.parametrize("transport", ["rtu+tcp", "ascii+tcp", "rtu+udp", "rtu", "ascii"])
def test_a_broadcast_reaches_every_unit_and_is_not_answered(transport: str) -> None:
    devices = {unit: Device(Mapping(holding_registers=8)) for unit in (1, 2)}
    with serving(transport, Server(devices)) as url, Client(url, unit=0) as line:
        assert line.write_register(3, 9) is None
        for unit in devices:
            assert line.for_unit(unit).read_holding_registers(2, 2) == [0, 9]
        assert line.statistics.late_answers == 0


@contextmanager
def talking_to(device: Device, transport: str, **options: Any) -> Iterator[Client]:
    with serving(transport, Server(device)) as url, Client(url, **options) as client:
        yield client


@dataclass(frozen=True, slots=True)
class Reverse(pdu.Request[bytes]):
    """A count byte and that many bytes, which are returned in reverse."""

    data: bytes

    function = UNKNOWN_FUNCTION
    request_length = pdu.counted(2, at=1)
    response_length = pdu.counted(2, at=1)

    def encode(self) -> bytes:
        return bytes([self.function, len(self.data)]) + self.data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(pdu[2:])

    def encode_response(self, result: bytes) -> bytes:
        return bytes([self.function, len(result)]) + result

    def _decode_response(self, pdu: bytes) -> bytes:
        return pdu[2:]


@pytest.fixture
def reverse() -> Iterator[None]:
    pdu.register(Reverse)
    yield
    del pdu.REQUESTS[Reverse.function]


@pytest.mark.usefixtures("reverse")
def test_a_function_of_ones_own_works_at_both_ends(transport: str) -> None:
    def handle(request: Reverse) -> bytes:
        if not request.data:
            raise IllegalDataValue
        return request.data[::-1]

    device = Device(Mapping(coils=8), handlers={Reverse: handle})
    with talking_to(device, transport) as context:
        for _ in range(3):
            assert context.execute(Reverse(b"drawer")) == b"reward"
            assert context.read_coils(0, 1) == [False]
        with pytest.raises(IllegalDataValue):
            context.execute(Reverse(b""))


REFUSALS = [
    IllegalFunction,
    IllegalDataAddress,
    IllegalDataValue,
    ServerDeviceFailure,
    Acknowledge,
    ServerDeviceBusy,
    NegativeAcknowledge,
    MemoryParityError,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
]


def test_an_exception_of_a_hook_at_the_server_is_raised_at_the_client(transport: str) -> None:
    refusals: list[type[ExceptionResponse]] = []

    def refuse(access: Access) -> None:
        raise refusals[-1]

    device = Device(Mapping(holding_registers=8), before_write=refuse)
    with talking_to(device, transport) as context:
        for refusal in REFUSALS * 2:
            refusals.append(refusal)
            with pytest.raises(refusal) as caught:
                context.write_registers(0, [1, 2])
            assert type(caught.value) is refusal
            assert context.read_holding_registers(0, 2) == [0, 0]


def test_hooks_get_unit_and_peer_of_requests(transport: str) -> None:
    log: list[Access] = []
    device = Device(Mapping(holding_registers=8), after_write=log.append, before_read=log.append)
    with talking_to(device, transport, unit=5) as context:
        context.write_register(3, 77)
        context.read_holding_registers(2, 4)
    write, read = log
    assert (write.table, write.address, write.values) == ("holding_registers", 3, (77,))
    assert (read.address, read.count, read.values) == (2, 4, ())
    assert {access.unit for access in log} == {5}
    assert all(access.peer.startswith(("127.0.0.1:", "/dev/pts/")) for access in log)


@each_case(
    ("level", "answer"),
    [
        ("basic", "2b0e 01 01 ff 00 01 00 01 41"),  # the same page again
        (5, "2b0e 04 83 00 00 01 03 01 78"),  # another object
        (5, "2b0e 04 83 00 00 00"),  # none
        ("basic", "2b0e 01 83 00 00 02 00 01 61 00 01 62"),  # one twice
        ("basic", "2b0e 02 83 00 00 01 00 01 61"),  # another level
    ],
)
def test_identification_pages_for_other_objects_are_invalid(level: str | int, answer: str) -> None:
    page = bytes.fromhex(answer)
    with making("blocking") as world:
        peer = world.peer("tcp", answering(lambda request: [mbap(request, page)]))
        with world.connect(peer.url) as plc, pytest.raises(InvalidResponse):
            plc.read_device_identification(level)
        assert len(peer.requests) == 1
