"""
Against pymodbus: its clients on our server, our contexts on its servers, over
every transport. Where pymodbus errs, a test pins what it does and what we make of it.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, NamedTuple

import pytest
from interop import (
    BAUDRATE,
    COILS,
    DISCRETE_INPUTS,
    HOLDING_REGISTERS,
    INPUT_REGISTERS,
    TIMEOUT,
    UNIT,
    Exchange,
    Place,
    case_id,
    cells,
    coil,
    discrete_input,
    exchanges,
    holding_register,
    input_register,
    make_device,
    our_server,
    record,
    refusals,
)
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException, ModbusIOException
from pymodbus.framer import FramerType
from pymodbus.pdu.file_message import FileRecord
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from libmodbus_py import (
    Context,
    Device,
    IllegalDataAddress,
    InvalidResponse,
    ServerDeviceFailure,
)
from libmodbus_py.tap import SerialWire

FRAMERS = {
    "tcp": FramerType.SOCKET,
    "rtu": FramerType.RTU,
    "ascii": FramerType.ASCII,
    "rtu+tcp": FramerType.RTU,
    "ascii+tcp": FramerType.ASCII,
}
TRANSPORTS = tuple(FRAMERS)


# A pseudo-terminal has neither parity nor 7 bits, and pyserial insists on what it set.
SERIAL_SETTINGS: dict[str, Any] = {"baudrate": BAUDRATE, "parity": "N", "bytesize": 8}


# --- pymodbus's client, our server -----------------------------------------------------------


@contextlib.contextmanager
def pymodbus_client(transport: str, place: Place, timeout: float = TIMEOUT) -> Iterator[Any]:
    options: dict[str, Any] = {"framer": FRAMERS[transport], "timeout": timeout, "retries": 0}
    client: ModbusTcpClient | ModbusSerialClient
    if transport.endswith("tcp"):
        client = ModbusTcpClient(place.end.host, port=place.end.port, **options)
    else:
        client = ModbusSerialClient(place.end.device, **SERIAL_SETTINGS, **options)
    assert client.connect()
    try:
        yield client
    finally:
        client.close()


class Asked(NamedTuple):
    """One request of pymodbus's client, and what our device has to say to it."""

    function: int
    name: str
    ask: Callable[[Any], Any]
    answer: Callable[[Any], object] = lambda response: None
    expected: object = None
    look: Callable[[Device], object] = lambda device: None
    seen: object = None


def bits(count: int) -> Callable[[Any], list[bool]]:
    """It gives whole bytes of bits; what is beyond the count means nothing."""
    return lambda response: response.bits[:count]


def registers(response: Any) -> list[int]:
    return response.registers


def pieces(response: Any) -> list[bytes]:
    return [piece.record_data for piece in response.records]


def as_bytes(values: list[int]) -> bytes:
    return b"".join(value.to_bytes(2, "big") for value in values)


def piece_to_read(file: int, start: int, count: int) -> FileRecord:
    """pymodbus counts bytes here, though it sends registers."""
    return FileRecord(file_number=file, record_number=start, record_length=2 * count)


def piece_to_write(file: int, start: int, values: list[int]) -> FileRecord:
    return FileRecord(file_number=file, record_number=start, record_data=as_bytes(values))


