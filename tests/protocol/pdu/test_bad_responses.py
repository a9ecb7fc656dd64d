"""What a client must make of bad responses."""

from typing import Any

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol import errors
from tests.protocol.pdu.examples import UNJUDGED, request_of
from tests.support.cases import each_case
from tests.support.vectors import RESPONSES

# Requests, and the responses of the worked examples, of which every byte is checked.
ANSWERED: list[tuple[pdu.Request[Any], bytes]] = [
    (request_of(item), item.pdu) for item in RESPONSES if item.pdu[:2] != b"\x2b\x0d"
]
ALL = ANSWERED + [(request, request.encode_response(b"\3\4\5")) for request in UNJUDGED]

every_request = each_case("request_", [request for request, _ in ALL])


class TestBadResponses:
    @each_case(("request_", "good"), ANSWERED)
    def test_truncated_responses_are_invalid_and_shown_in_the_error(self, request_, good) -> None:
        for end in range(len(good)):
            with pytest.raises(errors.InvalidResponse) as caught:
                request_.decode_response(good[:end])
            assert errors.in_hex(good[:end]) in str(caught.value)

    @each_case(("request_", "good"), [item for item in ANSWERED if not item[0].may_be_broadcast])
    def test_prolonged_responses_are_invalid(self, request_: pdu.Request[Any], good: bytes) -> None:
        with pytest.raises(errors.InvalidResponse):
            request_.decode_response(good + b"\0")

    @each_case(("request_", "good"), [answer for answer in ANSWERED if answer[0].may_be_broadcast])
    def test_bytes_behind_an_echo_are_ignored(self, request_, good) -> None:
        """IndustrialShields/arduino-Tools40#7: a stray byte behind the echo is counted."""
        request_.decode_response(good + b"\6")

    @each_case(("request_", "good"), ALL)
    def test_another_function_is_invalid_and_the_error_names_the_request(self, request_, good):
        for other in {0, *pdu.REQUESTS, 0x7F} - {request_.function}:
            with pytest.raises(errors.InvalidResponse) as caught:
                request_.decode_response(bytes([other]) + good[1:])
            assert str(request_) in str(caught.value)
            assert caught.value.function == request_.function

    @every_request
    def test_a_refusal_of_another_function_is_invalid(self, request_: pdu.Request[Any]) -> None:
        for other in {*pdu.REQUESTS, 0, 0x7F} - {request_.function}:
            with pytest.raises(errors.InvalidResponse):
                request_.decode_response(bytes([other | 0x80, 2]))

    @every_request
    def test_a_refusal_of_another_length_is_invalid(self, request_: pdu.Request[Any]) -> None:
        for tail in (b"", b"\2\0", b"\2\0\0\0"):
            with pytest.raises(errors.InvalidResponse):
                request_.decode_response(bytes([request_.function | 0x80]) + tail)

    def test_a_refusal_has_its_code(self) -> None:
        kinds = {
            1: errors.IllegalFunction,
            2: errors.IllegalDataAddress,
            3: errors.IllegalDataValue,
            4: errors.ServerDeviceFailure,
            5: errors.Acknowledge,
            6: errors.ServerDeviceBusy,
            7: errors.NegativeAcknowledge,
            8: errors.MemoryParityError,
            10: errors.GatewayPathUnavailable,
            11: errors.GatewayTargetFailedToRespond,
        }
        for code in range(256):
            with pytest.raises(errors.ExceptionResponse) as caught:
                pdu.ReadCoils(0, 1).decode_response(bytes([0x81, code]))
            assert type(caught.value) is kinds.get(code, errors.ExceptionResponse)
            assert caught.value.code == code
            assert f"exception {code})" in str(caught.value)

    @each_case(
        ("request_", "response"),
        [
            (pdu.ReadCoils(0, 10), b"\1\1\1"),  # bytes for 8
            (pdu.ReadCoils(0, 10), b"\1\3\1\1\1"),  # bytes for 24
            (pdu.ReadCoils(0, 8), b"\1\0"),
            (pdu.ReadHoldingRegisters(0, 2), b"\3\2\0\1"),
            (pdu.ReadHoldingRegisters(0, 2), b"\3\6" + bytes(6)),
            (pdu.ReadHoldingRegisters(0, 2), b"\3\3" + bytes(3)),
            (pdu.ReadHoldingRegisters(0, 2), b"\3\0"),
            (pdu.ReadWriteRegisters(0, 2, 0, [1]), b"\x17\2\0\1"),
            (pdu.ReadFileRecords([(1, 0, 1)]), b"\x14\0"),
            (pdu.ReadFileRecords([(1, 0, 1)]), b"\x14\4\3\5\0\1"),  # reference type
            (pdu.ReadFileRecords([(1, 0, 1)]), b"\x14\4\4\6\0\1"),  # length of the piece
            (pdu.ReadFileRecords([(1, 0, 1)]), b"\x14\6\5\6\0\1\0\1"),  # one register more
            (pdu.ReadFileRecords([(1, 0, 1)]), b"\x14\x08" + b"\3\6\0\1" * 2),  # one piece more
            (pdu.ReadFileRecords([(1, 0, 1)] * 2), b"\x14\4\3\6\0\1"),  # one piece less
            (pdu.ReadFileRecords([(1, 0, 1), (1, 0, 2)]), b"\x14\x0a\5\6\0\1\0\2\3\6\0\1"),  # order
            (pdu.Diagnostics(0, b"\1\2"), b"\x08\0\0\1\2\3\4"),
            (pdu.Diagnostics(0, b"\1\2\3\4"), b"\x08\0\0\1\2"),
            (pdu.Diagnostics(0, b"\1\2"), b"\x08\0\1\1\2"),  # another sub-function
            (pdu.Diagnostics(11), b"\x08\0\x0c\0\0"),
            (pdu.Diagnostics(11), b"\x08\0\0\0\0"),
            (pdu.ReadCommEventLog(), b"\x0c\0"),
            (pdu.ReadCommEventLog(), b"\x0c\5" + bytes(5)),
            (pdu.ReadCommEventLog(), b"\x0c\x47" + bytes(71)),  # 65 events
            (pdu.ReportServerId(), b"\x11\0"),
            (pdu.ReportServerId(), b"\x11\1\1"),
            (pdu.ReadFifoQueue(1), b"\x18\0\0"),
            (pdu.ReadFifoQueue(1), b"\x18\0\1\0"),
            (pdu.ReadFifoQueue(1), b"\x18\0\4\0\0\0\7"),  # count too small
            (pdu.ReadFifoQueue(1), b"\x18\0\2\0\1"),  # count too large
            (pdu.ReadFifoQueue(1), b"\x18\0\2\0\1\0\7"),  # byte count too small
            (pdu.ReadFifoQueue(1), b"\x18\0\6\0\1\0\7"),  # byte count too large
            (pdu.ReadFifoQueue(1), b"\x18\0\5\0\1\0\7\0"),  # odd
            (pdu.ReadFifoQueue(1), b"\x18\2\0\0\0"),
            (pdu.ReadFifoQueue(1), b"\x18\0\4\1\1\0\7"),  # the low byte alone would fit
            (pdu.ReadFifoQueue(1), b"\x18\0\x42\0\x20" + bytes(64)),  # 32 registers
            (pdu.ReadDeviceIdentification(1), b"\x2b\x0d\1\1\0\0\0"),  # another MEI type
            (pdu.ReadDeviceIdentification(1), b"\x2b\x0e\2\1\0\0\0"),  # another code
            (pdu.ReadDeviceIdentification(1), b"\x2b\x0e\1\1\0\0\1"),  # an object is missing
            (pdu.ReadDeviceIdentification(1), b"\x2b\x0e\1\1\0\0\1\0\2a"),
            (pdu.ReadDeviceIdentification(1), b"\x2b\x0e\1\1\0\0\0\0\1a"),  # an object too many
            (pdu.ReadDeviceIdentification(1), b"\x2b\x0e\1\1\0\0\2\0\1a"),
            (pdu.EncapsulatedTransport(13, b""), b"\x2b\x0e\1\1\0\0\0"),
            (pdu.EncapsulatedTransport(13, b""), b"\x2b"),
        ],
    )
    def test_byte_counts_that_do_not_fit_the_request_are_invalid(self, request_, response) -> None:
        with pytest.raises(errors.InvalidResponse):
            request_.decode_response(response)

    @each_case(("request_", "good"), [answer for answer in ANSWERED if answer[0].may_be_broadcast])
    def test_a_wrong_byte_in_an_echo_is_invalid(self, request_: pdu.Request[Any], good: bytes):
        for at in range(1, len(good)):
            echo = bytearray(good)
            echo[at] ^= 1
            with pytest.raises(errors.InvalidResponse):
                request_.decode_response(bytes(echo))

    def test_padding_bits_of_coils_are_ignored(self) -> None:
        assert pdu.ReadCoils(0, 3).decode_response(b"\1\1\xfd") == [True, False, True]

    def test_padding_bits_are_sent_as_0(self) -> None:
        assert pdu.ReadCoils(0, 3).encode_response([True] * 3) == b"\1\1\7"
        assert pdu.WriteCoils(0, [True] * 9).encode()[-2:] == b"\xff\1"

    def test_a_client_accepts_longer_file_responses_than_a_server_may_send(self) -> None:
        """The table of section 6.14 ends at 245 bytes, the PDU at 251."""
        request = pdu.ReadFileRecords([(1, 0, 124)])
        response = request.encode_response([range(124)])
        assert len(response) == 252
        assert request.decode_response(response) == [list(range(124))]
