"""The accesses of each request, as hooks get them, and what hooks may refuse or change."""

import threading
from collections.abc import Callable
from typing import Any

from libmodbus_py import Access, Device, Mapping, pdu
from libmodbus_py.device.access import ACCESSES
from libmodbus_py.device.event_log import EventLog
from libmodbus_py.protocol import errors
from libmodbus_py.serve import Caller
from tests.device.devices import BITS, FILES, REGISTERS, contents, diagnose, on_a_line, words
from tests.protocol.pdu.examples import EXAMPLES
from tests.support.cases import each_case

CALLER = Caller(5, "192.0.2.7:51234")


def seen_as(table: str, address: int, count: int, *values: Any, file: int = 0) -> Access:
    return Access(table, address, count, values, file, CALLER.unit, CALLER.peer)


# Request, written and read cells; register 250 has the value 12h.
TOUCHES: list[tuple[pdu.Request[Any], list[Access], list[Access]]] = [
    (pdu.ReadCoils(10, 3), [], [seen_as("coils", 10, 3)]),
    (pdu.ReadDiscreteInputs(20, 9), [], [seen_as("discrete_inputs", 20, 9)]),
    (pdu.ReadHoldingRegisters(399, 1), [], [seen_as("holding_registers", 399, 1)]),
    (pdu.ReadInputRegisters(200, 125), [], [seen_as("input_registers", 200, 125)]),
    (pdu.WriteCoil(10, True), [seen_as("coils", 10, 1, True)], []),
    (pdu.WriteCoil(2099, False), [seen_as("coils", 2099, 1, False)], []),
    (pdu.WriteRegister(100, 65535), [seen_as("holding_registers", 100, 1, 65535)], []),
    (pdu.WriteCoils(12, [True, False, True]), [seen_as("coils", 12, 3, True, False, True)], []),
    (pdu.WriteRegisters(398, [7, 8]), [seen_as("holding_registers", 398, 2, 7, 8)], []),
    (
        pdu.ReadFileRecords([(4, 9, 2), (3, 12, 1)]),
        [],
        [seen_as("file", 9, 2, file=4), seen_as("file", 12, 1, file=3)],
    ),
    (
        pdu.WriteFileRecords([(4, 9, [5, 6]), (3, 12, [7])]),
        [seen_as("file", 9, 2, 5, 6, file=4), seen_as("file", 12, 1, 7, file=3)],
        [],
    ),
    (pdu.MaskWriteRegister(250, 0xF2, 0x25), [seen_as("holding_registers", 250, 1, 0x17)], []),
    (
        pdu.ReadWriteRegisters(100, 3, 101, [7]),
        [seen_as("holding_registers", 101, 1, 7)],
        [seen_as("holding_registers", 100, 3)],
    ),
    (pdu.ReadFifoQueue(9), [], [seen_as("fifo", 9, 1)]),
]
WRITES = [request for request, writes, _ in TOUCHES if writes]
READS = [request for request, _, reads in TOUCHES if reads]
UNTOUCHING = [example for example in EXAMPLES if example.function in (7, 8, 11, 12, 17, 43)]
# Requests of which some addresses do not exist: exception 2.
BEYOND = [
    pdu.ReadCoils(9, 2),
    pdu.ReadDiscreteInputs(2099, 2),
    pdu.ReadHoldingRegisters(399, 2),
    pdu.ReadInputRegisters(199, 1),
    pdu.WriteCoil(2100, True),
    pdu.WriteRegister(99, 1),
    pdu.WriteCoils(2099, [True] * 2),
    pdu.WriteRegisters(399, [1, 2]),
    pdu.ReadFileRecords([(4, 9, 2), (3, 11, 1)]),
    pdu.ReadFileRecords([(5, 0, 1)]),
    pdu.WriteFileRecords([(4, 9, [5, 6]), (3, 11, [7])]),
    pdu.MaskWriteRegister(400, 0, 0),
    pdu.ReadWriteRegisters(399, 2, 100, [7]),
    pdu.ReadWriteRegisters(100, 1, 400, [7]),
    pdu.ReadFifoQueue(8),
]


def id_of(value: Any) -> str:
    return f"{value.function:02}-{type(value).__name__}" if isinstance(value, pdu.Request) else ""


