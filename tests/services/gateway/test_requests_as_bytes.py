"""
Requests that a gateway forwards as they came: which can be, and which answers fit them.
"""

from __future__ import annotations

import pytest

from libmodbus_py import IllegalDataValue, IllegalFunction, InvalidResponse, pdu
from libmodbus_py.services.gateway.raw_request import request_of
from tests.support import vectors

WORKED = [vector.values[0] for vector in vectors.rows(vectors.REQUESTS)]


@pytest.mark.parametrize("code", [0, 0x80, 0x83, 0xFF])
def test_no_function_has_such_a_code(code: int) -> None:
    with pytest.raises(IllegalFunction) as raised:
        request_of(bytes([code, 1, 2]))
    assert raised.value.function == code


@pytest.mark.parametrize("code", [1, 3, 0x41, 0x7F])
def test_each_other_code_may_be_a_function(code: int) -> None:
    body = bytes([code, 0, 0, 0, 1])
    request = request_of(body)
    assert (request.function, request.pdu, request.encode()) == (code, body, body)


def test_a_known_function_has_requests_of_its_length_only() -> None:
    for size in (1, 4, 6):
        with pytest.raises(IllegalDataValue) as raised:
            request_of(b"\3\0\0\0\1\0"[:size])
        assert raised.value.function == 3


READS = (pdu.ReadCoils, pdu.ReadDiscreteInputs, pdu.ReadHoldingRegisters, pdu.ReadInputRegisters)


def test_what_is_a_read_and_what_a_write() -> None:
    for vector in WORKED:
        known = pdu.decode_request(vector.pdu)
        request = request_of(vector.pdu)
        assert request.known == known
        assert request.is_read == isinstance(known, READS)
        assert request.may_be_broadcast == known.may_be_broadcast
        assert request.repeatable == known.repeatable
        assert request.expects_response == known.expects_response
        assert str(request) == str(known)


def test_a_request_of_an_unknown_function_may_do_anything_once() -> None:
    request = request_of(b"\x41\1\2")
    assert request.known is None
    assert (request.is_read, request.may_be_broadcast, request.repeatable) == (False, False, False)
    assert request.expects_response
    assert request.changes
    assert str(request) == "a request of 3 bytes"


def test_the_answer_of_an_unknown_function_begins_with_its_code() -> None:
    request = request_of(b"\x41\1\2")
    for answer in (b"\x41", b"\x41\1\2\3"):
        assert request.decode_response(answer) == answer
    for answer in (b"", b"\x42\1\2", b"\1"):
        with pytest.raises(InvalidResponse):
            request.decode_response(answer)


def test_the_answer_of_a_known_function_must_be_valid() -> None:
    request = request_of(b"\3\0\0\0\1")
    assert request.decode_response(b"\3\2\0\7") == b"\3\2\0\7"
    for answer in (b"", b"\3\4\0\7\0\7", b"\3\2\0", b"\4\2\0\7"):
        with pytest.raises(InvalidResponse):
            request.decode_response(answer)


def test_a_broadcast_is_answered_as_if_one_unit_had() -> None:
    written = request_of(bytes.fromhex("10 0001 0002 04 0007 0008"))
    assert written.response_to_broadcast() == bytes.fromhex("10 0001 0002")
    assert request_of(bytes.fromhex("06 0001 0007")).response_to_broadcast() == (
        bytes.fromhex("06 0001 0007")
    )
