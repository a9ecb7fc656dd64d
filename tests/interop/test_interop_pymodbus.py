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
from functools import partial
from operator import attrgetter, methodcaller
from typing import Any, NamedTuple

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException, ModbusIOException
from pymodbus.framer import FramerType
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.device import ModbusControlBlock
from pymodbus.pdu.diag_message import RestartCommunicationsOptionRequest
from pymodbus.pdu.file_message import FileRecord
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from libmodbus_py import (
    Context,
    Device,
    IllegalDataAddress,
    IllegalFunction,
    InvalidResponse,
    ModbusError,
    ModbusTimeoutError,
    pdu,
)
from libmodbus_py.protocol.pdu import SubFunction
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.cases import each
from tests.support.interop import (
    BAUDRATE,
    COILS,
    DISCRETE_INPUTS,
    EXCEPTION_STATUS,
    FIFOS,
    HOLDING_REGISTERS,
    INPUT_REGISTERS,
    OBJECTS,
    SERVER_ID,
    TIMEOUT,
    UNIT,
    UNKNOWN_FUNCTIONS,
    Exchange,
    Place,
    Record,
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
    restore,
    restore_through,
    tried,
)
from tests.support.peers import until

FRAMERS = {
    "tcp": FramerType.SOCKET,
    "rtu": FramerType.RTU,
    "ascii": FramerType.ASCII,
    "rtu+tcp": FramerType.RTU,
    "ascii+tcp": FramerType.ASCII,
}
TRANSPORTS = tuple(FRAMERS)
SERIAL = tuple(each for each in TRANSPORTS if each != "tcp")
# It finds the end of RTU frames by lengths that are wrong for some functions.
NOT_RTU = ("tcp", "ascii", "ascii+tcp")
ON_RTU = ("rtu", "rtu+tcp")


# A pseudo-terminal has neither parity nor 7 bits, and pyserial insists on what it set.
SERIAL_SETTINGS: dict[str, Any] = {"baudrate": BAUDRATE, "parity": "N", "bytesize": 8}


def over(role: str, function: int, *more: str, transports: tuple[str, ...] = TRANSPORTS) -> Any:
    """Run a test over each transport; `interop_report` finds it by the id, see `case_id`."""
    ids = [case_id("pymodbus", role, each, function, *more) for each in transports]
    return pytest.mark.parametrize("transport", transports, ids=ids)


# --- pymodbus's client, our server -----------------------------------------------------------


@contextlib.contextmanager
def pymodbus_client(transport: str, place: Place, timeout: float = TIMEOUT) -> Iterator[Any]:
    options: dict[str, Any] = {"framer": FRAMERS[transport], "timeout": timeout, "retries": 0}
    client: ModbusTcpClient | ModbusSerialClient
    if transport.endswith("tcp"):
        client = ModbusTcpClient(place.end.host, port=place.end.port, **options)
    else:
        client = ModbusSerialClient(place.end.path, **SERIAL_SETTINGS, **options)
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
    transports: tuple[str, ...] = TRANSPORTS


def message(response: Any) -> object:
    return response.message


def bits(count: int) -> Callable[[Any], list[bool]]:
    """It gives whole bytes of bits; what is beyond the count means nothing."""
    return lambda response: response.bits[:count]


def call(method: str, *arguments: Any, **options: Any) -> Callable[[Any], Any]:
    """Return what calls a method of pymodbus's client for our unit."""
    return methodcaller(method, *arguments, **{"device_id": UNIT, **options})


