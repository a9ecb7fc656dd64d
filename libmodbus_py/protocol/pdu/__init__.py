"""
The function codes: one frozen dataclass for each, with both ends of it.

A request object encodes itself (client), is decoded from bytes (server),
encodes its response (server) and decodes it (client). Only bytes and values:
no unit, no framing, no I/O.

Every request class names its function code and two length rules, which say
how long a request or response PDU is once its first bytes are known; a framer
without end marks (RTU) lives from them. A further function code is one class
and one row in `REQUESTS`; your own is registered (`register`).

Its files:

    reads           functions 1-4
    writes          5, 6, 15, 16, 22 and 23
    serial          7, 8, 11, 12 and 17
    files           20, 21 and 24: file records and queues
    interface       43
    raw             any, sent as it is
    function_codes  REQUESTS, and what asks it
    request         what all of them have in common
    fields          what they are made of

What is public comes from there when it is first asked for: a client that reads registers
needs two of them.

Layouts, limits and the order of checks: MODBUS Application Protocol V1.1b3,
section 6. Addresses are 0-based.
"""

from __future__ import annotations

from ...late import late

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .fields import MAX_PDU, LengthRule, counted, fixed, unknown_length
    from .files import RECORDS_PER_FILE, ReadFifoQueue, ReadFileRecords, WriteFileRecords
    from .function_codes import (
        REQUESTS,
        decode_request,
        register,
        request_length,
        response_length,
    )
    from .interface import (
        DeviceIdentification,
        EncapsulatedTransport,
        IdentificationPage,
        ReadDeviceIdentification,
    )
    from .raw import RawRequest
    from .reads import ReadCoils, ReadDiscreteInputs, ReadHoldingRegisters, ReadInputRegisters
    from .request import Request
    from .serial import (
        CommEventCounter,
        CommEventLog,
        Diagnostics,
        ReadCommEventCounter,
        ReadCommEventLog,
        ReadExceptionStatus,
        ReportServerId,
        ServerId,
        SubFunction,
    )
    from .writes import (
        MaskWriteRegister,
        ReadWriteRegisters,
        WriteCoil,
        WriteCoils,
        WriteRegister,
        WriteRegisters,
    )

# fmt: off
__all__ = [
    "MAX_PDU", "RECORDS_PER_FILE", "REQUESTS", "CommEventCounter", "CommEventLog",
    "DeviceIdentification", "Diagnostics", "EncapsulatedTransport", "IdentificationPage",
    "LengthRule", "MaskWriteRegister", "RawRequest", "ReadCoils", "ReadCommEventCounter",
    "ReadCommEventLog", "ReadDeviceIdentification", "ReadDiscreteInputs", "ReadExceptionStatus",
    "ReadFifoQueue", "ReadFileRecords", "ReadHoldingRegisters", "ReadInputRegisters",
    "ReadWriteRegisters", "ReportServerId", "Request", "ServerId", "SubFunction", "WriteCoil",
    "WriteCoils", "WriteFileRecords", "WriteRegister", "WriteRegisters", "counted",
    "decode_request", "fixed", "register", "request_length", "response_length", "unknown_length",
]

_HOMES = {
    "fields": ("MAX_PDU", "LengthRule", "counted", "fixed", "unknown_length"),
    "files": ("RECORDS_PER_FILE", "ReadFifoQueue", "ReadFileRecords", "WriteFileRecords"),
    "function_codes": (
        "REQUESTS", "decode_request", "register", "request_length", "response_length",
    ),
    "interface": (
        "DeviceIdentification", "EncapsulatedTransport", "IdentificationPage",
        "ReadDeviceIdentification",
    ),
    "raw": ("RawRequest",),
    "reads": ("ReadCoils", "ReadDiscreteInputs", "ReadHoldingRegisters", "ReadInputRegisters"),
    "request": ("Request",),
    "serial": (
        "CommEventCounter", "CommEventLog", "Diagnostics", "ReadCommEventCounter",
        "ReadCommEventLog", "ReadExceptionStatus", "ReportServerId", "ServerId", "SubFunction",
    ),
    "writes": (
        "MaskWriteRegister", "ReadWriteRegisters", "WriteCoil", "WriteCoils", "WriteRegister",
        "WriteRegisters",
    ),
}
# fmt: on

if not TYPE_CHECKING:  # checkers would take any name for one of ours
    __getattr__ = late(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
