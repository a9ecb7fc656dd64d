"""What a server must answer to bad requests."""

import struct
from typing import Any

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import (
    ExceptionResponse,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
)
from libmodbus_py.protocol.pdu import WriteCoils, decode_request
from tests.protocol.pdu.examples import words
from tests.support.cases import each_case


def read(function: int, address: int, count: int) -> bytes:
    return bytes([function]) + words(address, count)


def write_many(function: int, address: int, count: int, size: int, data: bytes) -> bytes:
    return bytes([function]) + words(address, count) + bytes([size]) + data


def read_write(at: int, count: int, to: int, write_count: int, size: int, data: bytes) -> bytes:
    return b"\x17" + words(at, count, to, write_count) + bytes([size]) + data


def read_file(*pieces: tuple[int, int, int, int]) -> bytes:
    body = b"".join(struct.pack(">BHHH", *piece) for piece in pieces)
    return bytes([0x14, len(body) & 0xFF]) + body


def write_file(*pieces: tuple[int, int, int, int, int]) -> bytes:
    """Pieces of (type, file, record, length, registers that really follow)."""
    body = b"".join(
        struct.pack(">BHHH", kind, file, record, length) + bytes(2 * present)
        for kind, file, record, length, present in pieces
    )
    return bytes([0x15, len(body) & 0xFF]) + body


BAD_READS: list[Any] = []
for _function, _limit in ((1, 2000), (2, 2000), (3, 125), (4, 125)):
    for _why, _pdu, _error in (
        ("no count", read(_function, 0, 0), IllegalDataValue),
        ("count over the limit", read(_function, 0, _limit + 1), IllegalDataValue),
        ("count 65535", read(_function, 0, 65535), IllegalDataValue),
        ("past the last address", read(_function, 65535, 2), IllegalDataAddress),
        ("far past it", read(_function, 65535, _limit), IllegalDataAddress),
        ("no count at the last address", read(_function, 65535, 0), IllegalDataValue),
        ("count and address", read(_function, 65535, _limit + 1), IllegalDataValue),
        ("only the code", bytes([_function]), IllegalDataValue),
        ("one byte short", read(_function, 0, 1)[:-1], IllegalDataValue),
        ("one byte long", read(_function, 0, 1) + b"\0", IllegalDataValue),
        ("length before address", read(_function, 65535, 2) + b"\0", IllegalDataValue),
    ):
        BAD_READS.append(pytest.param(_pdu, _error, id=f"{_function:02} {_why}"))