def span(table: str, start: int, stop: int) -> Callable[[Device], Any]:
    """Return what looks at the cells of a device from one address up to another."""
    return lambda device: getattr(device.mapping, table)[start:stop]


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
    for function, method, cell, few, most in (
        (1, "read_coils", coil, (12, 3), (10, 2000)),
        (2, "read_discrete_inputs", discrete_input, (20, 9), (20, 2000)),
        (3, "read_holding_registers", holding_register, (399, 1), (100, 125)),
        (4, "read_input_registers", input_register, (200, 2), (275, 125)),
    ):
        for name, (first, count) in (("few", few), ("most", most)):
            answer = bits(count) if function < 3 else registers
            ask = call(method, first, count=count)
            yield Asked(function, name, ask, answer, cells(cell, first, count))
    for name, address, value in (("on", 10, True), ("off", 12, False)):
        look = span("coils", address, address + 2)
        ask = call("write_coil", address, value)
        yield Asked(5, name, ask, look=look, seen=[value, coil(address + 1)])
    look = span("holding_registers", 100, 103)
    yield Asked(6, "few", call("write_register", 101, 65535), look=look, seen=[1100, 65535, 1102])
    for name, first, count in (("few", 13, 3), ("most", 11, 1968)):
        other = [not value for value in cells(coil, first, count)]
        seen: list[Any] = [coil(first - 1), *other, coil(first + count)]
        look = span("coils", first - 1, first + count + 1)
        yield Asked(15, name, call("write_coils", first, other), look=look, seen=seen)
    for name, first, count in (("few", 397, 2), ("most", 101, 123)):
        seen = [holding_register(first - 1), *range(count), holding_register(first + count)]
        look = span("holding_registers", first - 1, first + count + 1)
        yield Asked(
            16, name, call("write_registers", first, list(range(count))), look=look, seen=seen
        )
    yield from asked_of_files()
    yield Asked(
        22,
        "few",
        call("mask_write_register", address=250, and_mask=0x00F0, or_mask=0xA50F),
        look=span("holding_registers", 249, 252),
        seen=[1249, 0xA5EF, 1251],
    )
    for name, count, first, written in (("few", 2, 101, 1), ("most", 125, 104, 121)):
        after = cells(holding_register, 100, 300)
        after[first - 100 : first - 100 + written] = range(written)
        given = {"read_address": 100, "read_count": count, "write_address": first}
        ask = call("readwrite_registers", **given, values=list(range(written)))
        look = span("holding_registers", 100, 400)
        yield Asked(23, name, ask, registers, after[:count], look=look, seen=after)
    yield from asked_beside_the_tables()


def asked_of_files() -> Iterator[Asked]:
    few = [piece_to_read(4, 7, 3), piece_to_read(3, 9, 2)]
    found = [as_bytes([5007, 5008, 5009]), as_bytes([0x33CD, 0x0040])]
    yield Asked(20, "few", call("read_file_record", few), pieces, found)
    # 2 + 242 bytes, the 245 of the specification less the odd one
    found = [as_bytes(cells(record, 10, 121))]
    yield Asked(20, "most", call("read_file_record", [piece_to_read(4, 10, 121)]), pieces, found)
    yield Asked(
        21,
        "few",
        call("write_file_record", [piece_to_write(4, 7, [1, 65535]), piece_to_write(3, 10, [2])]),
        pieces,
        [as_bytes([1, 65535]), as_bytes([2])],
        look=lambda d: [d.files[4].read(6, 4), list(d.files[3])],
        seen=[[5006, 1, 65535, 5009], [0x33CD, 2]],
    )
    yield Asked(
        21,
        "most",  # 7 + 244 bytes
        call("write_file_record", [piece_to_write(4, 1, list(range(122)))]),
        look=lambda d: d.files[4].read(0, 124),
        seen=[5000, *range(122), 5123],
    )