def asked() -> Iterator[Asked]:
    unit = {"device_id": UNIT}
    for name, first, count in (("few", 12, 3), ("most", 10, 2000)):
        yield Asked(
            1,
            name,
            lambda c, first=first, count=count: c.read_coils(first, count=count, **unit),
            bits(count),
            cells(coil, first, count),
        )
    for name, first, count in (("few", 20, 9), ("most", 20, 2000)):
        yield Asked(
            2,
            name,
            lambda c, first=first, count=count: c.read_discrete_inputs(first, count=count, **unit),
            bits(count),
            cells(discrete_input, first, count),
        )
    for name, first, count in (("few", 399, 1), ("most", 100, 125)):
        yield Asked(
            3,
            name,
            lambda c, first=first, count=count: c.read_holding_registers(
                first, count=count, **unit
            ),
            registers,
            cells(holding_register, first, count),
        )
    for name, first, count in (("few", 200, 2), ("most", 275, 125)):
        yield Asked(
            4,
            name,
            lambda c, first=first, count=count: c.read_input_registers(first, count=count, **unit),
            registers,
            cells(input_register, first, count),
        )
    for name, address, value in (("on", 10, True), ("off", 12, False)):
        yield Asked(
            5,
            name,
            lambda c, address=address, value=value: c.write_coil(address, value, **unit),
            look=lambda d, address=address: d.mapping.coils[address : address + 2],
            seen=[value, coil(address + 1)],
        )
    yield Asked(
        6,
        "few",
        lambda c: c.write_register(101, 65535, **unit),
        look=lambda d: d.mapping.holding_registers[100:103],
        seen=[1100, 65535, 1102],
    )
    for name, first, count in (("few", 13, 3), ("most", 11, 1968)):
        other = [not value for value in cells(coil, first, count)]
        yield Asked(
            15,
            name,
            lambda c, first=first, other=other: c.write_coils(first, other, **unit),
            look=lambda d, first=first, count=count: d.mapping.coils[first - 1 : first + count + 1],
            seen=[coil(first - 1), *other, coil(first + count)],
        )
    for name, first, count in (("few", 397, 2), ("most", 101, 123)):
        yield Asked(
            16,
            name,
            lambda c, first=first, count=count: c.write_registers(
                first, list(range(count)), **unit
            ),
            look=lambda d, first=first, count=count: d.mapping.holding_registers[
                first - 1 : first + count + 1
            ],
            seen=[holding_register(first - 1), *range(count), holding_register(first + count)],
        )
    yield Asked(
        20,
        "few",
        lambda c: c.read_file_record([piece_to_read(4, 7, 3), piece_to_read(3, 9, 2)], **unit),
        pieces,
        [as_bytes([5007, 5008, 5009]), as_bytes([0x33CD, 0x0040])],
    )
    yield Asked(
        20,
        "most",  # 2 + 242 bytes, the 245 of the specification less the odd one
        lambda c: c.read_file_record([piece_to_read(4, 10, 121)], **unit),
        pieces,
        [as_bytes(cells(record, 10, 121))],
    )
    yield Asked(
        21,
        "few",
        lambda c: c.write_file_record(
            [piece_to_write(4, 7, [1, 65535]), piece_to_write(3, 10, [2])], **unit
        ),
        pieces,
        [as_bytes([1, 65535]), as_bytes([2])],
        look=lambda d: [d.files[4].read(6, 4), list(d.files[3])],
        seen=[[5006, 1, 65535, 5009], [0x33CD, 2]],
    )
    yield Asked(
        21,
        "most",  # 7 + 244 bytes
        lambda c: c.write_file_record([piece_to_write(4, 1, list(range(122)))], **unit),
        look=lambda d: d.files[4].read(0, 124),
        seen=[5000, *range(122), 5123],
    )
    yield Asked(
        22,
        "few",
        lambda c: c.mask_write_register(address=250, and_mask=0x00F0, or_mask=0xA50F, **unit),
        look=lambda d: d.mapping.holding_registers[249:252],
        seen=[1249, 0xA5EF, 1251],
    )
    for name, count, first, written in (("few", 2, 101, 1), ("most", 125, 104, 121)):
        after = cells(holding_register, 100, 300)
        after[first - 100 : first - 100 + written] = range(written)
        yield Asked(
            23,
            name,
            lambda c, count=count, first=first, written=written: c.readwrite_registers(
                read_address=100,
                read_count=count,
                write_address=first,
                values=list(range(written)),
                **unit,
            ),
            registers,
            after[:count],
            look=lambda d: d.mapping.holding_registers[:],
            seen=after,
        )


def asked_in_vain() -> Iterator[Asked]:
    """Requests that must be refused; `expected` is the exception code."""
    unit = {"device_id": UNIT}
    for function, ask in (
        (1, lambda c: c.read_coils(3000, **unit)),
        (2, lambda c: c.read_discrete_inputs(2119, count=2, **unit)),
        (3, lambda c: c.read_holding_registers(399, count=2, **unit)),
        (4, lambda c: c.read_input_registers(199, count=2, **unit)),
        (5, lambda c: c.write_coil(2110, True, **unit)),
        (6, lambda c: c.write_register(99, 1, **unit)),
        (15, lambda c: c.write_coils(2109, [True, True], **unit)),
        (16, lambda c: c.write_registers(399, [1, 2], **unit)),
        (20, lambda c: c.read_file_record([piece_to_read(3, 9, 3)], **unit)),
        (
            21,
            lambda c: c.write_file_record(
                [piece_to_write(4, 0, [1]), piece_to_write(9, 0, [1])], **unit
            ),
        ),
        (22, lambda c: c.mask_write_register(address=400, and_mask=0, or_mask=0, **unit)),
        (
            23,
            lambda c: c.readwrite_registers(
                read_address=399, read_count=2, write_address=100, values=[1], **unit
            ),
        ),
    ):
        yield Asked(function, "refused", ask, expected=2)
    for function, ask in (
        (7, lambda c: c.read_exception_status(**unit)),
        (8, lambda c: c.diag_query_data(b"\x12\x34", **unit)),
        (11, lambda c: c.diag_get_comm_event_counter(**unit)),
        (12, lambda c: c.diag_get_comm_event_log(**unit)),
        (17, lambda c: c.report_device_id(**unit)),
        (24, lambda c: c.read_fifo_queue(address=100, **unit)),
        (43, lambda c: c.read_device_information(read_code=1, object_id=0, **unit)),
    ):
        yield Asked(function, "refused", ask, expected=1)