BAD_REQUESTS: list[tuple[str, bytes, type[ExceptionResponse]]] = [
    ("05 value 0001", b"\x05\0\0\0\1", IllegalDataValue),
    ("05 value FFFF", b"\x05\0\0\xff\xff", IllegalDataValue),
    ("05 value 00FF", b"\x05\0\0\0\xff", IllegalDataValue),
    ("05 value FF01", b"\x05\0\0\xff\1", IllegalDataValue),
    ("05 short", b"\x05\0\0\xff", IllegalDataValue),
    ("05 long", b"\x05\0\0\xff\0\0", IllegalDataValue),
    ("06 short", b"\x06\0\0\xff", IllegalDataValue),
    ("06 long", b"\x06\0\0\xff\0\0", IllegalDataValue),
    ("06 only the code", b"\x06", IllegalDataValue),
    ("15 no count", write_many(15, 0, 0, 0, b""), IllegalDataValue),
    ("15 no count with a byte", write_many(15, 0, 0, 1, b"\0"), IllegalDataValue),
    ("15 count 1969", write_many(15, 0, 1969, 247, bytes(247)), IllegalDataValue),
    ("15 byte count too small", write_many(15, 0, 9, 1, bytes(1)), IllegalDataValue),
    ("15 byte count too large", write_many(15, 0, 8, 2, bytes(2)), IllegalDataValue),
    ("15 data short", write_many(15, 0, 9, 2, bytes(1)), IllegalDataValue),
    ("15 data long", write_many(15, 0, 9, 2, bytes(3)), IllegalDataValue),
    ("15 no byte count", b"\x0f\0\0\0\1", IllegalDataValue),
    ("15 past the end", write_many(15, 65535, 2, 1, b"\3"), IllegalDataAddress),
    ("15 past the end, bad byte count", write_many(15, 65535, 2, 2, b"\3\0"), IllegalDataValue),
    ("16 no count", write_many(16, 0, 0, 0, b""), IllegalDataValue),
    ("16 count 124", write_many(16, 0, 124, 248, bytes(248)), IllegalDataValue),
    ("16 odd byte count", write_many(16, 0, 1, 3, bytes(3)), IllegalDataValue),
    ("16 byte count too small", write_many(16, 0, 2, 2, bytes(2)), IllegalDataValue),
    ("16 byte count too large", write_many(16, 0, 1, 4, bytes(4)), IllegalDataValue),
    ("16 count 129 and byte count 2", write_many(16, 0, 129, 2, bytes(2)), IllegalDataValue),
    ("16 data short", write_many(16, 0, 2, 4, bytes(3)), IllegalDataValue),
    ("16 data long", write_many(16, 0, 2, 4, bytes(5)), IllegalDataValue),
    ("16 past the end", write_many(16, 65535, 2, 4, bytes(4)), IllegalDataAddress),
    ("16 past the end, bad byte count", write_many(16, 65535, 2, 2, bytes(2)), IllegalDataValue),
    ("22 short", b"\x16\0\0\0\0\0", IllegalDataValue),
    ("22 long", b"\x16\0\0\0\0\0\0\0", IllegalDataValue),
    ("23 reads none", read_write(0, 0, 0, 1, 2, bytes(2)), IllegalDataValue),
    ("23 reads 126", read_write(0, 126, 0, 1, 2, bytes(2)), IllegalDataValue),
    ("23 writes none", read_write(0, 1, 0, 0, 0, b""), IllegalDataValue),
    ("23 writes 122", read_write(0, 1, 0, 122, 244, bytes(244)), IllegalDataValue),
    ("23 byte count", read_write(0, 1, 0, 2, 2, bytes(2)), IllegalDataValue),
    ("23 odd byte count", read_write(0, 1, 0, 1, 3, bytes(3)), IllegalDataValue),
    ("23 data short", read_write(0, 1, 0, 2, 4, bytes(3)), IllegalDataValue),
    ("23 no byte count", b"\x17" + words(0, 1, 0, 1), IllegalDataValue),
    ("23 reads past the end", read_write(65535, 2, 0, 1, 2, bytes(2)), IllegalDataAddress),
    ("23 writes past the end", read_write(0, 1, 65535, 2, 4, bytes(4)), IllegalDataAddress),
    ("23 reads past, writes none", read_write(65535, 2, 0, 0, 0, b""), IllegalDataValue),
    ("23 writes past, reads none", read_write(0, 0, 65535, 2, 4, bytes(4)), IllegalDataValue),
    ("23 writes past, byte count", read_write(0, 1, 65535, 2, 2, bytes(2)), IllegalDataValue),
    ("20 no pieces", b"\x14\0", IllegalDataValue),
    ("20 only the code", b"\x14", IllegalDataValue),
    ("20 no multiple of 7", b"\x14\x06\x06\0\1\0\0\0", IllegalDataValue),
    ("20 eight bytes", b"\x14\x08\x06\0\1\0\0\0\1\0", IllegalDataValue),
    ("20 36 pieces", read_file(*[(6, 1, 0, 1)] * 36), IllegalDataValue),
    ("20 byte count lies low", b"\x14\x07" + read_file(*[(6, 1, 0, 1)] * 2)[2:], IllegalDataValue),
    ("20 byte count lies high", b"\x14\x0e" + read_file((6, 1, 0, 1))[2:], IllegalDataValue),
    ("20 length 0", read_file((6, 1, 0, 0)), IllegalDataValue),
    ("20 answer of 246 bytes", read_file((6, 1, 0, 122)), IllegalDataValue),
    ("20 answer of 246 in two", read_file((6, 1, 0, 60), (6, 1, 0, 61)), IllegalDataValue),
    ("20 length 65535", read_file((6, 1, 0, 65535)), IllegalDataValue),
    ("20 type 5", read_file((5, 1, 0, 1)), IllegalDataAddress),
    ("20 type 0 in the second", read_file((6, 1, 0, 1), (0, 1, 0, 1)), IllegalDataAddress),
    ("20 file 0", read_file((6, 0, 0, 1)), IllegalDataAddress),
    ("20 record 10000", read_file((6, 1, 10_000, 1)), IllegalDataAddress),
    ("20 past record 9999", read_file((6, 1, 9_999, 2)), IllegalDataAddress),
    ("20 type and length 0", read_file((5, 1, 0, 0)), IllegalDataValue),
    ("20 type, then length 0", read_file((5, 1, 0, 1), (6, 1, 0, 0)), IllegalDataValue),
    ("20 file 0 and size", read_file((6, 0, 0, 122)), IllegalDataValue),
    ("20 record and byte count", read_file((6, 1, 10_000, 1)) + b"\0", IllegalDataValue),
    ("21 no pieces", b"\x15\0", IllegalDataValue),
    ("21 only the code", b"\x15", IllegalDataValue),
    ("21 length 0", write_file((6, 1, 0, 0, 0)), IllegalDataValue),
    ("21 length 0 behind a piece", write_file((6, 1, 0, 1, 1), (6, 1, 0, 0, 0)), IllegalDataValue),
    ("21 data short", write_file((6, 1, 0, 2, 1)), IllegalDataValue),
    ("21 data long", write_file((6, 1, 0, 1, 2)), IllegalDataValue),
    ("21 half a register", b"\x15\x0a\x06\0\1\0\0\0\2\0\0\0", IllegalDataValue),
    ("21 half a piece", write_file((6, 1, 0, 1, 1)) + b"\x06", IllegalDataValue),
    ("21 byte count 252", write_file(*[(6, 1, 0, 1, 1)] * 28), IllegalDataValue),
    ("21 byte count 255", b"\x15\xff" + bytes(255), IllegalDataValue),
    ("21 length far past the data", write_file((6, 1, 0, 65535, 1)), IllegalDataValue),
    ("21 type 7", write_file((7, 1, 0, 1, 1)), IllegalDataAddress),
    ("21 file 0", write_file((6, 0, 0, 1, 1)), IllegalDataAddress),
    ("21 record 10000", write_file((6, 1, 10_000, 1, 1)), IllegalDataAddress),
    ("21 past record 9999", write_file((6, 1, 9_999, 2, 2)), IllegalDataAddress),
    ("07 long", b"\x07\0", IllegalDataValue),
    ("08 only the code", b"\x08", IllegalDataValue),
    ("08 half a sub-function", b"\x08\0", IllegalDataValue),
    ("08 query without data", b"\x08\0\0", IllegalDataValue),
    ("08 query with one byte", b"\x08\0\0\1", IllegalDataValue),
    ("08 query with three bytes", b"\x08\0\0\1\2\3", IllegalDataValue),
    ("08 query with 252 bytes", b"\x08\0\0" + bytes(252), IllegalDataValue),
    ("08 counter without data", b"\x08\0\x0b", IllegalDataValue),
    ("08 counter short", b"\x08\0\x0b\0", IllegalDataValue),
    ("08 counter long", b"\x08\0\x0b\0\0\0", IllegalDataValue),
    ("08 unknown and short", b"\x08\xff\xff\0", IllegalDataValue),
    ("11 long", b"\x0b\0\0", IllegalDataValue),
    ("12 long", b"\x0c\0", IllegalDataValue),
    ("17 long", b"\x11\0", IllegalDataValue),
    ("24 only the code", b"\x18", IllegalDataValue),
    ("24 short", b"\x18\0", IllegalDataValue),
    ("24 long", b"\x18\0\0\0", IllegalDataValue),
    ("43 only the code", b"\x2b", IllegalDataValue),
    ("43 type 0", b"\x2b\0", IllegalFunction),
    ("43 type 12", b"\x2b\x0c\1\0", IllegalFunction),
    ("43 type 15", b"\x2b\x0f\1\0", IllegalFunction),
    ("43 type 255 and long", b"\x2b\xff" + bytes(200), IllegalFunction),
    ("43/14 alone", b"\x2b\x0e", IllegalDataValue),
    ("43/14 short", b"\x2b\x0e\1", IllegalDataValue),
    ("43/14 long", b"\x2b\x0e\1\0\0", IllegalDataValue),
    ("43/14 code 0", b"\x2b\x0e\0\0", IllegalDataValue),
    ("43/14 code 5", b"\x2b\x0e\5\0", IllegalDataValue),
    ("43/14 code 255", b"\x2b\x0e\xff\xff", IllegalDataValue),
    ("21 type and data short", write_file((7, 1, 0, 2, 1)), IllegalDataValue),
    ("21 file 0, then length 0", write_file((6, 0, 0, 1, 1), (6, 1, 0, 0, 0)), IllegalDataValue),
]