def asked_beside_the_tables() -> Iterator[Asked]:
    status = attrgetter("status")
    yield Asked(7, "status", call("read_exception_status"), status, EXCEPTION_STATUS)
    most = bytes(range(250))
    yield Asked(8, "query", call("diag_query_data", b"\xa5\x37"), message, b"\xa5\x37")
    ask = call("diag_query_data", most)
    yield Asked(8, "query-most", ask, message, most, transports=NOT_RTU)
    ask = call("diag_restart_communication", True)
    yield Asked(8, "restart", ask, message, 0xFF00, transports=SERIAL)
    for name, method, answer in (
        ("register", "diag_read_diagnostic_register", 0),
        ("clear", "diag_clear_counters", 0),
        ("messages", "diag_read_bus_message_count", 1),  # the request itself
        ("errors", "diag_read_bus_comm_error_count", 0),
        ("exceptions", "diag_read_bus_exception_error_count", 0),
        ("served", "diag_read_device_message_count", 1),
        ("unanswered", "diag_read_device_no_response_count", 0),
        ("nak", "diag_read_device_nak_count", 0),
        ("busy", "diag_read_device_busy_count", 0),
        ("overrun", "diag_read_bus_char_overrun_count", 0),
        ("clear-overrun", "diag_clear_overrun_counter", 0),
    ):
        yield Asked(8, name, call(method), message, answer)
    good, bad = call("read_coils", 12), call("read_coils", 3000)
    counter, log = call("diag_get_comm_event_counter"), call("diag_get_comm_event_log")
    facts = attrgetter("status", "count")
    yield Asked(11, "counter", lambda c: [good(c), counter(c)][-1], facts, (True, 1))
    facts = attrgetter("status", "event_count", "message_count", "events")
    events = [0x80, 0x41, 0x80, 0x40, 0x80]
    yield Asked(12, "log", lambda c: [good(c), bad(c), log(c)][-1], facts, (True, 1, 3, events))
    for name, address in (("few", 100), ("none", 101), ("most", 102)):
        yield Asked(
            24,
            name,
            call("read_fifo_queue", address=address),
            attrgetter("values"),
            FIFOS[address],
            look=attrgetter("fifos"),
            seen=FIFOS,
            transports=NOT_RTU,
        )
    facts = attrgetter(
        *("read_code", "conformity", "more_follows", "next_object_id", "number_of_objects"),
        "information",
    )
    for name, code, start, more, following, numbers in (
        ("basic", 1, 0, 0, 0, (0, 1, 2)),
        ("regular", 2, 0, 0xFF, 3, (0, 1, 2)),
        ("regular-on", 2, 3, 0xFF, 6, (3,)),
        ("regular-last", 2, 6, 0, 0, (6,)),
        ("extended", 3, 6, 0, 0, (6, 128)),
        ("restart", 1, 6, 0, 0, (0, 1, 2)),
        ("single", 4, 128, 0, 0, (128,)),
    ):
        ask = call("read_device_information", read_code=code, object_id=start)
        objects = {number: OBJECTS[number] for number in numbers}
        yield Asked(43, name, ask, facts, (code, 0x83, more, following, len(numbers), objects))


class Unknown(ModbusPDU):
    """A request of any code; it has no other way to send one."""

    def __init__(self, function: int) -> None:
        super().__init__(dev_id=UNIT)
        self.function_code = function

    def encode(self) -> bytes:
        return b"\1\2\3"


def asked_in_vain() -> Iterator[Asked]:
    """Requests that must be refused; `expected` is the exception code."""
    two_files = [piece_to_write(4, 0, [1]), piece_to_write(9, 0, [1])]
    read, write = {"read_address": 399, "read_count": 2}, {"write_address": 100, "values": [1]}
    for function, ask in (
        (1, call("read_coils", 3000)),
        (2, call("read_discrete_inputs", 2119, count=2)),
        (3, call("read_holding_registers", 399, count=2)),
        (4, call("read_input_registers", 199, count=2)),
        (5, call("write_coil", 2110, True)),
        (6, call("write_register", 99, 1)),
        (15, call("write_coils", 2109, [True, True])),
        (16, call("write_registers", 399, [1, 2])),
        (20, call("read_file_record", [piece_to_read(3, 9, 3)])),
        (21, call("write_file_record", two_files)),
        (22, call("mask_write_register", address=400, and_mask=0, or_mask=0)),
        (23, call("readwrite_registers", **read, **write)),
    ):
        yield Asked(function, "refused", ask, expected=2)
    for function, name, code, ask in (
        (8, "iop", 1, call("diag_read_iop_overrun_count")),
        (8, "modbus-plus", 1, call("diag_getclear_modbus_response", data=3)),
        # It sends the character in the low byte, where 00 belongs.
        (8, "delimiter", 3, call("diag_change_ascii_input_delimeter")),
        (24, "queue", 2, call("read_fifo_queue", address=99)),
        (43, "object", 2, call("read_device_information", read_code=4, object_id=5)),
        (43, "code", 3, call("read_device_information", read_code=5)),
    ):
        yield Asked(function, f"refused-{name}", ask, expected=code)
    ask = call("diag_restart_communication", False)
    yield Asked(8, "refused-restart", ask, expected=1, transports=("tcp",))
    for function in UNKNOWN_FUNCTIONS:
        ask = methodcaller("execute", False, Unknown(function))
        yield Asked(function, "refused", ask, expected=1)


# What a device counts, it counts from its start on: these want one of their own.
COUNTING = (8, 11, 12)

each_transport = pytest.mark.parametrize("transport", TRANSPORTS)


