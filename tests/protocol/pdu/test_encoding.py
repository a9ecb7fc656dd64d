"""
Results that a server encodes: what they must be, and how large.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py.protocol.pdu import (
    CommEventCounter,
    CommEventLog,
    Diagnostics,
    EncapsulatedTransport,
    IdentificationPage,
    RawRequest,
    ReadCoils,
    ReadCommEventCounter,
    ReadCommEventLog,
    ReadDeviceIdentification,
    ReadExceptionStatus,
    ReadFifoQueue,
    ReadFileRecords,
    ReadHoldingRegisters,
    ReadInputRegisters,
    ReadWriteRegisters,
    ReportServerId,
    Request,
    ServerId,
)
from tests.support.cases import each_case


class TestEncodeResponse:
    @each_case(
        ("request_", "result", "error"),
        [
            (ReadCoils(0, 2), [True], ValueError),
            (ReadCoils(0, 2), [True] * 3, ValueError),
            (ReadCoils(0, 2), [True, 2], ValueError),
            (ReadCoils(0, 2), "10", TypeError),
            (ReadHoldingRegisters(0, 2), [], ValueError),
            (ReadHoldingRegisters(0, 2), [1], ValueError),
            (ReadHoldingRegisters(0, 2), [1, 2, 3], ValueError),
            (ReadHoldingRegisters(0, 2), [1, 65536], ValueError),
            (ReadHoldingRegisters(0, 2), [1, -1], ValueError),
            (ReadHoldingRegisters(0, 2), [1, "2"], TypeError),
            (ReadInputRegisters(0, 2), None, TypeError),
            (ReadWriteRegisters(0, 2, 0, [1]), [1], ValueError),
            (ReadFileRecords([(1, 0, 2)]), [], ValueError),
            (ReadFileRecords([(1, 0, 2)]), [[1]], ValueError),
            (ReadFileRecords([(1, 0, 2)]), [[1, 2, 3]], ValueError),
            (ReadFileRecords([(1, 0, 2)]), [[1, 2], [3]], ValueError),
            (ReadExceptionStatus(), 256, ValueError),
            (ReadExceptionStatus(), -1, ValueError),
            (ReadExceptionStatus(), "1", TypeError),
            (ReadFifoQueue(0), [1] * 32, ValueError),
            (ReadFifoQueue(0), [65536], ValueError),
            (ReadFifoQueue(0), [-1], ValueError),
            (ReportServerId(), ServerId(b"", True), ValueError),
            (ReportServerId(), ServerId(bytes(250), True, b"a"), ValueError),
        ],
    )
    def test_result_must_be_what_was_asked_for(
        self, request_: Request[Any], result: Any, error: type[Exception]
    ) -> None:
        with pytest.raises(error, match="result"):
            request_.encode_response(result)

    @each_case(
        ("request_", "result"),
        [
            (Diagnostics(0, b"\1\2"), b""),
            (Diagnostics(0, b"\1\2"), b"\1"),
            (Diagnostics(11), b"\0\0\0"),
            (Diagnostics(11), b"\0\0\0\0"),
            (ReadCommEventCounter(), CommEventCounter(-1, 0)),
            (ReadCommEventCounter(), CommEventCounter(0, 65536)),
            (ReadCommEventLog(), CommEventLog(0, 65536, 0, b"")),
            (ReadCommEventLog(), CommEventLog(0, 0, -1, b"")),
            (ReadCommEventLog(), CommEventLog(0, 0, 0, bytes(65))),
            (ReadDeviceIdentification(1), IdentificationPage(256, None, {})),
            (ReadDeviceIdentification(1), IdentificationPage(1, 256, {})),
            (ReadDeviceIdentification(4, 5), IdentificationPage(0x81, None, {})),
            (ReadDeviceIdentification(4, 5), IdentificationPage(0x81, None, {4: b""})),
            (ReadDeviceIdentification(1), IdentificationPage(1, None, {256: b""})),
            (ReadDeviceIdentification(1), IdentificationPage(1, None, {0: bytes(245)})),
            (ReadDeviceIdentification(1), IdentificationPage(1, None, {0: bytes(243), 1: b""})),
            (EncapsulatedTransport(13, b""), bytes(252)),
            (RawRequest(65), bytes(253)),
        ],
    )
    def test_results_that_no_message_can_carry_are_value_errors(
        self, request_: Request[Any], result: Any
    ) -> None:
        with pytest.raises(ValueError, match=r"."):
            request_.encode_response(result)

    def test_largest_results_fill_the_message(self) -> None:
        for request, result, size in (
            (ReadFifoQueue(0), range(31), 67),
            (ReadCommEventLog(), CommEventLog(0, 0, 0, bytes(64)), 72),
            (ReportServerId(), ServerId(b"\1", False, bytes(249)), 253),
            (ReadDeviceIdentification(1), IdentificationPage(1, None, {0: bytes(244)}), 253),
            (EncapsulatedTransport(13, b""), bytes(251), 253),
            (RawRequest(65), bytes(252), 253),
        ):
            assert len(request.encode_response(result)) == size

    def test_empty_queue_is_a_queue(self) -> None:
        assert ReadFifoQueue(0).encode_response([]) == b"\x18\0\2\0\0"
        assert ReadFifoQueue(0).decode_response(b"\x18\0\2\0\0") == []