class TestBadRequests:
    """Section 6: length and quantity are refused with 3, before addresses with 2."""

    @each_case(
        ("request_pdu", "error"),
        BAD_READS + [pytest.param(bad, error, id=why) for why, bad, error in BAD_REQUESTS],
    )
    def test_server_must_answer_with(self, request_pdu, error) -> None:
        with pytest.raises(ExceptionResponse) as caught:
            decode_request(request_pdu)
        assert type(caught.value) is error
        assert caught.value.function == request_pdu[0]

    @each_case(
        "request_pdu",
        [
            read(1, 65535, 1),
            read(1, 63536, 2000),
            read(3, 65411, 125),
            b"\x05\xff\xff\0\0",
            b"\x06\xff\xff\xff\xff",
            write_many(15, 63568, 1968, 246, bytes(246)),
            write_many(16, 65413, 123, 246, bytes(246)),
            read_write(65411, 125, 65415, 121, 242, bytes(242)),
            read_file((6, 1, 0, 121)),
            read_file((6, 65535, 9999, 1)),
            read_file(*[(6, 1, 0, 1)] * 35),
            read_file(*[(6, 1, 0, 3)] * 30),
            write_file((6, 65535, 9878, 122, 122)),
            write_file(*[(6, 1, 0, 1, 1)] * 27),
            b"\x08\0\0" + bytes(250),
            b"\x08\xff\xff\xff\xff",
            b"\x18\xff\xff",
            b"\x2b\x0d",
            b"\x2b\x0d" + bytes(251),
            b"\x2b\x0e\1\xff",
            b"\x2b\x0e\4\xff",
        ],
        ids=lambda request_pdu: f"{request_pdu[0]:02} {request_pdu[1:6].hex()}",
    )
    def test_limits_themselves_are_good(self, request_pdu: bytes) -> None:
        assert decode_request(request_pdu).encode() == request_pdu

    @pytest.mark.parametrize("data", [b"", b"\0\0\0\1"])
    def test_unknown_function_is_illegal_whatever_follows(self, data: bytes) -> None:
        for code in set(range(256)) - set(pdu.REQUESTS):
            with pytest.raises(IllegalFunction) as caught:
                decode_request(bytes([code]) + data)
            assert caught.value.code == 1
            assert caught.value.function == code

    def test_empty_pdu_is_the_callers_fault(self) -> None:
        with pytest.raises(ValueError, match="pdu"):
            decode_request(b"")

    @pytest.mark.parametrize("data", [b"\xff", b"\xf5"])
    def test_unused_bits_of_coils_are_ignored(self, data: bytes) -> None:
        assert decode_request(write_many(15, 0, 3, 1, data)) == WriteCoils(
            0, [value == 1 for value in (1, data[0] >> 1 & 1, 1)]
        )