def named(cases: Iterator[Asked], transport: str) -> Iterator[tuple[str, Asked]]:
    """Yield those cases that there are on the transport, each with its id."""
    for case in cases:
        if transport in case.transports:
            yield case_id("pymodbus", "server", transport, case.function, case.name), case


@contextlib.contextmanager
def our_servers(transport: str) -> Iterator[Callable[[Asked], tuple[Place, Device]]]:
    """Yield what returns a server for a case: the same one, restored, or one of its own."""
    device = make_device()
    with our_server(transport, {UNIT: device}) as place, contextlib.ExitStack() as own:

        def server(case: Asked) -> tuple[Place, Device]:
            own.close()
            if case.function in COUNTING:
                counting = make_device()
                return own.enter_context(our_server(transport, {UNIT: counting})), counting
            restore(device)
            place.wire.clear()
            return place, device

        yield server


@each_transport
def test_pymodbus_client_and_our_server_agree(transport: str, record_property: Record) -> None:
    with our_servers(transport) as server:
        for check, case in tried(record_property, named(asked(), transport)):
            with check:
                place, device = server(case)
                with pymodbus_client(transport, place) as client:
                    response = case.ask(client)
                assert not response.isError(), response
                assert case.answer(response) == case.expected
                assert case.look(device) == case.seen
                assert case.function in (11, 12) or place.function == case.function


@each_transport
def test_pymodbus_client_sees_our_refusal_and_nothing_changes(
    transport: str, record_property: Record
) -> None:
    untouched = make_device()
    with our_servers(transport) as server:
        for check, case in tried(record_property, named(asked_in_vain(), transport)):
            with check:
                place, device = server(case)
                with pymodbus_client(transport, place) as client:
                    response = case.ask(client)
                    assert response.isError()
                    assert response.exception_code == case.expected
                    # and the line goes on
                    assert client.read_coils(12, device_id=UNIT).bits[0] is True
                assert place.function == case.function
                assert device.mapping.coils[:] == untouched.mapping.coils[:]
                registers = untouched.mapping.holding_registers[:]
                assert device.mapping.holding_registers[:] == registers
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


@pytest.mark.parametrize("transport", SERIAL)
def test_pymodbus_client_silences_our_device_and_wakes_it(transport: str) -> None:
    with (
        our_server(transport, {UNIT: make_device()}) as place,
        pymodbus_client(transport, place, timeout=0.2) as client,
    ):
        assert client.diag_force_listen_only(device_id=UNIT) is None
        with pytest.raises(ModbusIOException):
            client.read_coils(12, device_id=UNIT)
        # The restart is silence, too, and the way out.
        assert client.execute(True, RestartCommunicationsOptionRequest(0, dev_id=UNIT)) is None
        client.comm_params.timeout_connect = TIMEOUT
        assert client.read_coils(12, device_id=UNIT).bits[0] is True


@pytest.mark.parametrize("running", [True, False])
@over("server", 17, "id")
def test_pymodbus_client_reads_our_identifier(transport: str, running: bool) -> None:
    device = make_device()
    device.server_id = pdu.ServerId(b"\x2a", running)
    with (
        our_server(transport, {UNIT: device}) as place,
        pymodbus_client(transport, place) as client,
    ):
        response = client.report_device_id(device_id=UNIT)
        assert (response.identifier, response.status) == (b"\x2a", running)


