"""
Clients of pymodbus on our server, over every transport. Where pymodbus errs, a test pins what it
does and what we make of it.
"""

import contextlib
from collections.abc import Callable, Iterator
from operator import attrgetter, methodcaller
from typing import Any, NamedTuple

import pytest
from pymodbus.exceptions import ModbusException, ModbusIOException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.diag_message import RestartCommunicationsOptionRequest
from pymodbus.pdu.file_message import FileRecord

from libmodbus_py import Device, Server, pdu
from tests.support.interop import (
    EXCEPTION_STATUS,
    FIFOS,
    OBJECTS,
    SERVER_ID,
    TIMEOUT,
    UNIT,
    UNKNOWN_FUNCTIONS,
    Record,
    case_id,
    cells,
    coil,
    discrete_input,
    holding_register,
    input_register,
    make_device,
    our_server,
    record,
    restore,
    try_cases,
)
from tests.support.pymodbus_peers import FRAMERS, pymodbus_client
from tests.support.transports import serving

TRANSPORTS = tuple(FRAMERS)
WITH_IDS = ("tcp", "udp", "tls")
SERIAL = tuple(transport for transport in TRANSPORTS if transport not in WITH_IDS)
# It finds the end of RTU frames by lengths that are wrong for some functions.
NOT_RTU = (*WITH_IDS, "ascii", "ascii+tcp")
ON_RTU = ("rtu", "rtu+tcp")


def over(role: str, function: int, *more: str, transports: tuple[str, ...] = TRANSPORTS) -> Any:
    """Run a test over each transport; `interop_report` finds it by the id, see `case_id`."""
    ids = [case_id("pymodbus", role, transport, function, *more) for transport in transports]
    return pytest.mark.parametrize("transport", transports, ids=ids)


@contextlib.contextmanager
def asking(transport: str, device: Device | None = None, timeout: float = TIMEOUT) -> Iterator[Any]:
    """Yield a client of pymodbus that is connected to a server of ours with one device."""
    with (
        serving(transport, Server({UNIT: device or make_device()})) as url,
        pymodbus_client(url, timeout) as client,
    ):
        yield client


class Asked(NamedTuple):
    """One request of pymodbus's client, and the expected answer of our device."""

    function: int
    name: str
    ask: Callable[[Any], Any]
    answer: Callable[[Any], object] = lambda response: None
    expected: object = None
    look: Callable[[Device], object] = lambda device: None
    seen: object = None
    transports: tuple[str, ...] = TRANSPORTS


message, registers = attrgetter("message"), attrgetter("registers")


def bits(count: int) -> Callable[[Any], list[bool]]:
    """pymodbus returns whole bytes of bits; those beyond the count are ignored."""
    return lambda response: response.bits[:count]


def call(method: str, *arguments: Any, **options: Any) -> Callable[[Any], Any]:
    """Return what calls a method of pymodbus's client for our unit."""
    return methodcaller(method, *arguments, **{"device_id": UNIT, **options})


def span(table: str, start: int, stop: int) -> Callable[[Device], Any]:
    """Return what looks at the cells of a device from one address up to another."""
    return lambda device: getattr(device.mapping, table)[start:stop]


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
        content: list[Any] = [coil(first - 1), *other, coil(first + count)]
        look = span("coils", first - 1, first + count + 1)
        yield Asked(15, name, call("write_coils", first, other), look=look, seen=content)
    for name, first, count in (("few", 397, 2), ("most", 101, 123)):
        content = [holding_register(first - 1), *range(count), holding_register(first + count)]
        look = span("holding_registers", first - 1, first + count + 1)
        yield Asked(
            16, name, call("write_registers", first, list(range(count))), look=look, seen=content
        )
    yield from asked_of_files()
    yield Asked(
        22,
        "few",
        call("mask_write_register", address=250, and_mask=0x00F0, or_mask=0xA50F),
        look=span("holding_registers", 249, 252),
        seen=[1249, 0xA5EF, 1251],
    )
    for name, count, first, size in (("few", 2, 101, 1), ("most", 125, 104, 121)):
        after = cells(holding_register, 100, 300)
        after[first - 100 : first - 100 + size] = range(size)
        arguments = {"read_address": 100, "read_count": count, "write_address": first}
        ask = call("readwrite_registers", **arguments, values=list(range(size)))
        look = span("holding_registers", 100, 400)
        yield Asked(23, name, ask, registers, after[:count], look=look, seen=after)
    yield from asked_beside_the_tables()


