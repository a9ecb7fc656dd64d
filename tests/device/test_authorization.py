"""Authorisation of every request: MB-TCP-Security-v36, R-24 to R-31."""

import logging
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.checks import REQUEST_OBJECTS, examples
from libmodbus_py import Access, Device, IllegalDataAddress, Mapping, ServerDeviceBusy, pdu
from libmodbus_py.device.authorization import Authorization, UnauthorizedError
from libmodbus_py.device.event_log import EventLog
from libmodbus_py.serve import Caller, ClientRequest
from tests.support.cases import each_case

CLASSES = {*pdu.REQUESTS.values(), pdu.ReadDeviceIdentification}


class Tables:
    """A device whose every table, file, queue and function answers; `done` records the calls."""

    def __init__(self, authorize: Any, **hooks: Any) -> None:
        self.done: list[object] = []
        self.device = Device(
            Mapping(65536, 65536, 65536, 65536),
            files={3: [0] * 100, 4: [0] * 100},
            fifos={0x04DE: [1, 2], 5: [3]},
            canopen=self._canopen,
            handlers={},
            **{"before_write": self.done.append, "before_read": self.done.append} | hooks,
            authorize=authorize,
        )

    def _canopen(self, data: bytes) -> bytes:
        self.done.append(data)
        return data

    def contents(self) -> object:
        mapping, device = self.device.mapping, self.device
        tables = (mapping.coils, mapping.holding_registers)
        files = [file.read(0, 100) for file in device.files.values()]
        return [bytes(table.view) for table in tables], files, device.diagnostic_register


def denying(requests: list[ClientRequest]) -> Any:
    def authorize(asked: ClientRequest) -> bool:
        requests.append(asked)
        return False

    return authorize


def test_there_is_an_example_of_each_class() -> None:
    """Otherwise the next tests would leave a class out."""
    assert {type(request) for request in REQUEST_OBJECTS} == CLASSES | {pdu.RawRequest}


@each_case("request_", REQUEST_OBJECTS, ids=lambda each: type(each).__name__)
@each_case("serial", [False, True], ids=["network", "serial line"])
def test_denied_requests_are_not_executed(request_: pdu.Request[Any], serial: bool) -> None:
    requests: list[ClientRequest] = []
    tables = Tables(denying(requests))
    log = EventLog(is_serial=serial)
    before = tables.contents()
    answer = tables.device.answer(request_.encode(), Caller(7, "here", log, role="Nobody"))
    assert answer == bytes([request_.function | 0x80, 1])
    assert tables.done == []
    assert tables.contents() == before
    assert log.listen_only is False
    (asked,) = requests
    assert (asked.role, asked.unit, asked.peer) == ("Nobody", 7, "here")
    assert asked.function == request_.function
    assert asked.request == (None if isinstance(request_, pdu.RawRequest) else request_)


@each_case("example", examples("pdu"), ids=lambda each: each[:8].hex())
def test_allowed_requests_are_answered(example: bytes) -> None:
    guarded, free = Tables(lambda asked: True), Tables(None)
    assert guarded.device.answer(example) == free.device.answer(example)
    assert guarded.contents() == free.contents()
    assert len(guarded.done) == len(free.done)


@settings(max_examples=100)
@given(st.binary(min_size=1, max_size=253))
def test_authorize_is_called_once_for_any_bytes(data: bytes) -> None:
    requests: list[ClientRequest] = []
    answer = TABLES.answered(data, denying(requests))
    is_request = data[0] < 0x80
    assert answer == (bytes([data[0] | 0x80, 1]) if is_request else b"")
    assert len(requests) == is_request


class _Shared:
    """One device for many examples, each with its own authorisation."""

    def __init__(self) -> None:
        self._authorize: Any = None
        self._tables = Tables(lambda asked: self._authorize(asked))

    def answered(self, data: bytes, authorize: Any) -> bytes:
        self._authorize = authorize
        return self._tables.device.answer(data)


TABLES = _Shared()


