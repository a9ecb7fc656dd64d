"""
Classes of users that read as functions 1 to 4 do, and take other responses.
"""

from __future__ import annotations

import pytest

from libmodbus_py import ExceptionResponse, InvalidResponse, pdu
from tests.support.cases import each_case

# Application protocol, 6.3: three registers.
RESPONSE = bytes.fromhex("03 06 022B00000064")


class Signed(pdu.ReadHoldingRegisters):
    def _decode_response(self, pdu: bytes) -> list[int]:
        return [each - 65536 * (each > 32767) for each in super()._decode_response(pdu)]


class Padded(pdu.ReadHoldingRegisters):
    """Of a device whose responses are all as long as the longest."""

    response_length = pdu.fixed(12)

    def _decode_response(self, pdu: bytes) -> list[int]:
        return super()._decode_response(pdu[: 2 + pdu[1]])


def test_a_class_decodes_what_is_as_long_as_the_specification_says() -> None:
    assert Signed(0, 1).decode_response(bytes.fromhex("03 02 FFFE")) == [-2]
    assert Signed(107, 3).decode_response(RESPONSE) == [555, 0, 100]


def test_a_length_of_its_own_is_the_only_one() -> None:
    assert Padded(107, 3).decode_response(RESPONSE + bytes(4)) == [555, 0, 100]
    with pytest.raises(InvalidResponse):
        Padded(107, 3).decode_response(RESPONSE)


@each_case(
    "response",
    [
        "",
        "03",
        "03 06",
        "03 00",
        "03 04 022B0000",
        "03 06 022B000000",
        "03 06 022B0000006400",
        "03 05 022B000000",
        "04 06 022B00000064",
        "83",
        "83 02 00",
    ],
)
def test_all_else_is_no_response(response: str) -> None:
    with pytest.raises(InvalidResponse):
        pdu.ReadHoldingRegisters(107, 3).decode_response(bytes.fromhex(response))


def test_a_refusal_is_none_either() -> None:
    with pytest.raises(ExceptionResponse) as caught:
        pdu.ReadHoldingRegisters(107, 3).decode_response(bytes.fromhex("83 02"))
    assert caught.value.code == 2
