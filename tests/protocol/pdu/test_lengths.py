"""
The lengths of requests and responses, as their first bytes tell.
"""

from collections.abc import Callable

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.pdu.request import IN_C
from tests.protocol.pdu.examples import tells_its_length
from tests.support.cases import each_case
from tests.support.vectors import FRAMES, FrameVector, rows


class TestLengthRules:
    @each_case("vector", rows(FRAMES))
    def test_a_length_is_known_from_the_head_and_right(self, vector: FrameVector) -> None:
        rule = pdu.request_length if vector.kind == "request" else pdu.response_length
        lengths = [rule(vector.pdu[:end]) for end in range(1, len(vector.pdu) + 1)]
        right = len(vector.pdu) if tells_its_length(vector.pdu) else 0
        assert lengths[-1] == right
        assert set(lengths) <= {None, right}

    @each_case("code", [0x80, 0x81, 0xAB, 0xFF])
    def test_every_exception_response_has_two_bytes(self, code: int) -> None:
        assert pdu.response_length(bytes([code])) == 2

    def test_nothing_tells_the_length_of_unknown_functions(self) -> None:
        for code in set(range(256)) - set(pdu.REQUESTS):
            assert pdu.request_length(bytes([code, 0])) == 0
        for code in set(range(128)) - set(pdu.REQUESTS):
            assert pdu.response_length(bytes([code, 0])) == 0

    @pytest.mark.parametrize("rule", [pdu.request_length, pdu.response_length])
    def test_diagnostics_tell_but_for_query_data(self, rule: Callable[[bytes], int | None]) -> None:
        assert rule(b"\x08") is rule(b"\x08\0") is None
        assert rule(b"\x08\0\0") == rule(b"\x08\0\0\1") == 0
        for sub_function in (1, 4, 0x14, 0x100, 0xFFFF):
            assert rule(b"\x08" + sub_function.to_bytes(2, "big")) == 5

    def test_encapsulated_interfaces_tell_where_it_is_identification(self) -> None:
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

    def test_rules_for_classes_of_ones_own(self) -> None:
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
