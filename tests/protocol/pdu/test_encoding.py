"""
Results that a server encodes: what they must be, and how large.
"""

from typing import Any

import pytest

from libmodbus_py import pdu
from tests.support.cases import each_case


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
    def test_result_must_be_what_was_asked_for(
        self, request_: pdu.Request[Any], result: Any, error: type[Exception]
    ) -> None:
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
    def test_results_that_no_message_can_carry_are_value_errors(
        self, request_: pdu.Request[Any], result: Any
    ) -> None:
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

    def test_empty_queue_is_a_queue(self) -> None:
        assert pdu.ReadFifoQueue(0).encode_response([]) == b"\x18\0\2\0\0"
        assert pdu.ReadFifoQueue(0).decode_response(b"\x18\0\2\0\0") == []