def asked_of_files() -> Iterator[Asked]:
    few = [piece_to_read(4, 7, 3), piece_to_read(3, 9, 2)]
    records = [as_bytes([5007, 5008, 5009]), as_bytes([0x33CD, 0x0040])]
    yield Asked(20, "few", call("read_file_record", few), pieces, records)
    # 2 + 242 bytes, the 245 of the specification less the odd one
    records = [as_bytes(cells(record, 10, 121))]
    yield Asked(20, "most", call("read_file_record", [piece_to_read(4, 10, 121)]), pieces, records)
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
    """A request of any code; pymodbus can send one in no other way."""

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
    yield Asked(8, "refused-restart", ask, expected=1, transports=WITH_IDS)
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
def our_servers(transport: str) -> Iterator[Callable[[Asked], tuple[str, Device]]]:
    """Yield what returns the URL of a server for a case: the same, restored, or one of its own."""
    device = make_device()
    with serving(transport, Server({UNIT: device})) as url, contextlib.ExitStack() as own:

        def server(case: Asked) -> tuple[str, Device]:
            own.close()
            if case.function in COUNTING:
                counting = make_device()
                return own.enter_context(serving(transport, Server({UNIT: counting}))), counting
            restore(device)
            return url, device

        yield server


def agree(case: Asked, client: Any, device: Device) -> None:
    """Assert that a client gets the answer of a device, and that the device did what it asked."""
    response = case.ask(client)
    assert not response.isError(), response
    assert response.function_code == case.function
    assert case.answer(response) == case.expected
    assert case.look(device) == case.seen


@each_transport
def test_pymodbus_client_and_our_server_agree(transport: str, record_property: Record) -> None:
    with our_servers(transport) as server:
        for check, case in try_cases(record_property, named(asked(), transport)):
            with check:
                url, device = server(case)
                with pymodbus_client(url) as client:
                    agree(case, client, device)


@each_transport
def test_pymodbus_client_sees_our_refusal_and_nothing_changes(transport: str, record_property):
    untouched = make_device()
    with our_servers(transport) as server:
        for check, case in try_cases(record_property, named(asked_in_vain(), transport)):
            with check:
                url, device = server(case)
                with pymodbus_client(url) as client:
                    response = case.ask(client)
                    assert response.isError()
                    assert response.function_code == case.function | 0x80
                    assert response.exception_code == case.expected
                    # and the line goes on
                    assert client.read_coils(12, device_id=UNIT).bits[0] is True
                assert device.mapping.coils[:] == untouched.mapping.coils[:]
                registers = untouched.mapping.holding_registers[:]
                assert device.mapping.holding_registers[:] == registers
                assert list(device.files[4]) == list(untouched.files[4])


@pytest.mark.parametrize("transport", SERIAL)
def test_unit_without_a_device_is_silent_to_pymodbus_on_a_line(transport: str) -> None:
    with asking(transport, timeout=0.2) as client:
        with pytest.raises(ModbusIOException):
            client.read_coils(10, device_id=UNIT + 1)
        client.comm_params.timeout_connect = TIMEOUT
        assert client.read_coils(12, device_id=UNIT).bits[0] is True


@pytest.mark.parametrize("transport", WITH_IDS)
def test_unit_without_a_device_is_exception_11_to_pymodbus_where_requests_have_ids(transport):
    with asking(transport) as client:
        assert client.read_coils(10, device_id=UNIT + 1).exception_code == 11


@pytest.mark.parametrize("transport", SERIAL)
def test_broadcast_of_pymodbus_reaches_every_unit_and_is_not_answered(transport: str) -> None:
    devices = {UNIT: make_device(), UNIT + 1: make_device()}
    with serving(transport, Server(devices)) as url, pymodbus_client(url) as client:
        client.write_register(100, 7, device_id=0, no_response_expected=True)
        for unit in devices:
            response = client.read_holding_registers(100, device_id=unit)
            assert (response.dev_id, response.registers) == (unit, [7])
    assert [device.mapping.holding_registers[100] for device in devices.values()] == [7, 7]


