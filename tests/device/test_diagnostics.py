"""Status, identifier, counters and diagnostics of a device."""

from typing import Any

import pytest

from libmodbus_py import Device, Mapping, pdu
from libmodbus_py.protocol.pdu import SubFunction
from libmodbus_py.serve import Caller
from tests.device.devices import caller_on, diagnose, new_device, on_a_line, words
from tests.support.cases import each_case
from tests.support.vectors import REQUESTS, RESPONSES


def vector(name: str) -> bytes:
    (body,) = (request.pdu for request in REQUESTS + RESPONSES if request.id == name)
    return body


class TestStatusAndIdentifier:
    def test_exception_status_is_that_of_the_device(self) -> None:
        device = Device(Mapping(), exception_status=0x6D)
        assert device.answer(vector("s1-6.7-req")) == vector("s1-6.7-rsp")
        device.exception_status = 255
        assert device.answer(b"\x07") == b"\x07\xff"
        assert Device(Mapping()).answer(b"\x07") == b"\x07\0"

    @pytest.mark.parametrize(
        ("status", "error"), [(-1, ValueError), (256, ValueError), ("1", TypeError)]
    )
    def test_exception_status_is_a_byte(self, status: Any, error: type[Exception]) -> None:
        with pytest.raises(error, match=r"^exception_status must be an? in |^exception_status "):
            Device(Mapping(), exception_status=status)

    def test_server_id_is_that_of_the_device(self) -> None:
        assert Device(Mapping()).answer(b"\x11") == vector("own-6.13-rsp")
        device = Device(Mapping(), server_id=pdu.ServerId(b"\xb4", False))
        assert device.answer(b"\x11") == vector("own-6.13-off-rsp")
        device.server_id = pdu.ServerId(b"pump", True, b"7")
        assert device.answer(b"\x11") == b"\x11\6pump\xff7"


class TestCounters:
    """The rest stands in test_event_log.py, on real lines."""

    def test_event_counter_wraps(self) -> None:
        device, caller = new_device(), on_a_line()
        assert caller.log is not None
        caller.log.note_exchanges(65535, 0, [])
        device.answer(b"\x03" + words(100, 1), caller)
        assert device.answer(b"\x0b", caller) == b"\x0b\0\0\0\0"

    def test_every_line_has_its_own_notes(self) -> None:
        device, first, second = new_device(), on_a_line(), on_a_line()
        for _ in range(3):
            device.answer(b"\x03" + words(100, 1), first)
        assert diagnose(device, 0x0E, b"\0\0", first) == b"\x08\0\x0e\0\4"
        assert diagnose(device, 0x0E, b"\0\0", second) == b"\x08\0\x0e\0\1"
        assert diagnose(device, 0x0E) == b"\x08\0\x0e\0\1"


RESERVED = (*range(5, 0x0A), 0x13, 0x15, 0x16, 0x20, 0xFF, 0x100, 0x0A00, 0x8000, 0xFFFF)
PLAIN = (2, 0x0A, *range(0x0B, 0x13), 0x14)
both_lines = pytest.mark.parametrize("serial", [True, False], ids=["serial", "tcp"])


