"""
Our clients on servers of pymodbus, over every transport. Where pymodbus errs, a test pins what it
does and what we make of it.
"""

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial
from typing import Any

import pytest
from pymodbus.pdu.device import ModbusControlBlock
from pymodbus.server.requesthandler import ServerRequestHandler

from libmodbus_py import (
    Client,
    IllegalDataAddress,
    IllegalFunction,
    InvalidResponse,
    ModbusError,
    ModbusTimeoutError,
    Point,
    RegisterMap,
    pdu,
)
from libmodbus_py.protocol.pdu import SubFunction
from tests.interop.test_interop_pymodbus import (
    NOT_RTU,
    ON_RTU,
    SERIAL,
    WITH_IDS,
    as_bytes,
    each_transport,
    over,
)
from tests.support.cases import each
from tests.support.interop import (
    HOLDING_REGISTERS,
    OBJECTS,
    TIMEOUT,
    UNKNOWN_FUNCTIONS,
    Exchange,
    Record,
    case_id,
    check_answers,
    check_refusals,
    connected,
    exchanges,
    holding_register,
    try_cases,
)
from tests.support.peers import until
from tests.support.pymodbus_peers import pymodbus_serving


@contextlib.contextmanager
def pymodbus_server(transport: str, **options: Any) -> Iterator[Client]:
    """Yield a client of ours that is connected to a server of pymodbus."""
    with pymodbus_serving(transport) as url, connected(url, **options) as context:
        yield context


def exchanges_beside_the_tables() -> Iterator[Exchange]:
    """The counters, log and register of pymodbus are always 0."""
    yield Exchange(7, "status", lambda c: c.read_exception_status(), 0)
    yield Exchange(8, "query", lambda c: c.diagnostics(0, 0xA537), 0xA537)
    yield Exchange(8, "restart", lambda c: c.diagnostics(1, 0xFF00), 0xFF00)
    for sub_function in sorted(set(SubFunction) - {0, 1, 3, 4}):
        name = f"sub{sub_function:02x}"
        yield Exchange(8, name, lambda c, sub_function=sub_function: c.diagnostics(sub_function), 0)
    yield Exchange(11, "counter", lambda c: c.read_comm_event_counter(), (0, 0))
    yield Exchange(12, "log", lambda c: c.read_comm_event_log(), (0, 0, 0, b""))
    # The same four registers for any address; pymodbus has no queues.
    yield Exchange(24, "pinned", lambda c: c.read_fifo_queue(65535), [0, 1, 2, 3])
    # The identifier should come first and the run indicator next; it has them the other
    # way round, and no end that one could find.
    yield Exchange(
        17, "pinned", lambda c: c.report_server_id(), pdu.ServerId(b"P", None, b"ymodbus\xff")
    )


@each_transport
def test_context_and_pymodbus_server_agree(transport: str, record_property: Record) -> None:
    cases = [*exchanges(), *exchanges_beside_the_tables()]
    with pymodbus_serving(transport) as url:
        check_answers(url, "pymodbus", cases, record_property)


@each_transport
def test_context_raises_what_pymodbus_server_refuses(transport: str, record_property) -> None:
    with pymodbus_serving(transport) as url:
        check_refusals(url, "pymodbus", record_property)


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
                identification = context.read_device_identification(level)
                assert identification.objects == {number: OBJECTS[number] for number in numbers}
                assert identification.conformity == 0x83
                with pytest.raises(IllegalDataAddress):
                    context.read_device_identification(5)


# Without ids the answer to another function ends no wait: seconds to wait for one.
UNHEARD = dict.fromkeys(WITH_IDS, TIMEOUT)
UNHEARD |= {"ascii": 1.0, "ascii+tcp": 1.0, "rtu": 0.2, "rtu+tcp": 0.2}