def to_our_server(cases: Iterator[Asked]) -> Any:
    return pytest.mark.parametrize(
        ("case", "transport"),
        [
            pytest.param(
                case,
                transport,
                id=case_id("pymodbus", "server", transport, case.function, case.name),
            )
            for case in cases
            for transport in TRANSPORTS
        ],
    )


@to_our_server(asked())
def test_pymodbus_client_and_our_server_agree(case: Asked, transport: str) -> None:
    device = make_device()
    with our_server(transport, {UNIT: device}) as place:
        with pymodbus_client(transport, place) as client:
            response = case.ask(client)
        assert not response.isError(), response
        assert case.answer(response) == case.expected
        assert case.look(device) == case.seen
        assert place.function == case.function


@to_our_server(asked_in_vain())
def test_pymodbus_client_sees_our_refusal_and_nothing_changes(case: Asked, transport: str) -> None:
    device, untouched = make_device(), make_device()
    with our_server(transport, {UNIT: device}) as place:
        with pymodbus_client(transport, place) as client:
            response = case.ask(client)
            assert response.isError()
            assert response.exception_code == case.expected
            # and the line goes on
            assert client.read_coils(12, device_id=UNIT).bits[0] is True
        assert place.function == case.function
    assert device.mapping.coils[:] == untouched.mapping.coils[:]
    assert device.mapping.holding_registers[:] == untouched.mapping.holding_registers[:]
    assert list(device.files[4]) == list(untouched.files[4])


@pytest.mark.parametrize("transport", [each for each in TRANSPORTS if each != "tcp"])
def test_unit_without_a_device_is_silent_to_pymodbus_on_a_line(transport: str) -> None:
    with (
        our_server(transport, {UNIT: make_device()}) as place,
        pymodbus_client(transport, place, timeout=0.2) as client,
    ):
        with pytest.raises(ModbusIOException):
            client.read_coils(10, device_id=UNIT + 1)
        client.comm_params.timeout_connect = TIMEOUT
        assert client.read_coils(12, device_id=UNIT).bits[0] is True


def test_unit_without_a_device_is_exception_11_to_pymodbus_over_tcp() -> None:
    with (
        our_server("tcp", {UNIT: make_device()}) as place,
        pymodbus_client("tcp", place) as client,
    ):
        assert client.read_coils(10, device_id=UNIT + 1).exception_code == 11


@pytest.mark.parametrize("transport", [each for each in TRANSPORTS if each != "tcp"])
def test_broadcast_of_pymodbus_reaches_every_unit_and_is_not_answered(transport: str) -> None:
    devices = {UNIT: make_device(), UNIT + 1: make_device()}
    with our_server(transport, devices) as place, pymodbus_client(transport, place) as client:
        client.write_register(100, 7, device_id=0, no_response_expected=True)
        for unit in devices:
            response = client.read_holding_registers(100, device_id=unit)
            assert (response.dev_id, response.registers) == (unit, [7])
    assert [device.mapping.holding_registers[100] for device in devices.values()] == [7, 7]


def test_two_pymodbus_clients_share_one_server_over_tcp() -> None:
    with (
        our_server("tcp", {UNIT: make_device()}) as place,
        pymodbus_client("tcp", place) as first,
        pymodbus_client("tcp", place) as second,
    ):
        for value in range(5):
            first.write_register(100, value, device_id=UNIT)
            assert second.read_holding_registers(100, device_id=UNIT).registers == [value]