class TestWherePymodbusClientErrs:
    @over("server", 17, "pinned")
    def test_additional_data_hide_the_run_indicator(self, transport: str) -> None:
        # It takes all but the last byte for the identifier, and the last one for the
        # indicator, which stands behind the identifier and before the rest.
        with (
            our_server(transport, {UNIT: make_device()}) as place,
            pymodbus_client(transport, place) as client,
        ):
            response = client.report_device_id(device_id=UNIT)
            assert response.identifier == SERVER_ID.data[:-1]
            assert response.status is False

    @pytest.mark.parametrize(
        ("transport", "ask"),
        [
            pytest.param(each, ask, id=case_id("pymodbus", "server", each, function, "pinned"))
            for each in ON_RTU
            for function, ask in (
                # It counts two bytes too few, and then finds no CRC.
                (24, lambda client: client.read_fifo_queue(address=100, device_id=UNIT)),
                # It takes every message of function 8 for 8 bytes.
                (8, lambda client: client.diag_query_data(b"abcd", device_id=UNIT)),
            )
        ],
    )
    def test_answers_it_cannot_measure_are_silence_to_it(
        self, transport: str, ask: Callable[[Any], Any]
    ) -> None:
        with our_server(transport, {UNIT: make_device()}) as place:
            with (
                pymodbus_client(transport, place, timeout=0.2) as client,
                pytest.raises(ModbusIOException),
            ):
                ask(client)
            answer = place.wire.sent_by("server")
            assert pdu.RawRequest(answer[1]).decode_response(answer[1:-2])

    @over("server", 8, "pinned", "delimiter")
    def test_delimiter_must_be_shifted_by_hand(self, transport: str) -> None:
        with (
            our_server(transport, {UNIT: make_device()}) as place,
            pymodbus_client(transport, place) as client,
        ):
            response = client.diag_change_ascii_input_delimeter(delimiter=0x0A00, device_id=UNIT)
            assert response.message == 0x0A00
            assert client.read_coils(12, device_id=UNIT).bits[0] is True

    @over("server", 15, "pinned")
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

    @over("server", 20, "pinned")
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
        await asyncio.sleep(0.02)  # it forgets connections that come or end just now
        await server.shutdown()
        await asyncio.sleep(0.02)

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
def pymodbus_serving(transport: str) -> Iterator[str]:
    """Yield the URL of a server of pymodbus."""
    framer = FRAMERS[transport]
    if transport.endswith("tcp"):

        def make_tcp() -> ModbusTcpServer:
            return ModbusTcpServer(simulated_device(), framer=framer, address=("127.0.0.1", 0))

        with in_background(make_tcp) as server:
            port = server.transport.sockets[0].getsockname()[1]
            yield f"{transport}://127.0.0.1:{port}"
        return
    with SerialWire() as wire:

        def make_serial() -> ModbusSerialServer:
            return ModbusSerialServer(
                simulated_device(), framer=framer, port=wire.server, **SERIAL_SETTINGS
            )

        with in_background(make_serial):
            yield f"{transport}://{wire.client}?baudrate={BAUDRATE}"


def connected(url: str, **options: Any) -> Context:
    """Return a context of ours for the unit there."""
    return Context.from_url(url, **{"unit": UNIT, "timeout": TIMEOUT, **options})


@contextlib.contextmanager
def pymodbus_server(transport: str, **options: Any) -> Iterator[Context]:
    """Yield a context of ours that is connected to a server of pymodbus."""
    with pymodbus_serving(transport) as url, connected(url, **options) as context:
        yield context


# Framings that libmodbus does not speak, or not there, have one way only.
WAYS: dict[str, dict[str, dict[str, Any]]] = {
    transport: (
        {"native": {"native": True}, "python": {"native": False}}
        if transport in ("tcp", "rtu")
        else {"python": {}}
    )
    for transport in TRANSPORTS
}


def to_pymodbus_server(
    cases: Iterator[Exchange], transport: str
) -> Iterator[tuple[str, tuple[Exchange, dict[str, Any]]]]:
    """Yield each case in each way that the transport has, with its id."""
    for exchange in cases:
        for way, options in WAYS[transport].items():
            name = case_id("pymodbus", "client", transport, exchange.function, exchange.name, way)
            yield name, (exchange, options)


@each_transport
def test_context_and_pymodbus_server_agree(transport: str, record_property: Record) -> None:
    cases = to_pymodbus_server(exchanges(), transport)
    with pymodbus_serving(transport) as url:
        for check, (exchange, options) in tried(record_property, cases):
            with check, connected(url, **options) as context:
                for _ in range(2):  # with native=None the second goes through libmodbus
                    assert exchange.ask(context) == exchange.answer
                    assert exchange.look(context) == exchange.seen
                restore_through(context, exchange.function)


def exchanges_beside_the_tables() -> Iterator[Exchange]:
    """Its counters, log and register are always 0, for nothing in it counts."""
    yield Exchange(7, "status", lambda c: c.read_exception_status(), 0)
    yield Exchange(8, "query", lambda c: c.diagnostics(0, 0xA537), 0xA537)
    yield Exchange(8, "restart", lambda c: c.diagnostics(1, 0xFF00), 0xFF00)
    for sub_function in sorted(set(SubFunction) - {0, 1, 3, 4}):
        name = f"sub{sub_function:02x}"
        yield Exchange(8, name, lambda c, sub_function=sub_function: c.diagnostics(sub_function), 0)
    yield Exchange(11, "counter", lambda c: c.read_comm_event_counter(), (0, 0))
    yield Exchange(12, "log", lambda c: c.read_comm_event_log(), (0, 0, 0, b""))
    # The same four registers, whatever is asked for; it has no queues.
    yield Exchange(24, "pinned", lambda c: c.read_fifo_queue(65535), [0, 1, 2, 3])
    # The identifier should come first and the run indicator next; it has them the other
    # way round, and no end that one could find.
    yield Exchange(
        17, "pinned", lambda c: c.report_server_id(), pdu.ServerId(b"P", None, b"ymodbus\xff")
    )