@pytest.mark.parametrize("transport", SERIAL)
def test_pymodbus_client_silences_our_device_and_wakes_it(transport: str) -> None:
    with asking(transport, timeout=0.2) as client:
        assert client.diag_force_listen_only(device_id=UNIT) is None
        with pytest.raises(ModbusIOException):
            client.read_coils(12, device_id=UNIT)
        # The restart has no answer either, and ends the mode.
        assert client.execute(True, RestartCommunicationsOptionRequest(0, dev_id=UNIT)) is None
        client.comm_params.timeout_connect = TIMEOUT
        assert client.read_coils(12, device_id=UNIT).bits[0] is True


@pytest.mark.parametrize("running", [True, False])
@over("server", 17, "id")
def test_pymodbus_client_reads_our_identifier(transport: str, running: bool) -> None:
    device = make_device()
    device.server_id = pdu.ServerId(b"\x2a", running)
    with asking(transport, device) as client:
        response = client.report_device_id(device_id=UNIT)
        assert (response.identifier, response.status) == (b"\x2a", running)


class TestWherePymodbusClientErrs:
    @over("server", 17, "pinned")
    def test_additional_data_hide_the_run_indicator(self, transport: str) -> None:
        # It takes all but the last byte for the identifier, and the last one for the
        # indicator, which stands behind the identifier and before the rest.
        with asking(transport) as client:
            response = client.report_device_id(device_id=UNIT)
            assert response.identifier == SERVER_ID.data[:-1]
            assert response.status is False

    @pytest.mark.parametrize(
        ("transport", "ask"),
        [
            pytest.param(code, ask, id=case_id("pymodbus", "server", code, function, "pinned"))
            for code in ON_RTU
            for function, ask in (
                # pymodbus counts two bytes too few, and then finds no CRC.
                (24, lambda client: client.read_fifo_queue(address=100, device_id=UNIT)),
                # pymodbus takes every message of function 8 for 8 bytes.
                (8, lambda client: client.diag_query_data(b"abcd", device_id=UNIT)),
            )
        ],
    )
    def test_pymodbus_times_out_on_answers_of_unknown_length(self, transport, ask) -> None:
        with our_server(transport, {UNIT: make_device()}) as place:
            with (
                pymodbus_client(str(place.end), timeout=0.2) as client,
                pytest.raises(ModbusIOException),
            ):
                ask(client)
            answer = place.wire.sent_by("server")
            assert pdu.RawRequest(answer[1]).decode_response(answer[1:-2])

    @over("server", 8, "pinned", "delimiter")
    def test_the_delimiter_for_pymodbus_must_be_shifted_by_hand(self, transport: str) -> None:
        with asking(transport) as client:
            response = client.diag_change_ascii_input_delimeter(delimiter=0x0A00, device_id=UNIT)
            assert response.message == 0x0A00
            assert client.read_coils(12, device_id=UNIT).bits[0] is True

    @over("server", 15, "pinned")
    def test_more_coils_than_a_write_may_have_are_refused(self, transport: str) -> None:
        # It sends 1969 coils without a word; they just fit a frame, but not the rule.
        device = make_device()
        with asking(transport, device) as client:
            response = client.write_coils(10, [True] * 1969, device_id=UNIT)
            assert response.exception_code == 3
            assert device.mapping.coils[10:1979] == cells(coil, 10, 1969)

    @over("server", 20, "pinned")
    def test_pymodbus_halves_the_record_length(self, transport: str) -> None:
        # record_length is in bytes for it, although the field of the frame is in
        # registers: 4 asks for two registers, and an odd one cannot be asked for.
        piece = FileRecord(file_number=4, record_number=7, record_length=4)
        with asking(transport) as client:
            response = client.read_file_record([piece], device_id=UNIT)
            assert pieces(response) == [as_bytes([5007, 5008])]
        with pytest.raises(ModbusException, match="multiple of 2"):
            FileRecord(file_number=4, record_number=7, record_length=3)
