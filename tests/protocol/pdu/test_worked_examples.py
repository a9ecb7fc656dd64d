"""The worked examples of the specification, encoded and decoded."""

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
    def test_each_function_has_a_worked_example(self) -> None:
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
                FROM_FIELDS[example.function](example.fields)
                for example in REQUESTS
                if example.id == vector.request
            ),
            pdu.ReadHoldingRegisters(0, 1),
        )
        with pytest.raises(kinds[vector.fields["exception"]]) as caught:
            request.decode_response(vector.pdu)
        assert caught.value.code == vector.fields["exception"]
        assert caught.value.function == vector.function
        assert str(request) in str(caught.value)


class TestEncodeResponse:
    @each_case(
        ("request_", "result", "error"),
        [
            (pdu.ReadCoils(0, 2), [True], ValueError),
            (pdu.ReadCoils(0, 2), [True] * 3, ValueError),
            (pdu.ReadCoils(0, 2), [True, 2], ValueError),
            (pdu.ReadCoils(0, 2), "10", TypeError),
            (pdu.ReadHoldingRegisters(0, 2), [], ValueError),
            (pdu.ReadHoldingRegisters(0, 2), [1], ValueError),
            (pdu.ReadHoldingRegisters(0, 2), [1, 2, 3], ValueError),
            (pdu.ReadHoldingRegisters(0, 2), [1, 65536], ValueError),
            (pdu.ReadHoldingRegisters(0, 2), [1, -1], ValueError),
            (pdu.ReadHoldingRegisters(0, 2), [1, "2"], TypeError),
            (pdu.ReadInputRegisters(0, 2), None, TypeError),
            (pdu.ReadWriteRegisters(0, 2, 0, [1]), [1], ValueError),
            (pdu.ReadFileRecords([(1, 0, 2)]), [], ValueError),
            (pdu.ReadFileRecords([(1, 0, 2)]), [[1]], ValueError),
            (pdu.ReadFileRecords([(1, 0, 2)]), [[1, 2, 3]], ValueError),
            (pdu.ReadFileRecords([(1, 0, 2)]), [[1, 2], [3]], ValueError),
            (pdu.ReadExceptionStatus(), 256, ValueError),
            (pdu.ReadExceptionStatus(), -1, ValueError),
            (pdu.ReadExceptionStatus(), "1", TypeError),
            (pdu.ReadFifoQueue(0), [1] * 32, ValueError),
            (pdu.ReadFifoQueue(0), [65536], ValueError),
            (pdu.ReadFifoQueue(0), [-1], ValueError),
            (pdu.ReportServerId(), pdu.ServerId(b"", True), ValueError),
            (pdu.ReportServerId(), pdu.ServerId(bytes(250), True, b"a"), ValueError),
        ],
    )
    def test_a_result_must_match_the_request(self, request_, result, error) -> None:
        with pytest.raises(error, match="result"):
            request_.encode_response(result)

    @each_case(
        ("request_", "result"),
        [
            (pdu.Diagnostics(0, b"\1\2"), b""),
            (pdu.Diagnostics(0, b"\1\2"), b"\1"),
            (pdu.Diagnostics(11), b"\0\0\0"),
            (pdu.Diagnostics(11), b"\0\0\0\0"),
            (pdu.ReadCommEventCounter(), pdu.CommEventCounter(-1, 0)),
            (pdu.ReadCommEventCounter(), pdu.CommEventCounter(0, 65536)),
            (pdu.ReadCommEventLog(), pdu.CommEventLog(0, 65536, 0, b"")),
            (pdu.ReadCommEventLog(), pdu.CommEventLog(0, 0, -1, b"")),
            (pdu.ReadCommEventLog(), pdu.CommEventLog(0, 0, 0, bytes(65))),
            (pdu.ReadDeviceIdentification(1), pdu.IdentificationPage(256, None, {})),
            (pdu.ReadDeviceIdentification(1), pdu.IdentificationPage(1, 256, {})),
            (pdu.ReadDeviceIdentification(4, 5), pdu.IdentificationPage(0x81, None, {})),
            (pdu.ReadDeviceIdentification(4, 5), pdu.IdentificationPage(0x81, None, {4: b""})),
            (pdu.ReadDeviceIdentification(1), pdu.IdentificationPage(1, None, {256: b""})),
            (pdu.ReadDeviceIdentification(1), pdu.IdentificationPage(1, None, {0: bytes(245)})),
            (
                pdu.ReadDeviceIdentification(1),
                pdu.IdentificationPage(1, None, {0: bytes(243), 1: b""}),
            ),
            (pdu.EncapsulatedTransport(13, b""), bytes(252)),
            (pdu.RawRequest(65), bytes(253)),
        ],
    )
    def test_results_that_no_message_can_carry_are_value_errors(self, request_, result) -> None:
        with pytest.raises(ValueError, match=r"."):
            request_.encode_response(result)

    def test_largest_results_fill_the_message(self) -> None:
        for request, result, size in (
            (pdu.ReadFifoQueue(0), range(31), 67),
            (pdu.ReadCommEventLog(), pdu.CommEventLog(0, 0, 0, bytes(64)), 72),
            (pdu.ReportServerId(), pdu.ServerId(b"\1", False, bytes(249)), 253),
            (
                pdu.ReadDeviceIdentification(1),
                pdu.IdentificationPage(1, None, {0: bytes(244)}),
                253,
            ),
            (pdu.EncapsulatedTransport(13, b""), bytes(251), 253),
            (pdu.RawRequest(65), bytes(252), 253),
        ):
            assert len(request.encode_response(result)) == size

    def test_an_empty_queue_is_a_valid_result(self) -> None:
        assert pdu.ReadFifoQueue(0).encode_response([]) == b"\x18\0\2\0\0"
        assert pdu.ReadFifoQueue(0).decode_response(b"\x18\0\2\0\0") == []