@each_transport
def test_context_and_pymodbus_server_agree_beside_the_tables(
    transport: str, record_property: Record
) -> None:
    cases = to_pymodbus_server(exchanges_beside_the_tables(), transport)
    with pymodbus_serving(transport) as url:
        for check, (exchange, options) in tried(record_property, cases):
            with check, connected(url, **options) as context:
                for _ in range(2):
                    assert exchange.ask(context) == exchange.answer


@pytest.fixture
def control() -> Iterator[Any]:
    """Return the state that all servers and ASCII framers of pymodbus in a process share."""
    block = ModbusControlBlock()
    identity, delimiter = dict(block.Identity.stat_data), block.Delimiter
    yield block
    block.Identity.stat_data.clear()
    block.Identity.stat_data.update(identity)
    block.Delimiter = delimiter
    block.ListenOnly = False


LEVELS: dict[str | int, tuple[int, ...]] = {
    "basic": (0, 1, 2),
    "regular": (0, 1, 2, 3, 6),
    "extended": (0, 1, 2, 3, 6, 128),
    0: (0,),
    128: (128,),
}


@over("client", 43, "id")
def test_context_reads_the_identification_of_pymodbus_server(control: Any, transport: str) -> None:
    control.Identity.stat_data.update({number: OBJECTS[number] for number in OBJECTS})
    with pymodbus_serving(transport) as url:
        for check, (level, numbers) in each(LEVELS.items()):
            with check, connected(url) as context:
                found = context.read_device_identification(level)
                assert found.objects == {number: OBJECTS[number] for number in numbers}
                assert found.conformity == 0x83
                with pytest.raises(IllegalDataAddress):
                    context.read_device_identification(5)


@each_transport
def test_context_raises_what_pymodbus_server_refuses(
    transport: str, record_property: Record
) -> None:
    cases = to_pymodbus_server(refusals(), transport)
    with pymodbus_serving(transport) as url:
        for check, (exchange, options) in tried(record_property, cases):
            # A line is silent for a timeout where an answer could be that of the request before.
            with check, connected(url, timeout=2.0, **options) as context:
                for _ in range(2):
                    with pytest.raises(IllegalDataAddress) as caught:
                        exchange.ask(context)
                    assert caught.value.function == exchange.function
                assert context.read_holding_registers(399, 1) == [1399]
                restore_through(context, exchange.function)