class TestWherePymodbusClientErrs:
    @pytest.mark.parametrize(
        "transport",
        [
            pytest.param(each, id=case_id("pymodbus", "server", each, 15, "pinned"))
            for each in TRANSPORTS
        ],
    )
    def test_more_coils_than_a_write_may_have_are_refused(self, transport: str) -> None:
        # It sends 1969 coils without a word; they just fit a frame, but not the rule.
        device = make_device()
        with (
            our_server(transport, {UNIT: device}) as place,
            pymodbus_client(transport, place) as client,
        ):
            response = client.write_coils(10, [True] * 1969, device_id=UNIT)
            assert response.exception_code == 3
            assert device.mapping.coils[10:1979] == cells(coil, 10, 1969)

    def test_frame_that_is_too_long_ends_only_its_own_connection(self) -> None:
        # 2000 coils make a PDU of 256 bytes, where 253 is the limit.
        device = make_device()
        with our_server("tcp", {UNIT: device}) as place:
            with pymodbus_client("tcp", place) as client:
                with pytest.raises(ModbusException):
                    client.write_coils(10, [True] * 2000, device_id=UNIT)
                assert client.read_coils(12, device_id=UNIT).bits[0] is True  # it connects again
            assert device.mapping.coils[10:2010] == cells(coil, 10, 2000)

    @pytest.mark.parametrize(
        "transport",
        [
            pytest.param(each, id=case_id("pymodbus", "server", each, 20, "pinned"))
            for each in TRANSPORTS
        ],
    )
    def test_record_length_is_halved_on_the_way(self, transport: str) -> None:
        # record_length is in bytes for it, although the field of the frame is in
        # registers: 4 asks for two registers, and an odd one cannot be asked for.
        asked = FileRecord(file_number=4, record_number=7, record_length=4)
        with (
            our_server(transport, {UNIT: make_device()}) as place,
            pymodbus_client(transport, place) as client,
        ):
            response = client.read_file_record([asked], device_id=UNIT)
            assert pieces(response) == [as_bytes([5007, 5008])]
        with pytest.raises(ModbusException, match="multiple of 2"):
            FileRecord(file_number=4, record_number=7, record_length=3)


# --- our contexts, pymodbus's server --------------------------------------------------------------


def simulated_device() -> SimDevice:
    """The tables of make_device; pymodbus has no files."""
    tables = (
        (COILS, coil, DataType.BITS),
        (DISCRETE_INPUTS, discrete_input, DataType.BITS),
        (HOLDING_REGISTERS, holding_register, DataType.REGISTERS),
        (INPUT_REGISTERS, input_register, DataType.REGISTERS),
    )
    coils, inputs, holdings, readings = (
        [SimData(addresses.start, values=[value(each) for each in addresses], datatype=kind)]
        for addresses, value, kind in tables
    )
    return SimDevice(UNIT, simdata=(coils, inputs, holdings, readings))


@contextlib.contextmanager
def in_background(make_server: Callable[[], Any]) -> Iterator[Any]:
    """Run a server of pymodbus in a thread with a loop of its own."""
    started: Future[tuple[Any, Callable[[], object]]] = Future()

    async def serve() -> None:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        server = make_server()
        await server.serve_forever(background=True)
        started.set_result((server, lambda: loop.call_soon_threadsafe(stop.set)))
        await stop.wait()
        await server.shutdown()

    def run() -> None:
        try:
            asyncio.run(serve())
        except BaseException as error:
            if started.done():
                raise
            started.set_exception(error)

    thread = threading.Thread(target=run, name="pymodbus server")
    thread.start()
    try:
        server, stop = started.result()
        try:
            yield server
        finally:
            stop()
    finally:
        thread.join()


@contextlib.contextmanager
def pymodbus_server(transport: str, **options: Any) -> Iterator[Context]:
    """Give a context of ours that is connected to a server of pymodbus."""
    options = {"unit": UNIT, "timeout": TIMEOUT, **options}
    framer = FRAMERS[transport]
    if transport.endswith("tcp"):

        def make_tcp() -> ModbusTcpServer:
            return ModbusTcpServer(simulated_device(), framer=framer, address=("127.0.0.1", 0))

        with in_background(make_tcp) as server:
            port = server.transport.sockets[0].getsockname()[1]
            with Context.from_url(f"{transport}://127.0.0.1:{port}", **options) as context:
                yield context
        return
    with SerialWire() as wire:

        def make_serial() -> ModbusSerialServer:
            return ModbusSerialServer(
                simulated_device(), framer=framer, port=wire.server, **SERIAL_SETTINGS
            )

        with in_background(make_serial):
            address = f"{transport}://{wire.client}?baudrate={BAUDRATE}"
            with Context.from_url(address, **options) as context:
                yield context


