"""
Responses to reads that a gateway passes on again and again.
"""

from __future__ import annotations

import pytest

from libmodbus_py import ExceptionResponse, InvalidResponse
from libmodbus_py.pdu import ReadHoldingRegisters
from libmodbus_py.services.gateway.raw_request import RequestBytes, request_of
from tests.support.cases import each_case

# Requests of the application protocol, sections 6.1 to 6.4, with good responses.
READS = [
    ("01 0013 0013", "01 03 CD6B05", "01 03 000000"),
    ("02 00C4 0016", "02 03 ACDB35", "02 03 FFFF3F"),
    ("03 006B 0003", "03 06 022B00000064", "03 06 FFFFFFFFFFFF"),
    ("04 0008 0001", "04 02 000A", "04 02 0000"),
]


@each_case("request, first, second", READS)
def test_a_response_is_passed_on_as_it_is(request: str, first: str, second: str) -> None:
    asked = request_of(bytes.fromhex(request))
    for response in map(bytes.fromhex, (first, second, first)):
        assert asked.decode_response(response) == response


@each_case("request, first, second", READS)
def test_a_bad_response_is_refused_also_after_a_good_one(
    request: str, first: str, second: str
) -> None:
    asked, good = request_of(bytes.fromhex(request)), bytes.fromhex(first)
    other, fewer = bytes([good[0] ^ 7]), bytes([good[1] - 1])
    bad = [
        b"",
        good[:-1],
        good + b"\0",
        other + good[1:],
        good[:1] + fewer + good[2:],
        good[:1] + fewer + good[2:-1],
        good[:2],
    ]
    for response in bad:
        with pytest.raises(InvalidResponse):
            asked.decode_response(response)
        assert asked.decode_response(good) == good
    with pytest.raises(ExceptionResponse):
        asked.decode_response(bytes([good[0] | 0x80, 2]))


class Judged(ReadHoldingRegisters):
    """A user's class, which refuses values that its device cannot have."""

    function = 0x41

    def _decode_response(self, pdu: bytes) -> list[int]:
        if (values := super()._decode_response(pdu))[0] > 100:
            raise InvalidResponse("more than 100")
        return values


def test_a_class_of_a_user_judges_every_response() -> None:
    asked = RequestBytes(bytes.fromhex("41 0000 0001"), Judged(0, 1))
    good, bad = bytes.fromhex("41 02 0064"), bytes.fromhex("41 02 0065")
    assert asked.decode_response(good) == good
    with pytest.raises(InvalidResponse, match="more than 100"):
        asked.decode_response(bad)


def test_the_echo_of_a_write_must_be_that_of_this_write() -> None:
    asked = request_of(bytes.fromhex("06 0001 0003"))
    assert asked.decode_response(asked.pdu) == asked.pdu
    with pytest.raises(InvalidResponse):
        asked.decode_response(bytes.fromhex("06 0001 0004"))


@each_case(
    "request, changes",
    [
        ("03 006B 0003", False),
        ("06 0001 0003", True),
        ("17 0003 0006 000E 0001 02 00FF", True),
        ("08 0000 A537", False),
        ("08 000A 0000", True),
        ("2B 0D 00", True),
        ("2B 0E 01 00", False),
        ("64 00", True),  # nobody knows what it does
    ],
)
def test_what_may_change_a_device_is_known_before_it_is_sent(request: str, changes: bool) -> None:
    assert request_of(bytes.fromhex(request)).changes is changes
