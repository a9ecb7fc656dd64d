"""A device: worked examples, the order of checks, broadcasts, and two devices in one program."""

import pytest

from libmodbus_py import Access, Device, Mapping, pdu
from libmodbus_py.device.event_log import EventLog
from libmodbus_py.serve import Caller, RecordFile
from tests.device.devices import contents, diagnose, identified, new_device, page, words
from tests.device.model import KNOWN
from tests.device.test_diagnostics import vector
from tests.support.cases import each_case
from tests.support.vectors import EXCEPTIONS, REQUESTS, RESPONSES, FrameVector, rows


class TestWorkedExamples:
    @each_case(
        "vector",
        rows([vector for vector in RESPONSES if vector.request and vector.function in KNOWN]),
    )
    def test_answer_is_that_of_the_example(self, vector: FrameVector) -> None:
        """On a device with the values of the example's response."""
        (request,) = (request for request in REQUESTS if request.id == vector.request)
        mapping = Mapping(*[65536] * 4)
        device = Device(mapping, files={3: range(20), 4: range(20)})
        fields = request.fields
        start = fields.get("address", fields.get("read_address"))
        values = vector.fields.get("values")
        tables = {
            1: mapping.coils,
            2: mapping.discrete_inputs,
            3: mapping.holding_registers,
            4: mapping.input_registers,
            23: mapping.holding_registers,
        }
        if vector.function in tables:
            tables[vector.function][start : start + len(values)] = values
        if vector.function == 20:
            for record, piece in zip(
                fields["sub_requests"], vector.fields["sub_responses"], strict=True
            ):
                for at, value in enumerate(piece["values"]):
                    device.files[record["file"]][record["record"] + at] = value
        assert device.answer(request.pdu) == vector.pdu

    @pytest.mark.parametrize("vector", rows([item for item in EXCEPTIONS if item.request]))
    def test_refusal_is_that_of_the_example(self, vector: FrameVector) -> None:
        (request,) = (request for request in REQUESTS if request.id == vector.request)
        assert Device(Mapping(0, 0, 2048, 0)).answer(request.pdu) == vector.pdu


class TestExceptions:
    def test_unknown_functions_are_illegal(self) -> None:
        device = new_device()
        for code in set(range(128)) - set(pdu.REQUESTS):
            for body in (b"", b"\0\0\0\1"):
                assert device.answer(bytes([code]) + body) == bytes([code | 0x80, 1])

    def test_codes_from_128_on_get_no_answer(self) -> None:
        device = new_device()
        for code in range(128, 256):
            for body in (b"", b"\2", b"\0\0\0\1"):
                assert device.answer(bytes([code]) + body) == b""

    @each_case(
        ("request_pdu", "code"),
        [
            # Section 6: quantity and constants before addresses, the length before all.
            (b"\x01" + words(0, 0), 3),
            (b"\x01" + words(0, 2001), 3),
            (b"\x01" + words(0, 1), 2),
            (b"\x01" + words(0, 1) + b"\0", 3),
            (b"\x02" + words(65535, 2001), 3),
            (b"\x02" + words(65535, 2), 2),
            (b"\x02" + words(2099, 2), 2),
            (b"\x03" + words(0, 126), 3),
            (b"\x03" + words(399, 2), 2),
            (b"\x03" + words(99, 2), 2),
            (b"\x04" + words(199, 126), 3),
            (b"\x04" + words(199, 2), 2),
            (b"\x05" + words(0, 1), 3),
            (b"\x05" + words(0, 0), 2),
            (b"\x05" + words(0, 0xFF00), 2),
            (b"\x05" + words(2100, 0x00FF), 3),
            (b"\x06" + words(0, 1), 2),
            (b"\x06" + words(0, 1) + b"\0", 3),
            (b"\x0f" + words(0, 8) + b"\2\0\0", 3),
            (b"\x0f" + words(0, 8) + b"\1\0", 2),
            (b"\x0f" + words(2099, 2) + b"\1\0", 2),
            (b"\x10" + words(0, 1) + b"\4" + words(1, 2), 3),
            (b"\x10" + words(0, 1) + b"\2" + words(1), 2),
            (b"\x10" + words(399, 2) + b"\4" + words(1, 2), 2),
            (b"\x16" + words(0, 1, 1), 2),
            (b"\x16" + words(0, 1), 3),
            (b"\x17" + words(0, 0, 0, 1) + b"\2" + words(1), 3),
            (b"\x17" + words(0, 1, 100, 1) + b"\2" + words(1), 2),
            (b"\x17" + words(100, 1, 0, 1) + b"\2" + words(1), 2),
            (b"\x17" + words(0, 126, 0, 1) + b"\2" + words(1), 3),
        ],
        ids=lambda value: value.hex() if isinstance(value, bytes) else str(value),
    )
    def test_requests_are_checked_in_this_order(self, request_pdu: bytes, code: int) -> None:
        device = new_device()
        before = contents(device)
        assert device.answer(request_pdu) == bytes([request_pdu[0] | 0x80, code])
        assert contents(device) == before