def test_authorize_is_called_for_all_128_codes() -> None:
    for function in range(128):
        requests: list[ClientRequest] = []
        assert TABLES.answered(bytes([function]), denying(requests)) == bytes([function | 0x80, 1])
        assert [(asked.function, asked.request) for asked in requests if asked.request is None] in (
            [(function, None)],
            [],  # functions that are asked with their code alone
        )
        assert len(requests) == 1


def test_authorize_gets_the_reads_and_writes_of_a_request() -> None:
    calls: list[ClientRequest] = []
    caller = Caller(7, "here", role="Operator")
    Tables(denying(calls)).device.answer(pdu.ReadWriteRegisters(1, 2, 3, (4, 5)).encode(), caller)
    who = 0, 7, "here", "Operator"
    assert calls[0].writes == (Access("holding_registers", 3, 2, (4, 5), *who),)
    assert calls[0].reads == (Access("holding_registers", 1, 2, (), *who),)


def test_authorize_is_called_before_handlers() -> None:
    requests: list[object] = []

    def handle(request: pdu.ReadCoils) -> list[bool]:
        requests.append(request)
        return [True]

    for is_allowed in (False, True):
        guard = {"authorize": lambda asked, it=is_allowed: it}
        device = Device(Mapping(1), handlers={pdu.ReadCoils: handle}, **guard)  # type: ignore[arg-type]
        assert device.answer(b"\1\0\0\0\1") == (b"\1\1\1" if is_allowed else b"\x81\1")
        assert len(requests) == is_allowed


def test_authorize_is_called_for_each_request() -> None:
    answers = iter([True, False, True])
    device = Device(Mapping(holding_registers=1), authorize=lambda asked: next(answers))
    request = pdu.ReadHoldingRegisters(0, 1).encode()
    assert [device.answer(request)[0] for _ in range(3)] == [0x03, 0x83, 0x03]


@each_case(
    ("data", "otherwise"),
    [
        (pdu.ReadHoldingRegisters(50, 1).encode(), 2),  # what does not exist
        (pdu.WriteRegister(50, 1).encode(), 2),
        (pdu.ReadFileRecords(((9, 1, 2),)).encode(), 2),
        (pdu.ReadFifoQueue(5).encode(), 2),
        (b"\x2b\x0e\x04\x77", 2),  # a missing object
        (b"\x03\x00\x00\x00\x7e", 3),  # 126 registers
        (b"\x03\x00\x00\x00", 3),
        (b"\x05\x00\x00\x12\x34", 3),  # neither on nor off
        (b"\x03\xff\xff\x00\x02", 2),  # beyond 65535
        (b"\x08\x00\x02\x00\x01", 3),
    ],
)
def test_without_permission_every_bad_request_is_answered_1(data: bytes, otherwise: int) -> None:
    accesses: list[object] = []
    for is_allowed, code in ((True, otherwise), (False, 1)):
        device = Device(
            Mapping(holding_registers=10, coils=1),
            before_read=accesses.append,
            before_write=accesses.append,
            authorize=lambda asked, it=is_allowed: it,
        )
        assert device.answer(data) == bytes([data[0] | 0x80, code])
    assert accesses == []


def test_authorize_is_called_before_hooks() -> None:
    order: list[str] = []

    def authorize(asked: ClientRequest) -> bool:
        order.append("authorize")
        return True

    def before_write(access: Access) -> None:
        order.append("before_write")
        raise IllegalDataAddress

    device = Device(Mapping(1), authorize=authorize, before_write=before_write)
    assert device.answer(pdu.WriteCoil(0, True).encode()) == b"\x85\x02"
    assert order == ["authorize", "before_write"]


def test_broadcasts_are_asked_about() -> None:
    calls: list[int] = []
    for is_allowed in (False, True):
        device = Device(Mapping(coils=1), authorize=lambda asked, it=is_allowed: it)
        caller = Caller(0, "line", is_broadcast=True, on_unauthorized=lambda _: calls.append(1))
        assert device.answer(pdu.WriteCoil(0, True).encode(), caller) == b""
        assert device.mapping.coils[0] == is_allowed
    assert calls == [1]


