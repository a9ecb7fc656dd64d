"""
The functions beyond tables and files, from client to device over every transport.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import pytest

from libmodbus_py import (
    Access,
    Acknowledge,
    Context,
    Device,
    ExceptionResponse,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    Mapping,
    MemoryParityError,
    NegativeAcknowledge,
    Server,
    ServerDeviceBusy,
    ServerDeviceFailure,
    pdu,
)
from libmodbus_py.protocol.pdu import ServerId, SubFunction
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.cases import each_case
from tests.support.certificates import Papers, secured
from tests.support.peers import UNKNOWN_FUNCTION, FakeServer, mbap

TRANSPORTS = ["tcp", "rtu+tcp", "ascii+tcp", "tls", "rtu", "ascii"]


@contextmanager
def talking_to(device: Device, transport: str, **options: Any) -> Iterator[Context]:
    with ExitStack() as stack:
        if transport == "tls":
            papers = Papers(Path(stack.enter_context(TemporaryDirectory())))
            client = stack.enter_context(secured(Server(device), papers))
        elif transport.endswith("tcp"):
            address = f"{transport}://127.0.0.1:0"
            client = stack.enter_context(Server(device).background(address)).urls[0]
        else:
            wire = stack.enter_context(SerialWire())
            address = f"{transport}://{wire.server}?baudrate=115200"
            stack.enter_context(Server(device).background(address))
            client = f"{transport}://{wire.client}?baudrate=115200"
        yield stack.enter_context(Context.from_url(client, **options))


@pytest.fixture(params=TRANSPORTS)
def transport(request: pytest.FixtureRequest) -> str:
    assert isinstance(request.param, str)
    return request.param


@pytest.fixture
def context(transport: str) -> Iterator[Context]:
    device = Device(
        Mapping(coils=8, holding_registers=8),
        fifos={1246: [440, 4740], 7: [], 8: range(31), 9: range(32)},
        identification={"VendorName": "Company", 4: "Product", 0x80: b"\xff" * 244, 0x81: b"x"},
        server_id=ServerId(b"\x2a", False, b"abc"),
        exception_status=0x6D,
        canopen=lambda data: data[::-1],
    )
    with talking_to(device, transport) as made:
        yield made


@pytest.mark.parametrize("times", [1, 3])
def test_every_function_gives_what_the_device_has(context: Context, times: int) -> None:
    for _ in range(times):
        assert context.read_exception_status() == 0x6D
        assert context.report_server_id() == ServerId(b"\x2a", False, b"abc")
        assert context.diagnostics(SubFunction.RETURN_QUERY_DATA, 0xA537) == 0xA537
        assert context.read_comm_event_counter().status == 0
        assert context.read_comm_event_log().events[:1] == b"\x80"
        assert context.read_fifo_queue(1246) == [440, 4740]
        assert context.read_fifo_queue(7) == []
        assert context.read_fifo_queue(8) == list(range(31))
        assert context.encapsulated_transport(13, b"CANopen") == b"nepoNAC"


def test_queues_refuse_what_they_should(context: Context) -> None:
    with pytest.raises(IllegalDataValue):
        context.read_fifo_queue(9)
    with pytest.raises(IllegalDataAddress):
        context.read_fifo_queue(10)


def test_identification_at_every_level(context: Context) -> None:
    basic = context.read_device_identification()
    assert basic.conformity == 0x83
    assert basic.names == {
        "VendorName": "Company",
        "ProductCode": "Device",
        "MajorMinorRevision": "0.1",
    }
    assert list(context.read_device_identification("regular").objects) == [0, 1, 2, 4]
    extended = context.read_device_identification("extended").objects
    assert extended[0x80] == b"\xff" * 244
    assert list(extended) == [0, 1, 2, 4, 0x80, 0x81]
    assert context.read_device_identification(4).objects == {4: b"Product"}
    with pytest.raises(IllegalDataAddress):
        context.read_device_identification(5)
    with pytest.raises(ValueError, match="level"):
        context.read_device_identification("all")


@each_case(
    "function", [9, 10, 13, 14, 18, 19, 25, 40, UNKNOWN_FUNCTION, 72, 90, 100, 110, 125, 127]
)
def test_codes_nobody_has_are_refused_and_can_be_sent(context: Context, function: int) -> None:
    with pytest.raises(IllegalFunction) as caught:
        context.execute(pdu.RawRequest(function, b"\x01\x02\x03"))
    assert caught.value.function == function


def test_raw_requests_get_raw_answers(context: Context) -> None:
    assert context.execute(pdu.RawRequest(3, b"\0\0\0\2")) == b"\4\0\0\0\0"
    assert context.execute(pdu.RawRequest(7)) == b"\x6d"


# --- functions of one's own ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Reverse(pdu.Request[bytes]):
    """A count byte and that many bytes; they come back reversed."""

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


@pytest.mark.usefixtures("reverse")
def test_a_registered_function_without_handler_is_refused(transport: str) -> None:
    with (
        talking_to(Device(Mapping()), transport) as context,
        pytest.raises(IllegalFunction),
    ):
        context.execute(Reverse(b"x"))


# --- hooks -----------------------------------------------------------------------------------


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


@pytest.mark.parametrize("refusal", REFUSALS)
def test_what_a_hook_raises_comes_out_at_the_client(
    transport: str, refusal: type[ExceptionResponse]
) -> None:
    def refuse(access: Access) -> None:
        raise refusal

    device = Device(Mapping(holding_registers=8), before_write=refuse)
    with talking_to(device, transport) as context:
        for _ in range(2):
            with pytest.raises(refusal) as caught:
                context.write_registers(0, [1, 2])
            assert type(caught.value) is refusal
            assert context.read_holding_registers(0, 2) == [0, 0]


def test_hooks_are_told_who_asks_for_what(transport: str) -> None:
    seen: list[Access] = []
    device = Device(Mapping(holding_registers=8), after_write=seen.append, before_read=seen.append)
    with talking_to(device, transport, unit=5) as context:
        context.write_register(3, 77)
        context.read_holding_registers(2, 4)
    written, read = seen
    assert (written.table, written.address, written.values) == ("holding_registers", 3, (77,))
    assert (read.address, read.count, read.values) == (2, 4, ())
    assert {access.unit for access in seen} == {5}
    assert all(access.peer.startswith(("127.0.0.1:", "/dev/pts/")) for access in seen)


def test_before_read_may_refresh_the_values(transport: str) -> None:
    mapping = Mapping(input_registers=4)
    reads: list[Access] = []

    def refresh(access: Access) -> None:
        reads.append(access)
        mapping.input_registers[0] = len(reads)

    with talking_to(Device(mapping, before_read=refresh), transport) as context:
        assert [context.read_input_registers(0, 1) for _ in range(3)] == [[1], [2], [3]]


# --- retrying ---------------------------------------------------------------------------------


def test_a_busy_device_is_asked_again_if_the_caller_wants() -> None:
    answers = iter([ServerDeviceBusy, Acknowledge, None, ServerDeviceBusy])

    def busy(access: Access) -> None:
        if error := next(answers):
            raise error

    device = Device(Mapping(coils=8), before_read=busy)
    with talking_to(device, "tcp", busy_retries=2) as context:
        start = time.monotonic()
        assert context.read_coils(0, 1) == [False]
        assert time.monotonic() - start >= 0.3
    with talking_to(device, "tcp") as context, pytest.raises(ServerDeviceBusy):
        context.read_coils(0, 1)


# --- identification that goes in circles -------------------------------------------------------


def test_a_device_cannot_lead_the_client_in_circles() -> None:
    def same_again(request: bytes) -> list[bytes]:
        return [mbap(request, bytes.fromhex("2b0e 01 01 ff 00 01 00 01 41"))]

    with FakeServer(same_again) as server:
        context = Context.from_url(f"tcp://127.0.0.1:{server.port}")
        with context, pytest.raises(InvalidResponse, match="next"):
            context.read_device_identification()
        assert len(server.requests) == 1


# --- values -------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["ABCD", "CDAB", "BADC", "DCBA"])
def test_values_are_written_and_read(transport: str, order: str) -> None:
    device = Device(Mapping(holding_registers=200))
    with talking_to(device, transport) as context:
        for kind, values in (
            ("float32", [3.5, -2.25, 1e10]),
            ("int64", [-5]),
            ("uint16", [1, 65535]),
            ("bcd32", [12345678]),
            ("string:6", ["pump 1", "x"]),
        ):
            context.write_values("holding_registers", 10, values, kind, order=order)
            found = context.read_values("holding_registers", 10, kind, len(values), order=order)
            assert found == values


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda context: context.read_values("coils", 0, "int16"), "table"),
        (lambda context: context.read_values("input_registers", 0, "int17"), "type"),
        (lambda context: context.read_values("input_registers", 0, "int32", 63), "count"),
        (lambda context: context.read_values("input_registers", 0, "int16", order="ACDB"), "order"),
        (lambda context: context.write_values("input_registers", 0, [1], "int16"), "table"),
        (lambda context: context.write_values("holding_registers", 0, [], "int16"), "values"),
        (lambda context: context.write_values("holding_registers", 0, [1e40], "float32"), "value"),
    ],
)
def test_bad_values_are_named_and_nothing_is_sent(call, named) -> None:  # type: ignore[no-untyped-def]
    context = Context.from_url("tcp://127.0.0.1:1")
    with pytest.raises((TypeError, ValueError), match=named):
        call(context)


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        (5, "2b0e 04 83 00 00 01 03 01 78"),  # another object
        (5, "2b0e 04 83 00 00 00"),  # none
        ("basic", "2b0e 01 83 00 00 02 00 01 61 00 01 62"),  # one twice
        ("basic", "2b0e 02 83 00 00 01 00 01 61"),  # another level
    ],
)
def test_pages_that_do_not_answer_are_invalid(asked: str | int, answer: str) -> None:
    with FakeServer(lambda request: [mbap(request, bytes.fromhex(answer))]) as server:
        context = Context.from_url(f"tcp://127.0.0.1:{server.port}")
        with context, pytest.raises(InvalidResponse):
            context.read_device_identification(asked)