class TestBroadcasts:
    def test_writes_are_executed_in_silence(self) -> None:
        device = new_device()
        caller = Caller(0, "", EventLog(is_serial=True), is_broadcast=True)
        assert device.answer(b"\x06" + words(100, 7), caller) == b""
        assert device.answer(b"\x06" + words(0, 7), caller) == b""
        assert device.mapping.holding_registers[100] == 7

    def test_a_broadcast_that_is_no_write_is_ignored(self) -> None:
        accesses: list[Access] = []
        device = Device(Mapping(holding_registers=4), before_read=accesses.append)
        line = EventLog(is_serial=True)
        line.delimiter = 0x24
        caller = Caller(0, "", line, is_broadcast=True)
        bodies = (
            b"\3" + words(0, 1),
            b"\x08" + words(1, 0),
            b"\x08" + words(4, 0),
            b"\x11",
            b"\x41",
        )
        for body in (*bodies, b"\x17" + words(0, 1, 0, 1) + b"\2" + words(9)):
            assert device.answer(body, caller) == b""
        assert accesses == []
        assert not line.listen_only
        assert line.delimiter == 0x24  # no restart
        assert device.mapping.holding_registers[0] == 0


class TestTwoDevices:
    """All state belongs to a device, and none to a module or class."""

    def test_identification_status_identifier_and_register(self) -> None:
        first = Device(Mapping(), identification={0: "first"}, exception_status=1)
        second = Device(Mapping(), identification={0: "second", 128: "more"})
        first.diagnostic_register = 7
        first.server_id = pdu.ServerId(b"\7", False)
        assert identified(first, 0)[0].objects == {0: b"first"}
        assert identified(second, 0)[0].objects == {0: b"second"}
        assert [device.answer(page(4))[3] for device in (first, second)] == [0x81, 0x83]
        assert second.answer(b"\x07") == b"\x07\0"
        assert diagnose(second, 2) == b"\x08\0\2\0\0"
        assert second.answer(b"\x11") == vector("own-6.13-rsp")
        assert Device(Mapping()).answer(page(4))[3] == 0x81

    def test_files_and_queues(self) -> None:
        files: dict[int, list[int]] = {1: [0, 0]}
        first = Device(Mapping(), files=files, fifos=files)
        second = Device(Mapping(), files=files, fifos=files)
        request = pdu.WriteFileRecords([(1, 0, [5, 6])]).encode()
        assert first.answer(request) == request
        first.fifos[1].append(9)
        first.fifos[2] = []
        assert list(second.files[1]) == [0, 0]
        assert second.fifos == {1: [0, 0]}
        assert files == {1: [0, 0]}
        third, fourth = Device(Mapping()), Device(Mapping())
        third.fifos[1] = [1]
        third.files[1] = RecordFile([1])
        assert (fourth.fifos, fourth.files) == ({}, {})
