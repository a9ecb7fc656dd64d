"""
Length rules of requests and responses: C knows those of every function code that tells its length.
"""

from __future__ import annotations

from libmodbus_py.protocol import pdu
from libmodbus_py.protocol.pdu.request import IN_C
from libmodbus_py.protocol.values import TYPES


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


def test_numbers_take_as_many_registers_as_their_bits_say() -> None:
    found = {name: kind.registers for name, kind in TYPES.items() if name[-2:].isdigit()}
    assert found == {name: int(name[-2:]) // 16 for name in found}


def test_floats_are_as_large_as_their_format() -> None:
    assert TYPES["float16"].limits == (-65504.0, 65504.0)
    assert TYPES["float32"].limits == (-3.4028234663852886e38, 3.4028234663852886e38)
    assert TYPES["float64"].limits == (-1.7976931348623157e308, 1.7976931348623157e308)
