"""Functions of serial lines: 7, 8, 11, 12 and 17. Many TCP devices answer them, too."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, NamedTuple, Self

from ..checks import integer
from ..scan import lib
from .request import (
    MAX_PDU,
    LengthRule,
    Request,
    Result,
    WordRequest,
    checked_data,
    checked_register,
    counted,
    fixed,
    in_c,
    store,
)


@dataclass(frozen=True, slots=True)
class _Bare(WordRequest[Result]):
    """A read whose request is only the function code."""

    repeatable = True
    changes = False
    request_length: ClassVar[LengthRule] = fixed(1)


class ReadExceptionStatus(_Bare[int]):
    """Function 7, section 6.7: read eight outputs of the device as a byte, the lowest in bit 0."""

    __slots__ = ()
    function: ClassVar[int] = 0x07
    response_length: ClassVar[LengthRule] = fixed(2)

    def encode_response(self, result: int) -> bytes:
        return bytes([self.function, integer("result", result, 0, 0xFF)])

    def _decode_response(self, pdu: bytes) -> int:
        return pdu[1]


class SubFunction(IntEnum):
    """Sub-functions of function 8 (section 6.8)."""

    RETURN_QUERY_DATA = 0x00
    RESTART_COMMUNICATIONS = 0x01
    RETURN_DIAGNOSTIC_REGISTER = 0x02
    CHANGE_ASCII_DELIMITER = 0x03
    FORCE_LISTEN_ONLY = 0x04
    CLEAR_COUNTERS = 0x0A
    BUS_MESSAGE_COUNT = 0x0B
    BUS_COMMUNICATION_ERROR_COUNT = 0x0C
    BUS_EXCEPTION_ERROR_COUNT = 0x0D
    SERVER_MESSAGE_COUNT = 0x0E
    SERVER_NO_RESPONSE_COUNT = 0x0F
    SERVER_NAK_COUNT = 0x10
    SERVER_BUSY_COUNT = 0x11
    BUS_CHARACTER_OVERRUN_COUNT = 0x12
    CLEAR_OVERRUN = 0x14


def _diagnostics_length(head: bytes) -> int | None:
    if len(head) < 3:
        return None
    return 5 if head[1:3] != b"\0\0" else 0


# Sub-functions that change how a device answers, or clear what it has counted.
CHANGING = (
    SubFunction.RESTART_COMMUNICATIONS,
    SubFunction.CHANGE_ASCII_DELIMITER,
    SubFunction.FORCE_LISTEN_ONLY,
    SubFunction.CLEAR_COUNTERS,
    SubFunction.CLEAR_OVERRUN,
)


@dataclass(frozen=True, slots=True)
class Diagnostics(Request[bytes]):
    """
    Function 8, section 6.8: run a diagnostic sub-function with its data.

    `sub_function` is 0..65535 (`SubFunction` names those of the specification);
    `data` has 2 bytes; for sub-function 0 an even number of them, 2..250. Sub-function 4 gets no
    response.
    """

    sub_function: int
    data: bytes = b"\0\0"

    function: ClassVar[int] = 0x08
    longest: ClassVar[int] = 250

    def __post_init__(self) -> None:
        sub_function = integer("sub_function", self.sub_function, 0, 0xFFFF)
        checked_data("data", self.data, self.longest)
        longest = self.longest if sub_function == SubFunction.RETURN_QUERY_DATA else 2
        if not 2 <= len(self.data) <= longest or len(self.data) % 2:
            sizes = "2 bytes" if longest == 2 else f"2, 4..{longest} bytes"
            raise ValueError(f"data must be {sizes}, not {len(self.data)}")
        store(self, sub_function=sub_function)

    @property
    def expects_response(self) -> bool:  # type: ignore[override]
        return self.sub_function != SubFunction.FORCE_LISTEN_ONLY

    @property
    def changes(self) -> bool:  # type: ignore[override]
        return self.sub_function in CHANGING

    request_length: ClassVar[LengthRule] = in_c(_diagnostics_length, lib.DIAGNOSTICS)
    response_length: ClassVar[LengthRule] = request_length

    def encode(self) -> bytes:
        return struct.pack(">BH", self.function, self.sub_function) + self.data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(int.from_bytes(pdu[1:3], "big"), pdu[3:])

    def encode_response(self, result: bytes) -> bytes:
        if len(checked_data("result", result, self.longest)) != len(self.data):
            raise ValueError(f"result must be {len(self.data)} bytes, not {len(result)}")
        return self.encode()[:3] + result

    def _decode_response(self, pdu: bytes) -> bytes:
        if pdu[:3] != self.encode()[:3] or len(pdu) != 3 + len(self.data):
            raise self._invalid(f"{pdu[:5].hex(' ')}")
        return pdu[3:]


class CommEventCounter(NamedTuple):
    """
    The result of function 11.

    Attributes:
        status: FFFFh while an earlier program command is still running, otherwise 0.
        event_count: the number of completed messages, 0..65535.
    """

    status: int
    event_count: int


class ReadCommEventCounter(_Bare[CommEventCounter]):
    """Function 11, section 6.9: read the status word and the event counter."""

    __slots__ = ()
    function: ClassVar[int] = 0x0B
    response_length: ClassVar[LengthRule] = fixed(5)

    def encode_response(self, result: CommEventCounter) -> bytes:
        status, event_count = (checked_register("result", value) for value in result)
        return struct.pack(">BHH", self.function, status, event_count)

    def _decode_response(self, pdu: bytes) -> CommEventCounter:
        return CommEventCounter(*struct.unpack(">HH", pdu[1:]))


class CommEventLog(NamedTuple):
    """
    The result of function 12.

    Attributes:
        status, event_count: as in `CommEventCounter`.
        message_count: the number of valid frames on the line, 0..65535.
        events: up to 64 event bytes, newest first (section 6.10).
    """

    status: int
    event_count: int
    message_count: int
    events: bytes


class ReadCommEventLog(_Bare[CommEventLog]):
    """Function 12, section 6.10: read the counters and the last events."""

    __slots__ = ()
    function: ClassVar[int] = 0x0C
    response_length: ClassVar[LengthRule] = counted(2, at=1)
    max_events: ClassVar[int] = 64

    def encode_response(self, result: CommEventLog) -> bytes:
        events = checked_data("events", result.events, self.max_events)
        words = [checked_register("result", value) for value in result[:3]]
        return struct.pack(">BBHHH", self.function, 6 + len(events), *words) + events

    def _decode_response(self, pdu: bytes) -> CommEventLog:
        if not 8 <= len(pdu) <= 8 + self.max_events:
            raise self._invalid(f"{pdu[1]} bytes of data")
        status, event_count, message_count = struct.unpack(">HHH", pdu[2:8])
        return CommEventLog(status, event_count, message_count, pdu[8:])


class ServerId(NamedTuple):
    """
    The result of function 17.

    The response does not contain the length of the identifier, which is usually one byte; use
    `split` for devices with a longer one.

    Attributes:
        identifier: the bytes that identify the kind of device.
        running: the run indicator behind the identifier (section 6.13): True for ON (FFh), False
            for OFF (00h), None if the device sent another byte there, with which `additional`
            then begins.
        additional: the remaining bytes.
    """

    identifier: bytes
    running: bool | None
    additional: bytes = b""

    @property
    def data(self) -> bytes:
        """All bytes, as on the wire."""
        indicator = b"" if self.running is None else b"\xff" if self.running else b"\0"
        return self.identifier + indicator + self.additional

    @classmethod
    def split(cls, data: bytes, length: int = 1) -> Self:
        """
        Split `data` after an identifier of `length` bytes.

        Raises:
            ValueError: there are no bytes after the identifier.
        """
        if not 0 <= length < len(data):
            raise ValueError(f"length must be in 0..{len(data) - 1}, not {length}")
        running = {0x00: False, 0xFF: True}.get(data[length])
        return cls(data[:length], running, data[length + (running is not None) :])


class ReportServerId(_Bare[ServerId]):
    """Function 17, section 6.13: read the identifier of the device and its run indicator."""

    __slots__ = ()
    function: ClassVar[int] = 0x11
    response_length: ClassVar[LengthRule] = counted(2, at=1)

    def encode_response(self, result: ServerId) -> bytes:
        data = result.data
        if not 2 <= len(data) <= MAX_PDU - 2:
            raise ValueError(f"result must take 2..{MAX_PDU - 2} bytes, not {len(data)}")
        return bytes([self.function, len(data)]) + data

    def _decode_response(self, pdu: bytes) -> ServerId:
        if len(pdu) < 4:
            raise self._invalid(f"{pdu[1]} bytes of data")
        return ServerId.split(pdu[2:])