def hooked_device(**hooks: Callable[[Access], object]) -> Device:
    mapping = Mapping(BITS[1], BITS[2], REGISTERS[3], REGISTERS[4])
    mapping.holding_registers[250] = 0x12
    return Device(mapping, files=FILES, fifos={9: [1]}, canopen=lambda data: data, **hooks)


class Recorder:
    """Three hooks that record their accesses, and the values of the device then."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Access]] = []
        self.states: list[dict[str, Any]] = []
        self.device = hooked_device(
            before_write=lambda access: self.note("before_write", access),
            after_write=lambda access: self.note("after_write", access),
            before_read=lambda access: self.note("before_read", access),
        )

    def note(self, name: str, access: Access) -> None:
        self.calls.append((name, access))
        self.states.append(contents(self.device))


class TestHooks:
    def test_every_function_has_its_accesses(self) -> None:
        touching = {type(request) for request, *_ in TOUCHES}
        untouching = {type(request) for request in UNTOUCHING}
        assert touching | untouching == {*pdu.REQUESTS.values(), pdu.ReadDeviceIdentification}
        assert not touching & untouching
        assert {type(request) for request in BEYOND} == touching

    @each_case(("request_", "writes", "reads"), TOUCHES, ids=id_of)
    def test_hooks_get_the_accesses_in_order(self, request_, writes, reads) -> None:
        recorder = Recorder()
        plain = hooked_device()
        before = contents(plain)
        answer = recorder.device.answer(request_.encode(), CALLER)
        assert answer == plain.answer(request_.encode())
        assert not answer[0] & 0x80
        assert recorder.calls == [
            *(("before_write", access) for access in writes),
            *(("before_read", access) for access in reads),
            *(("after_write", access) for access in writes),
        ]
        for (name, access), state in zip(recorder.calls, recorder.states, strict=True):
            assert state == (contents(plain) if name == "after_write" else before)
            kind = bool if access.table == "coils" else int
            assert {type(value) for value in access.values} <= {kind}
            assert len(access.values) == (0 if name == "before_read" else access.count)

    @each_case("request_", UNTOUCHING, ids=id_of)
    def test_hooks_are_not_called_without_an_access(self, request_: pdu.Request[Any]) -> None:
        recorder = Recorder()
        assert not recorder.device.answer(request_.encode(), CALLER)[0] & 0x80
        assert recorder.calls == []

    @each_case(
        ("body", "code"),
        [
            *[(request.encode(), 2) for request in BEYOND],
            *[(request.encode()[:-1], 3) for request, *_ in TOUCHES],
            *[(request.encode() + b"\0", 3) for request, *_ in TOUCHES],
            *[(request.encode()[:1], 3) for request, *_ in TOUCHES],
        ],
    )
    def test_hooks_get_no_invalid_or_missing_addresses(self, body, code) -> None:
        recorder = Recorder()
        before = contents(recorder.device)
        assert recorder.device.answer(body, CALLER) == bytes([body[0] | 0x80, code])
        assert recorder.calls == []
        assert contents(recorder.device) == before

    def test_units_of_a_broadcast(self) -> None:
        recorder = Recorder()
        caller = Caller(0, "/dev/ttyS0", EventLog(is_serial=True), is_broadcast=True)
        recorder.device.answer(b"\6" + words(100, 7), caller)
        recorder.device.answer(b"\3" + words(100, 1), caller)
        access = Access("holding_registers", 100, 1, (7,), 0, 0, "/dev/ttyS0")
        assert recorder.calls == [("before_write", access), ("after_write", access)]

    def test_a_listening_device_calls_no_hooks(self) -> None:
        recorder, caller = Recorder(), on_a_line()
        diagnose(recorder.device, 4, b"\0\0", caller)
        for request, *_ in TOUCHES:
            assert recorder.device.answer(request.encode(), caller) == b""
        assert recorder.calls == []

    @each_case("request_", WRITES, ids=id_of)
    @each_case("code", [*range(1, 12), 0x7F, 255])
    def test_before_write_refuses_and_nothing_changes(self, request_, code, caplog) -> None:
        caplog.clear()
        refusal = errors.ExceptionResponse.of(code)
        accesses: list[Access] = []

        def refuse(access: Access) -> None:
            # By the class where there is one, as an application would.
            raise refusal if type(refusal) is errors.ExceptionResponse else type(refusal)

        device = hooked_device(
            before_write=refuse, before_read=accesses.append, after_write=accesses.append
        )
        before = contents(device)
        answer = device.answer(request_.encode(), CALLER)
        assert answer == bytes([request_.function | 0x80, code])
        assert contents(device) == before
        assert accesses == []
        assert caplog.records == []

    @each_case("request_", READS, ids=id_of)
    def test_before_read_refuses_and_nothing_changes(self, request_: pdu.Request[Any]) -> None:
        def refuse(access: Access) -> None:
            raise errors.GatewayPathUnavailable

        device = hooked_device(before_read=refuse)
        before = contents(device)
        answer = device.answer(request_.encode(), CALLER)
        assert answer == bytes([request_.function | 0x80, 10])
        assert contents(device) == before

    def test_refusal_of_one_piece_refuses_all(self) -> None:
        def refuse(access: Access) -> None:
            if access.file == 3:
                raise errors.MemoryParityError

        device = hooked_device(before_write=refuse)
        before = contents(device)
        request = pdu.WriteFileRecords([(4, 9, [5, 6]), (3, 12, [7])])
        assert device.answer(request.encode()) == b"\x95\x08"
        assert contents(device) == before

    def test_before_read_refreshes_what_is_read(self) -> None:
        turn = 0

        def refresh(access: Access) -> None:
            nonlocal turn
            turn += 1
            if access.table == "fifo":
                device.fifos[access.address] = [turn]
            elif access.table == "file":
                device.files[access.file][access.address] = turn
            else:
                getattr(device.mapping, access.table)[access.address] = turn & 1

        device = hooked_device(before_read=refresh)
        assert device.answer(b"\1" + words(10, 1)) == b"\1\1\1"
        assert device.answer(b"\1" + words(10, 1)) == b"\1\1\0"
        assert device.answer(b"\2" + words(20, 1)) == b"\2\1\1"
        device.answer(b"\2" + words(20, 1))
        assert device.answer(b"\3" + words(100, 1)) == b"\3\2\0\1"
        device.answer(b"\3" + words(100, 1))
        assert device.answer(b"\4" + words(200, 1)) == b"\4\2\0\1"
        assert device.answer(b"\x18\0\x09") == b"\x18\0\4\0\1\0\x08"
        assert device.answer(b"\x14\7\6" + words(4, 9, 1)) == b"\x14\4\3\6\0\x09"

    def test_a_hook_can_shorten_a_queue_that_is_too_long(self) -> None:
        def cut(access: Access) -> None:
            del device.fifos[access.address][31:]

        device = hooked_device(before_read=cut)
        device.fifos[9] = [1] * 40
        assert len(device.answer(b"\x18\0\x09")) == 5 + 62

    def test_the_written_values_replace_those_that_a_hook_set(self) -> None:
        def before(access: Access) -> None:
            device.mapping.holding_registers[100:103] = [1, 2, 3]

        device = hooked_device(before_write=before)
        device.answer(b"\6" + words(101, 9))
        assert device.mapping.holding_registers[100:103] == [1, 9, 3]

    def test_after_write_may_set_what_was_written(self) -> None:
        def after(access: Access) -> None:
            device.mapping.holding_registers[access.address] = 0

        device = hooked_device(after_write=after)
        assert device.answer(b"\6" + words(101, 9)) == b"\6" + words(101, 9)
        assert device.mapping.holding_registers[101] == 0

    def test_no_other_thread_comes_between_hook_and_write(self) -> None:
        inside, outside = threading.Event(), threading.Event()
        order: list[str] = []

        def before(access: Access) -> None:
            inside.set()
            assert not outside.wait(0.02)  # the other thread waits for the lock
            order.append("hook")

        device = hooked_device(before_write=before)

        def other() -> None:
            inside.wait()
            with device.mapping:
                order.append("other")
            outside.set()

        thread = threading.Thread(target=other)
        thread.start()
        answer = device.answer(b"\6" + words(100, 7))
        thread.join()
        assert answer == b"\6" + words(100, 7)
        assert order == ["hook", "other"]


def test_every_request_that_writes_and_no_other_changes_a_table() -> None:
    assert all(request.changes == bool(kind.writes) for request, kind in ACCESSES.items())