# Framings that libmodbus does not speak, or not there, have one way only.
WAYS: dict[str, dict[str, dict[str, Any]]] = {
    transport: (
        {"either": {"native": None}, "python": {"native": False}}
        if transport in ("tcp", "rtu")
        else {"python": {}}
    )
    for transport in TRANSPORTS
}


def to_pymodbus_server(cases: Iterator[Exchange]) -> Any:
    return pytest.mark.parametrize(
        ("exchange", "transport", "options"),
        [
            pytest.param(
                exchange,
                transport,
                options,
                id=case_id("pymodbus", "client", transport, exchange.function, exchange.name, way),
            )
            for exchange in cases
            for transport in TRANSPORTS
            for way, options in WAYS[transport].items()
        ],
    )


@to_pymodbus_server(exchanges())
def test_context_and_pymodbus_server_agree(
    exchange: Exchange, transport: str, options: dict[str, Any]
) -> None:
    with pymodbus_server(transport, **options) as context:
        for _ in range(2):  # with native=None the second goes through libmodbus
            assert exchange.ask(context) == exchange.answer
            assert exchange.look(context) == exchange.seen


@to_pymodbus_server(refusals())
def test_context_raises_what_pymodbus_server_refuses(
    exchange: Exchange, transport: str, options: dict[str, Any]
) -> None:
    with pymodbus_server(transport, **options) as context:
        for _ in range(2):
            with pytest.raises(IllegalDataAddress) as caught:
                exchange.ask(context)
            assert caught.value.function == exchange.function
        assert context.read_holding_registers(399, 1) == [1399]


def pinned(function: int) -> Any:
    return pytest.mark.parametrize(
        "transport",
        [
            pytest.param(each, id=case_id("pymodbus", "client", each, function, "pinned"))
            for each in TRANSPORTS
        ],
    )


class TestWherePymodbusServerErrs:
    @pinned(20)
    def test_file_reads_give_its_dummy_or_an_error(self, transport: str) -> None:
        # Whatever file, record and length are asked for, it answers these 20 bytes.
        # We believe them where ten registers were asked for; any other length is no
        # answer. An odd length it cannot decode, and answers function 0 with 80 01.
        dummy = b"SERVER DUMMY RECORD."
        # On a line every error costs a timeout of silence before the next request.
        with pymodbus_server(transport, timeout=0.6) as context:
            ten = context.read_file_records([(4, 0, 10), (65535, 9990, 10)])
            assert [as_bytes(piece) for piece in ten] == [dummy, dummy]
            for length in (2, 9):
                with pytest.raises(InvalidResponse) as caught:
                    context.read_file_records([(4, 0, length)])
                assert caught.value.function == 20
                assert caught.value.received
            assert context.read_holding_registers(100, 1) == [1100]

    @pinned(21)
    def test_file_writes_are_echoed_and_not_done(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            values = list(range(10))
            context.write_file_records([(4, 0, values), (3, 5, [1, 2, 3])])
            assert context.read_file_records([(4, 0, 10)]) != [values]

    @pinned(23)
    def test_refused_read_write_has_written(self, transport: str) -> None:
        # Its write is done before the read is checked; that we pass on, and our own
        # server writes nothing (test_pymodbus_client_sees_our_refusal...).
        with pymodbus_server(transport) as context:
            with pytest.raises(IllegalDataAddress):
                context.read_write_registers(399, 2, 100, [55])
            assert context.read_holding_registers(100, 2) == [55, 1101]

    @pytest.mark.parametrize("transport", TRANSPORTS)
    def test_unit_that_it_lacks_is_server_device_failure(self, transport: str) -> None:
        # Its simulator looks for a unit 0 instead, finds none, and answers the
        # KeyError as exception 4; on a serial line it should be silent.
        with pymodbus_server(transport) as context:
            with pytest.raises(ServerDeviceFailure):
                context.for_unit(UNIT + 1).read_coils(10, 1)
            assert context.read_coils(12, 1) == [True]

    @pytest.mark.parametrize("transport", [each for each in TRANSPORTS if each != "tcp"])
    def test_answer_to_a_broadcast_is_not_taken_for_the_next_one(self, transport: str) -> None:
        # Unit 0 is a unit like any other for it, so that it answers broadcasts.
        with pymodbus_server(transport, turnaround=0.1) as context:
            context.for_unit(0).write_register(100, 7)
            assert context.read_holding_registers(100, 2) == [1100, 1101]
            context.write_register(100, 8)
            assert context.read_holding_registers(100, 2) == [8, 1101]