class TestDiagnostics:
    def test_all_sub_functions_of_the_specification_are_tested(self) -> None:
        assert {0, 1, 3, 4, *PLAIN} == set(SubFunction)
        assert not set(RESERVED) & set(SubFunction)

    @both_lines
    @each_case("size", [2, 4, 100, 250])
    def test_query_data_are_returned(self, serial: bool, size: int) -> None:
        data = bytes(at * 7 & 0xFF for at in range(size))
        device = new_device()
        assert diagnose(device, 0, data, caller_on(serial)) == b"\x08\0\0" + data
        assert device.answer(vector("s1-6.8-req")) == vector("s1-6.8-rsp")

    @both_lines
    def test_unknown_and_reserved_sub_functions_are_illegal(self, serial: bool) -> None:
        """Before their data are checked."""
        for sub_function in RESERVED:
            for data in (b"\0\0", b"\0\1", b"\xff\xff"):
                answer = diagnose(new_device(), sub_function, data, caller_on(serial))
                assert answer == b"\x88\1"

    @both_lines
    @each_case("sub_function", PLAIN)
    def test_data_other_than_0_are_refused(self, serial: bool, sub_function: int) -> None:
        caller = caller_on(serial)
        for data in (b"\0\1", b"\1\0", b"\xff\0", b"\xff\xff"):
            assert diagnose(new_device(), sub_function, data, caller) == b"\x88\3"
        answer = diagnose(new_device(), sub_function, b"\0\0", caller)
        assert answer[:3] == b"\x08" + words(sub_function)
        assert len(answer) == 5

    @both_lines
    def test_length_is_checked_first(self, serial: bool) -> None:
        for sub_function in (*range(1, 0x20), 0xFFFF):
            for size in (0, 1, 3, 4):
                answer = diagnose(new_device(), sub_function, bytes(size), caller_on(serial))
                assert answer == b"\x88\3"

    @pytest.mark.parametrize("data", [b"\0\0", b"\xff\0"])
    def test_restart_echoes_and_then_clears(self, data: bytes) -> None:
        device, caller = new_device(), on_a_line()
        device.answer(b"\x03" + words(100, 1), caller)
        assert caller.log is not None
        caller.log.delimiter = 0x24
        assert diagnose(device, 1, data, caller) == b"\x08\0\1" + data
        assert caller.log.delimiter == 0x0A
        assert device.answer(b"\x0b", caller) == b"\x0b\0\0\0\0"
        log = device.answer(b"\x0c", caller)[8:]
        # newest first: this request, function 11, and the restart
        assert log[:4] == b"\x80\x40\x80\0"
        assert log[4:] == (b"" if data[0] else b"\x40\x80\x40\x80")

    @each_case("data", [b"\0\1", b"\xff\1", b"\xff\xff", b"\1\0", b"\xfe\0"])
    def test_restart_takes_two_options(self, data: bytes) -> None:
        device, caller = new_device(), on_a_line()
        device.answer(b"\x03" + words(100, 1), caller)
        assert diagnose(device, 1, data, caller) == b"\x88\3"
        assert device.answer(b"\x0b", caller) == b"\x0b\0\0\0\1"

    def test_listen_only_takes_0_and_is_not_answered(self) -> None:
        device, caller = new_device(), on_a_line()
        assert caller.log is not None
        for data in (b"\0\1", b"\xff\0"):
            assert diagnose(device, 4, data, caller) == b"\x88\3"
            assert not caller.log.listen_only
        assert diagnose(device, 4, b"\0\0", caller) == b""
        assert caller.log.listen_only

    def test_listening_on_one_line_is_answering_on_another(self) -> None:
        device, silenced = new_device(), on_a_line()
        diagnose(device, 4, b"\0\0", silenced)
        assert device.answer(b"\x03" + words(100, 1), silenced) == b""
        assert device.answer(b"\x03" + words(100, 1), on_a_line()) == b"\x03\2\0\0"
        assert device.answer(b"\x03" + words(100, 1)) == b"\x03\2\0\0"

    @pytest.mark.parametrize("sub_function", [1, 4])
    def test_listen_only_is_refused_over_tcp(self, sub_function: int) -> None:
        for data in (b"\0\0", b"\xff\0", b"\0\1"):
            for caller in (Caller(), caller_on(serial=False)):
                device = new_device()
                assert diagnose(device, sub_function, data, caller) == b"\x88\1"
                assert device.answer(b"\x03" + words(100, 1), caller) == b"\x03\2\0\0"

    @both_lines
    def test_delimiter_is_a_character_with_no_other_use(self, serial: bool) -> None:
        device = new_device()
        for character in range(256):
            caller = caller_on(serial)
            assert caller.log is not None
            data = bytes([character, 0])
            answer = diagnose(device, 3, data, caller)
            if character > 0x7F or chr(character) in ":\r0123456789abcdefABCDEF":
                assert answer == b"\x88\3"
                assert caller.log.delimiter == 0x0A
            else:
                assert answer == b"\x08\0\3" + data
                assert caller.log.delimiter == character
        for zero in (1, 0x0A, 255):
            assert diagnose(device, 3, bytes([0x24, zero]), caller_on(serial)) == b"\x88\3"

    @both_lines
    def test_the_diagnostic_register_is_that_of_the_device(self, serial: bool) -> None:
        device, caller = new_device(), caller_on(serial)
        assert diagnose(device, 2, b"\0\0", caller) == b"\x08\0\2\0\0"
        device.diagnostic_register = 0xBEEF
        assert diagnose(device, 2, b"\0\0", caller) == b"\x08\0\2\xbe\xef"
        assert diagnose(device, 0x0A, b"\0\0", caller) == b"\x08\0\x0a\0\0"
        assert diagnose(device, 2, b"\0\0", caller) == b"\x08\0\2\0\0"