class TestWherePymodbusServerErrs:
    @over("client", 20, "pinned")
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

    @over("client", 21, "pinned")
    def test_file_writes_are_echoed_and_not_done(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            values = list(range(10))
            context.write_file_records([(4, 0, values), (3, 5, [1, 2, 3])])
            assert context.read_file_records([(4, 0, 10)]) != [values]

    @over("client", 23, "pinned")
    def test_refused_read_write_has_written(self, transport: str) -> None:
        # Its write is done before the read is checked; that we pass on, and our own
        # server writes nothing (test_pymodbus_client_sees_our_refusal...).
        with pymodbus_server(transport) as context:
            with pytest.raises(IllegalDataAddress):
                context.read_write_registers(399, 2, 100, [55])
            assert context.read_holding_registers(100, 2) == [55, 1101]

    @over("client", 8, "pinned")
    def test_answer_to_force_listen_only_is_not_taken_for_the_next_one(
        self, control: Any, transport: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        # It answers, though nobody may, and goes on answering. The answer is held until the
        # client waits no more, and has come before the next request leaves.
        held: Future[Callable[[], object]] = Future()
        send = ServerRequestHandler.server_send

        def hold(self: ServerRequestHandler, *arguments: Any) -> None:
            if held.done():
                send(self, *arguments)
                return
            loop = asyncio.get_running_loop()
            held.set_result(partial(loop.call_soon_threadsafe, send, self, *arguments))

        monkeypatch.setattr(ServerRequestHandler, "server_send", hold)
        with pymodbus_server(transport) as context:
            assert context.diagnostics(SubFunction.FORCE_LISTEN_ONLY) == 0
            held.result(30)()
            until(context._driver._port.has_input)
            assert context.diagnostics(0, 0xA537) == 0xA537
            assert context.read_coils(12, 1) == [True]

    @over("client", 8, "pinned", "delimiter", transports=("ascii", "ascii+tcp"))
    def test_echo_of_a_new_delimiter_ends_with_it(self, control: Any, transport: str) -> None:
        # The delimiter is that of the process, and changes before the echo goes out:
        # which then has no end for us.
        with pymodbus_server(transport, timeout=1.0) as context:
            with pytest.raises(ModbusError) as caught:
                context.diagnostics(SubFunction.CHANGE_ASCII_DELIMITER, 0x2400)
            assert caught.value.received.endswith(b"\r$")

    @over("client", 8, "pinned")
    def test_wrong_data_and_reserved_sub_functions_are_answered(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            assert context.diagnostics(SubFunction.BUS_MESSAGE_COUNT, 7) == 0  # should be 3
            assert context.diagnostics(0x13) == 0  # should be 1

    @over("client", 8, "pinned", "long", transports=ON_RTU)
    def test_query_data_of_more_than_a_word_are_lost_on_it(self, transport: str) -> None:
        # It takes every message of function 8 for 8 bytes.
        with (
            pymodbus_server(transport, timeout=0.2) as context,
            pytest.raises(ModbusTimeoutError),
        ):
            context.execute(pdu.Diagnostics(0, b"abcd"))

    @over("client", 8, "query-most", transports=NOT_RTU)
    def test_query_data_of_any_length_come_back_otherwise(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            data = bytes(range(250))
            assert context.execute(pdu.Diagnostics(0, data)) == data

    @pytest.mark.parametrize(
        ("transport", "error"),
        [
            pytest.param(each, error, id=case_id("pymodbus", "client", each, 43, word, "canopen"))
            for each, error, word in (
                *((each, IllegalFunction, "refused") for each in NOT_RTU),
                *((each, ModbusTimeoutError, "pinned") for each in ON_RTU),
            )
        ],
    )
    def test_canopen_is_refused_or_not_heard(
        self, transport: str, error: type[ModbusError]
    ) -> None:
        # On RTU it has no length for it, and waits.
        # Without ids the answer to another function ends no wait.
        has_ids = transport in ("tcp", "udp")
        timeout = TIMEOUT if has_ids else 1.0 if transport in NOT_RTU else 0.2
        with pymodbus_server(transport, timeout=timeout) as context, pytest.raises(error):
            context.encapsulated_transport(13, b"abc")

    @each_transport
    def test_unknown_function_is_answered_by_function_0_or_not_heard(
        self, transport: str, record_property: Record
    ) -> None:
        # 80 01 instead of the code with 80 and 01; on RTU it has no length, and waits.
        # Without ids the answer to another function ends no wait.
        has_ids = transport in ("tcp", "udp")
        timeout = TIMEOUT if has_ids else 1.0 if transport in NOT_RTU else 0.2
        error = InvalidResponse if transport in NOT_RTU else ModbusTimeoutError
        cases = (
            (case_id("pymodbus", "client", transport, function, "pinned"), function)
            for function in UNKNOWN_FUNCTIONS
        )
        for check, function in tried(record_property, cases):
            # What an RTU server has not understood would precede the next request.
            with check, pymodbus_server(transport, timeout=timeout) as context:
                with pytest.raises(error) as caught:
                    context.execute(pdu.RawRequest(function, b"ab"))
                assert caught.value.function == function

    @pytest.mark.parametrize("transport", [each for each in TRANSPORTS if each != "tcp"])
    def test_answer_to_a_broadcast_is_not_taken_for_the_next_one(self, transport: str) -> None:
        # Unit 0 is a unit like any other for it, so that it answers broadcasts.
        with pymodbus_server(transport, turnaround=0.5) as context:
            context.for_unit(0).write_register(100, 7)
            assert context.read_holding_registers(100, 2) == [1100, 1101]
            context.write_register(100, 8)
            assert context.read_holding_registers(100, 2) == [8, 1101]
