"""
Worked examples, as rows for `pytest.mark.parametrize`.

The bytes in vectors.json come from the examples of MODBUS Application Protocol
V1.1b3, section 6, of the serial line and TCP guides, and of public manuals of
devices. Check bytes were computed again, and what a manual printed wrong stands
corrected; ``computed`` names the forms that the source does not print. The key
``place`` says where in its document an example stands; ``unit_assumed`` that
the document gives the PDU alone. Ids with ``own`` are layouts of the specification
that have no example there, with values of ours.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py.protocol.framing import Frame


@dataclass(frozen=True)
class FrameVector:
    """One message in every form it takes on a line."""

    id: str
    place: str
    kind: str  # "request", "response" or "exception"
    function: int
    unit: int
    pdu: bytes
    rtu: bytes
    ascii: bytes
    tcp: bytes
    transaction: int
    request: str | None  # id of the request that a response answers
    fields: dict[str, Any]

    @property
    def frame(self) -> Frame:
        """As a serial line carries it: without a transaction."""
        return Frame(self.unit, self.pdu)

    @property
    def tcp_frame(self) -> Frame:
        return Frame(self.unit, self.pdu, self.transaction)


@dataclass(frozen=True)
class Checksum:
    id: str
    data: bytes
    crc: int
    crc_on_the_wire: bytes
    lrc: int


@dataclass(frozen=True)
class Reference:
    id: str
    reference: str
    table: str
    address: int


@dataclass(frozen=True)
class ByteOrder:
    """One number as the registers of each order hold it."""

    id: str
    type: str
    order: str
    registers: list[int]
    value: int


_ENTRIES: list[dict[str, Any]] = json.loads(Path(__file__).with_name("vectors.json").read_text())


def _of_kind(*kinds: str) -> list[dict[str, Any]]:
    return [entry for entry in _ENTRIES if entry["kind"] in kinds]


FRAMES = [
    FrameVector(
        id=entry["id"],
        place=entry["place"],
        kind=entry["kind"],
        function=entry["function"],
        unit=entry["unit"],
        pdu=bytes.fromhex(entry["pdu"]),
        rtu=bytes.fromhex(entry["rtu"]),
        ascii=entry["ascii"].encode(),
        tcp=bytes.fromhex(entry["tcp"]),
        transaction=entry["tcp_transaction"],
        request=entry.get("pairs_with"),
        fields=entry["fields"],
    )
    for entry in _of_kind("request", "response", "exception")
]
REQUESTS = [vector for vector in FRAMES if vector.kind == "request"]
RESPONSES = [vector for vector in FRAMES if vector.kind == "response"]
EXCEPTIONS = [vector for vector in FRAMES if vector.kind == "exception"]


def exchanges() -> list[tuple[FrameVector, FrameVector]]:
    """Return request and answer of each example that has both."""
    requests = {vector.id: vector for vector in REQUESTS}
    answers = [*RESPONSES, *EXCEPTIONS]
    return [(requests[answer.request], answer) for answer in answers if answer.request in requests]


CHECKSUMS = [
    Checksum(
        id=entry["id"],
        data=bytes.fromhex(entry["data"]),
        crc=int(entry["crc_value"], 16),
        crc_on_the_wire=bytes.fromhex(entry["crc_wire"]),
        lrc=int(entry["lrc"], 16),
    )
    for entry in _of_kind("checksum")
]

REFERENCES = [
    Reference(
        id=entry["id"],
        reference=entry["fields"]["reference"],
        table=entry["fields"]["table"],
        address=entry["fields"]["pdu_address"],
    )
    for entry in _of_kind("reference")
]

BYTE_ORDERS = [
    ByteOrder(
        id=entry["id"],
        type=entry["type"],
        order=entry["order"],
        registers=[int(register, 16) for register in entry["registers"]],
        value=entry["value"],
    )
    for entry in _of_kind("byteorder")
]


def rows(vectors: list[Any]) -> list[Any]:
    """Wrap vectors for parametrize, with ids such as ``03-s0-fig2-5-req``."""
    return [
        pytest.param(
            vector,
            id=f"{vector.function:02}-{vector.id}"
            if isinstance(vector, FrameVector)
            else vector.id,
        )
        for vector in vectors
    ]
