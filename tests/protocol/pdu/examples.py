"""One request of each function, and what examples say of them."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from libmodbus_py import pdu
from tests.support.vectors import REQUESTS, FrameVector

Fields = dict[str, Any]


def _read(kind: type[pdu.Request[Any]]) -> Callable[[Fields], pdu.Request[Any]]:
    return lambda fields: kind(fields["address"], fields["quantity"])  # type: ignore[call-arg]


def _encapsulated(fields: Fields) -> pdu.Request[Any]:
    if fields["mei"] == 14:
        return pdu.ReadDeviceIdentification(fields["read_code"], fields["object_id"])
    return pdu.EncapsulatedTransport(fields["mei"], bytes.fromhex(fields["data"]))


# Function -> the request that an example's fields describe.
FROM_FIELDS: dict[int, Callable[[Fields], pdu.Request[Any]]] = {
    1: _read(pdu.ReadCoils),
    2: _read(pdu.ReadDiscreteInputs),
    3: _read(pdu.ReadHoldingRegisters),
    4: _read(pdu.ReadInputRegisters),
    5: lambda fields: pdu.WriteCoil(fields["address"], fields["value"] == "ON"),
    6: lambda fields: pdu.WriteRegister(fields["address"], fields["value"]),
    7: lambda fields: pdu.ReadExceptionStatus(),
    8: lambda fields: pdu.Diagnostics(fields["sub_function"], bytes.fromhex(fields["data"])),
    11: lambda fields: pdu.ReadCommEventCounter(),
    12: lambda fields: pdu.ReadCommEventLog(),
    15: lambda fields: pdu.WriteCoils(fields["address"], fields["values"]),
    16: lambda fields: pdu.WriteRegisters(fields["address"], fields["values"]),
    17: lambda fields: pdu.ReportServerId(),
    20: lambda fields: pdu.ReadFileRecords(
        [(sub["file"], sub["record"], sub["length"]) for sub in fields["sub_requests"]]
    ),
    21: lambda fields: pdu.WriteFileRecords(
        [(sub["file"], sub["record"], sub["values"]) for sub in fields["sub_requests"]]
    ),
    22: lambda fields: pdu.MaskWriteRegister(
        fields["address"], fields["and_mask"], fields["or_mask"]
    ),
    23: lambda fields: pdu.ReadWriteRegisters(
        fields["read_address"], fields["read_quantity"], fields["write_address"], fields["values"]
    ),
    24: lambda fields: pdu.ReadFifoQueue(fields["address"]),
    43: _encapsulated,
}


def request_of(response: FrameVector) -> pdu.Request[Any]:
    """The request that a response answers; one that fits where the example has none."""
    for vector in REQUESTS:
        if vector.id == response.request:
            return FROM_FIELDS[vector.function](vector.fields)
    return pdu.ReadHoldingRegisters(0, len(response.fields.get("values", [0])))


def tells_its_length(body: bytes) -> bool:
    """Return query data carries what it likes, and so does CANopen; all others tell."""
    return body[:3] != b"\x08\0\0" and body[:2] != b"\x2b\x0d"


def words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


EXAMPLES = [FROM_FIELDS[request.function](request.fields) for request in REQUESTS]
"""The requests of the worked examples, at least one of each function."""

# These take whatever follows the code, or the MEI type.
UNJUDGED: list[pdu.Request[bytes]] = [
    pdu.EncapsulatedTransport(13, b"\1\2"),
    pdu.RawRequest(65, b"\1\2"),
    pdu.RawRequest(3, b"\0\0\0\1"),
]


@dataclass(frozen=True, slots=True)
class Doubled(pdu.Request[list[int]]):
    """A request of some registers, an answer with twice as many."""

    values: tuple[int, ...]

    function: ClassVar[int] = 0x41
    request_length = pdu.counted(2, at=1)
    response_length = pdu.counted(2, at=1)

    def encode(self) -> bytes:
        return bytes([self.function, 2 * len(self.values)]) + words(*self.values)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        if pdu[1] % 2:
            raise ValueError("an odd byte count")
        return cls(struct.unpack(f">{pdu[1] // 2}H", pdu[2:]))

    def encode_response(self, result: list[int]) -> bytes:
        return bytes([self.function, 2 * len(result)]) + words(*result)

    def _decode_response(self, pdu: bytes) -> list[int]:
        return list(struct.unpack(f">{pdu[1] // 2}H", pdu[2:]))