def test_a_denied_restart_or_listen_only_has_no_effect() -> None:
    log = EventLog(is_serial=True)
    device = Device(Mapping(1), authorize=lambda asked: False)
    for data in (b"\x08\x00\x04\x00\x00", b"\x08\x00\x01\xff\x00"):
        assert device.answer(data, Caller(log=log)) == b"\x88\x01"
    assert not log.listen_only
    assert log.counter(pdu.SubFunction.BUS_EXCEPTION_ERROR_COUNT) == 2

    engineered = Device(Mapping(1), authorize=lambda asked: asked.role == "Engineer")
    engineered.answer(b"\x08\x00\x04\x00\x00", Caller(log=log, role="Engineer"))
    assert log.listen_only
    engineered.answer(b"\x08\x00\x01\x00\x00", Caller(log=log))
    assert log.listen_only


def test_on_unauthorized_is_called_for_requests_without_permission_alone() -> None:
    calls: list[int] = []
    device = Device(Mapping(1), authorize=lambda asked: asked.function == 1)
    caller = Caller(on_unauthorized=lambda _: calls.append(1))
    device.answer(pdu.ReadCoils(0, 1).encode(), caller)
    device.answer(pdu.ReadCoils(9, 1).encode(), caller)  # refused, but not by authorisation
    assert calls == []
    device.answer(pdu.WriteCoil(0, True).encode(), caller)
    device.answer(b"\x05", caller)
    assert calls == [1, 1]


async def forgotten(asked: ClientRequest) -> bool:
    return True


@each_case(
    "authorize",
    [
        lambda asked: None,
        lambda asked: 1,
        lambda asked: "yes",
        lambda asked: forgotten(asked),
        lambda asked: 1 / 0,
    ],
    ids=["None", "1", "text", "coroutine", "raises"],
)
def test_an_error_in_authorize_denies_the_request(authorize: Any, caplog: pytest.LogCaptureFixture):
    caplog.clear()
    tables = Tables(authorize)
    for _ in range(3):
        assert tables.device.answer(pdu.WriteCoil(0, True).encode()) == b"\x85\x04"
    assert tables.device.mapping.coils[0] is False
    assert tables.done == []
    assert len(caplog.records) == 1


def test_authorize_may_refuse_with_another_exception() -> None:
    def authorize(asked: ClientRequest) -> bool:
        raise ServerDeviceBusy

    tables = Tables(authorize)
    assert tables.device.answer(pdu.WriteCoil(0, True).encode()) == b"\x85\x06"
    assert tables.done == []


def test_an_authorize_that_is_no_function_is_refused_at_once() -> None:
    with pytest.raises(TypeError, match="authorize must be a function, not dict"):
        Device(Mapping(1), authorize={})  # type: ignore[arg-type]


def test_a_device_that_authorizes_is_never_answered_in_c() -> None:
    assert Device(Mapping(1)).in_c
    assert not Device(Mapping(1), authorize=lambda asked: True).in_c


def refuse(guard: Authorization, peer: str, role: str | None = "Viewer") -> None:
    access = Access("holding_registers", 100, 10)
    with pytest.raises(UnauthorizedError):
        guard.check(ClientRequest(role, 17, peer, 16, None, (access,)))


def test_client_and_request_are_logged_once_for_each_role(caplog: pytest.LogCaptureFixture) -> None:
    guard = Authorization(lambda asked: False)
    for port in range(51234, 51334):
        refuse(guard, f"192.0.2.7:{port}")
        refuse(guard, f"[2001:db8::1]:{port}", None)
    assert [record.message for record in caplog.records] == [
        "192.0.2.7:51234, with the role 'Viewer', may not use function 16 of unit 17, "
        "write holding_registers 100..109",
        "[2001:db8::1]:51234, without a role, may not use function 16 of unit 17, "
        "write holding_registers 100..109",
    ]
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


def test_a_role_is_one_line_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    refuse(Authorization(lambda asked: False), "here", "a\nERROR b\u202e")
    assert caplog.records[0].message.isprintable()
