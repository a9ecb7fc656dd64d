"""
The worked examples of the specification, both ways.
"""

from typing import Any

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import IllegalDataAddress, IllegalFunction
from tests.protocol.pdu.examples import FROM_FIELDS, request_of
from tests.support.cases import each_case
from tests.support.vectors import EXCEPTIONS, REQUESTS, RESPONSES, FrameVector, rows


def _result_of(response: FrameVector) -> Any:
    fields = response.fields
    if response.function in (1, 2):
        return [value == 1 for value in fields["values"]]
    if response.function in (3, 4, 23):
        return fields["values"]
    match response.function:
        case 7:
            return sum(bit << at for at, bit in enumerate(fields["outputs"]))
        case 8:
            return bytes.fromhex(fields["data"])
        case 11:
            return pdu.CommEventCounter(fields["status"], fields["event_count"])
        case 12:
            counters = (fields[name] for name in ("status", "event_count", "message_count"))
            return pdu.CommEventLog(*counters, bytes(fields["events"]))
        case 17:
            texts = (bytes.fromhex(fields[name]) for name in ("identifier", "additional"))
            identifier, additional = texts
            return pdu.ServerId(identifier, fields["running"], additional)
        case 20:
            return [sub["values"] for sub in fields["sub_responses"]]
        case 24:
            return fields["values"]
        case 43 if fields["mei"] == 13:
            return bytes.fromhex(fields["data"])
        case 43:
            objects = {int(number): text.encode() for number, text in fields["objects"].items()}
            following = fields["next_object_id"] if fields["more_follows"] else None
            return pdu.IdentificationPage(fields["conformity"], following, objects)
    return None


class TestWorkedExamples:
    def test_there_is_one_of_every_function(self) -> None:
        for vectors in (REQUESTS, RESPONSES):
            assert {vector.function for vector in vectors} == set(FROM_FIELDS) == set(pdu.REQUESTS)

    @each_case("vector", rows(REQUESTS))
    def test_request_encodes_to_the_bytes(self, vector: FrameVector) -> None:
        assert FROM_FIELDS[vector.function](vector.fields).encode() == vector.pdu

    @each_case("vector", rows(REQUESTS))
    def test_request_decodes_from_the_bytes(self, vector: FrameVector) -> None:
        assert pdu.decode_request(vector.pdu) == FROM_FIELDS[vector.function](vector.fields)

    @each_case("vector", rows(RESPONSES))
    def test_response_encodes_to_the_bytes(self, vector: FrameVector) -> None:
        assert request_of(vector).encode_response(_result_of(vector)) == vector.pdu

    @each_case("vector", rows(RESPONSES))
    def test_response_decodes_to_the_values(self, vector: FrameVector) -> None:
        result = request_of(vector).decode_response(vector.pdu)
        assert result == _result_of(vector)
        assert type(result) is type(_result_of(vector))
        if vector.function in (1, 2):
            assert set(map(type, result)) == {bool}

    @pytest.mark.parametrize("vector", rows(EXCEPTIONS))
    def test_exception_raises_its_class_with_code_and_request(self, vector: FrameVector) -> None:
        kinds = {1: IllegalFunction, 2: IllegalDataAddress}
        request = next(
            (
                FROM_FIELDS[asked.function](asked.fields)
                for asked in REQUESTS
                if asked.id == vector.request
            ),
            pdu.ReadHoldingRegisters(0, 1),
        )
        with pytest.raises(kinds[vector.fields["exception"]]) as caught:
            request.decode_response(vector.pdu)
        assert caught.value.code == vector.fields["exception"]
        assert caught.value.function == vector.function
        assert str(request) in str(caught.value)