class TestWherePymodbusServerErrs:
    @over("client", 20, "pinned")
    def test_file_reads_return_the_dummy_of_pymodbus_or_an_error(self, transport: str) -> None:
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
    def test_pymodbus_echoes_file_writes_without_writing(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            values = list(range(10))
            context.write_file_records([(4, 0, values), (3, 5, [1, 2, 3])])
            assert context.read_file_records([(4, 0, 10)]) != [values]

    @over("client", 23, "pinned")
    def test_a_refused_read_write_of_pymodbus_has_written(self, transport: str) -> None:
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
        answer: Future[Callable[[], object]] = Future()
        send = ServerRequestHandler.server_send

        def hold(self: ServerRequestHandler, *arguments: Any) -> None:
            if answer.done():
                send(self, *arguments)
                return
            loop = asyncio.get_running_loop()
            answer.set_result(partial(loop.call_soon_threadsafe, send, self, *arguments))

        monkeypatch.setattr(ServerRequestHandler, "server_send", hold)
        with pymodbus_server(transport) as context:
            assert context.diagnostics(SubFunction.FORCE_LISTEN_ONLY) == 0
            answer.result(30)()
            until(context._driver._port.has_input)
            assert context.diagnostics(0, 0xA537) == 0xA537
            assert context.read_coils(12, 1) == [True]

    @over("client", 8, "pinned", "delimiter", transports=("ascii", "ascii+tcp"))
    def test_pymodbus_answers_with_the_new_delimiter(self, control: Any, transport: str) -> None:
        # The delimiter is that of the process, and changes before the echo goes out:
        # which then has no end for us.
        with pymodbus_server(transport, timeout=1.0) as context:
            with pytest.raises(ModbusError) as caught:
                context.diagnostics(SubFunction.CHANGE_ASCII_DELIMITER, 0x2400)
            assert caught.value.received.endswith(b"\r$")

    @over("client", 8, "pinned")
    def test_pymodbus_answers_wrong_data_and_reserved_sub_functions(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            assert context.diagnostics(SubFunction.BUS_MESSAGE_COUNT, 7) == 0  # should be 3
            assert context.diagnostics(0x13) == 0  # should be 1

    @over("client", 8, "pinned", "long", transports=ON_RTU)
    def test_pymodbus_loses_query_data_of_more_than_a_word(self, transport: str) -> None:
        # pymodbus takes every message of function 8 for 8 bytes.
        with pymodbus_server(transport, timeout=0.2) as context, pytest.raises(ModbusTimeoutError):
            context.execute(pdu.Diagnostics(0, b"abcd"))

    @over("client", 8, "query-most", transports=NOT_RTU)
    def test_pymodbus_returns_other_query_data_of_any_length(self, transport: str) -> None:
        with pymodbus_server(transport) as context:
            data = bytes(range(250))
            assert context.execute(pdu.Diagnostics(0, data)) == data

    @pytest.mark.parametrize(
        ("transport", "error"),
        [
            pytest.param(code, error, id=case_id("pymodbus", "client", code, 43, word, "canopen"))
            for code, error, word in (
                *((code, IllegalFunction, "refused") for code in NOT_RTU),
                *((code, ModbusTimeoutError, "pinned") for code in ON_RTU),
            )
        ],
    )
    def test_pymodbus_refuses_or_ignores_canopen(self, transport, error) -> None:
        # On RTU pymodbus has no length for this function, and waits.
        with (
            pymodbus_server(transport, timeout=UNHEARD[transport]) as context,
            pytest.raises(error),
        ):
            context.encapsulated_transport(13, b"abc")

    @each_transport
    def test_pymodbus_answers_unknown_functions_with_function_0_or_not_at_all(
        self, transport: str, record_property: Record
    ) -> None:
        # 80 01 instead of the code with 80 and 01; on RTU it has no length, and waits.
        error = InvalidResponse if transport in NOT_RTU else ModbusTimeoutError
        cases = (
            (case_id("pymodbus", "client", transport, function, "pinned"), function)
            for function in UNKNOWN_FUNCTIONS
        )
        for check, function in try_cases(record_property, cases):
            # What an RTU server has not understood would precede the next request.
            with check, pymodbus_server(transport, timeout=UNHEARD[transport]) as context:
                with pytest.raises(error) as caught:
                    context.execute(pdu.RawRequest(function, b"ab"))
                assert caught.value.function == function

    @pytest.mark.parametrize("transport", SERIAL)
    def test_answer_to_a_broadcast_is_not_taken_for_the_next_one(self, transport: str) -> None:
        # Unit 0 is a unit like any other for it, so that it answers broadcasts.
        with pymodbus_server(transport, turnaround=0.5) as context:
            context.for_unit(0).write_register(100, 7)
            assert context.read_holding_registers(100, 2) == [1100, 1101]
            context.write_register(100, 8)
            assert context.read_holding_registers(100, 2) == [8, 1101]


def test_points_without_registers_in_pymodbus_are_left_out() -> None:
    """Of twenty points the last three lie where pymodbus has no registers."""
    end = HOLDING_REGISTERS.stop
    first = end - 17
    points = RegisterMap(
        Point(f"r{at}", "holding_registers", at) for at in range(first, first + 20)
    )
    with pymodbus_server("tcp") as plc:
        counts = []
        for _ in range(4):
            before = plc.statistics.requests
            results = plc.read_map(points, return_exceptions=True)
            counts.append(plc.statistics.requests - before)
        good = {name: value for name, value in results.items() if isinstance(value, int)}
        assert good == {f"r{at}": holding_register(at) for at in range(first, end)}
        assert [name.name for name in plc.unreadable(points)] == [f"r{end + at}" for at in range(3)]
    assert counts[0] <= 1 + 10
    assert counts[1:] == [1, 1, 1]
