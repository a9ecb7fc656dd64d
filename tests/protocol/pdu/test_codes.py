"""Function codes, the lengths of requests and responses, and which requests change something."""

from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu import RawRequest, ReadDeviceIdentification
from libmodbus_py.protocol.pdu.interface import MeiType, ReadDeviceIdCode
from libmodbus_py.protocol.pdu.request import IN_C
from libmodbus_py.services.gateway.line import request_of
from tests.protocol.pdu.examples import EXAMPLES, Doubled, tells_its_length
from tests.support.cases import each_case
from tests.support.vectors import FRAMES, FrameVector, rows

# Application protocol, 6.8.1.
SUB_FUNCTIONS = {
    "RETURN_QUERY_DATA": 0,
    "RESTART_COMMUNICATIONS": 1,
    "RETURN_DIAGNOSTIC_REGISTER": 2,
    "CHANGE_ASCII_DELIMITER": 3,
    "FORCE_LISTEN_ONLY": 4,
    "CLEAR_COUNTERS": 10,
    "BUS_MESSAGE_COUNT": 11,
    "BUS_COMMUNICATION_ERROR_COUNT": 12,
    "BUS_EXCEPTION_ERROR_COUNT": 13,
    "SERVER_MESSAGE_COUNT": 14,
    "SERVER_NO_RESPONSE_COUNT": 15,
    "SERVER_NAK_COUNT": 16,
    "SERVER_BUSY_COUNT": 17,
    "BUS_CHARACTER_OVERRUN_COUNT": 18,
    "CLEAR_OVERRUN": 20,
}


def test_sub_functions_have_the_codes_of_the_specification() -> None:
    assert {code.name: code.value for code in pdu.SubFunction} == SUB_FUNCTIONS


def test_mei_types_have_the_codes_of_the_specification() -> None:
    assert list(MeiType) == [0x0D, 0x0E]
    assert {code.value for code in ReadDeviceIdCode} == {1, 2, 3, 4}


class TestLengthRules:
    @each_case("vector", rows(FRAMES))
    def test_the_length_is_known_from_the_first_bytes(self, vector: FrameVector) -> None:
        rule = pdu.request_length if vector.kind == "request" else pdu.response_length
        lengths = [rule(vector.pdu[:end]) for end in range(1, len(vector.pdu) + 1)]
        right = len(vector.pdu) if tells_its_length(vector.pdu) else 0
        assert lengths[-1] == right
        assert set(lengths) <= {None, right}

    @each_case("code", [0x80, 0x81, 0xAB, 0xFF])
    def test_every_exception_response_has_two_bytes(self, code: int) -> None:
        assert pdu.response_length(bytes([code])) == 2

    def test_unknown_functions_have_no_length_rule(self) -> None:
        for code in set(range(256)) - set(pdu.REQUESTS):
            assert pdu.request_length(bytes([code, 0])) == 0
        for code in set(range(128)) - set(pdu.REQUESTS):
            assert pdu.response_length(bytes([code, 0])) == 0

    @pytest.mark.parametrize("rule", [pdu.request_length, pdu.response_length])
    def test_diagnostics_have_a_length_rule(self, rule: Callable[[bytes], int | None]) -> None:
        assert rule(b"\x08") is rule(b"\x08\0") is None
        assert rule(b"\x08\0\0") == rule(b"\x08\0\0\1") == 0
        for sub_function in (1, 4, 0x14, 0x100, 0xFFFF):
            assert rule(b"\x08" + sub_function.to_bytes(2, "big")) == 5

    def test_encapsulated_interfaces_have_a_length_rule_for_identification(self) -> None:
        assert pdu.request_length(b"\x2b") is pdu.response_length(b"\x2b") is None
        for mei_type in set(range(256)) - {14}:
            head = bytes([0x2B, mei_type])
            assert pdu.request_length(head) == pdu.response_length(head) == 0
        assert pdu.request_length(b"\x2b\x0e") == 4
        assert pdu.response_length(b"\x2b\x0e") is None
        assert pdu.response_length(b"\x2b\x0e\1\x83\0\0\0") == 7

    def test_byte_count_of_a_queue_is_two_bytes_wide(self) -> None:
        assert pdu.response_length(b"\x18\0") is None
        assert pdu.response_length(b"\x18\0\x40") == 67
        assert pdu.response_length(b"\x18\1\0") == 259

    def test_registered_classes_have_their_own_length_rules(self) -> None:
        assert pdu.fixed(4)(b"") == 4
        assert pdu.counted(3, at=2)(b"ab") is None
        assert pdu.counted(3, at=2)(b"ab\5") == 8
        assert pdu.unknown_length(b"abc") == 0


def test_c_knows_the_length_rule_of_each_function_code() -> None:
    rules = {
        (code, name): rule
        for code, request in pdu.REQUESTS.items()
        for name, rule in (
            ("request", request.request_length),
            ("response", request.response_length),
        )
    }
    assert [place for place, rule in rules.items() if rule not in IN_C] == []


READS = (1, 2, 3, 4, 7, 11, 12, 17, 20, 24)
WRITES = (5, 6, 15, 16, 21, 22, 23)

READING = [
    *(example for example in EXAMPLES if example.function in READS),
    *(pdu.Diagnostics(number) for number in (0, 2, *range(11, 19))),
    pdu.ReadDeviceIdentification(1),
]
CHANGING = [
    *(example for example in EXAMPLES if example.function in WRITES),
    *(pdu.Diagnostics(number) for number in (1, 3, 4, 10, 20)),
    pdu.EncapsulatedTransport(13, b"\0"),  # the effect of a CANopen message is unknown
    pdu.RawRequest(100),
]


@each_case("request_", [*READING, *CHANGING])
def test_a_request_class_states_whether_it_changes_a_device(request_: pdu.Request[Any]) -> None:
    assert request_.changes is (request_ in CHANGING)
    assert request_of(request_.encode()).changes is (request_ in CHANGING)


def test_the_tests_above_use_every_function() -> None:
    assert {code.function for code in READING + CHANGING} == {*pdu.REQUESTS, 100}


def test_reads_and_writes_of_absolute_values_are_repeatable() -> None:
    once = {8, 43}
    for function, kind in pdu.REQUESTS.items():
        assert kind.repeatable is (function not in once), kind
    assert ReadDeviceIdentification.repeatable is True
    assert RawRequest.repeatable is False
    assert Doubled.repeatable is False
