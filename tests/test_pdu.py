"""
PDUs of both ends: the worked examples, what constructors refuse, what servers must answer
to bad requests, and what clients must make of bad responses.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from vectors import EXCEPTIONS, REQUESTS, RESPONSES, FrameVector, rows

from libmodbus_py import pdu
from libmodbus_py.errors import (
    Acknowledge,
    ExceptionResponse,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    MemoryParityError,
    NegativeAcknowledge,
    ServerDeviceBusy,
    ServerDeviceFailure,
)
from libmodbus_py.pdu import (
    MaskWriteRegister,
    ReadCoils,
    ReadDiscreteInputs,
    ReadFileRecords,
    ReadHoldingRegisters,
    ReadInputRegisters,
    ReadWriteRegisters,
    Request,
    WriteCoil,
    WriteCoils,
    WriteFileRecords,
    WriteRegister,
    WriteRegisters,
    decode_request,
)

Fields = dict[str, Any]


def _read(kind: type[Request[Any]]) -> Callable[[Fields], Request[Any]]:
    return lambda fields: kind(fields["address"], fields["quantity"])  # type: ignore[call-arg]


# Function -> the request that an example's fields describe.
FROM_FIELDS: dict[int, Callable[[Fields], Request[Any]]] = {
    1: _read(ReadCoils),
    2: _read(ReadDiscreteInputs),
    3: _read(ReadHoldingRegisters),
    4: _read(ReadInputRegisters),
    5: lambda fields: WriteCoil(fields["address"], fields["value"] == "ON"),
    6: lambda fields: WriteRegister(fields["address"], fields["value"]),
    15: lambda fields: WriteCoils(fields["address"], fields["values"]),
    16: lambda fields: WriteRegisters(fields["address"], fields["values"]),
    20: lambda fields: ReadFileRecords(
        [(sub["file"], sub["record"], sub["length"]) for sub in fields["sub_requests"]]
    ),
    21: lambda fields: WriteFileRecords(
        [(sub["file"], sub["record"], sub["values"]) for sub in fields["sub_requests"]]
    ),
    22: lambda fields: MaskWriteRegister(fields["address"], fields["and_mask"], fields["or_mask"]),
    23: lambda fields: ReadWriteRegisters(
        fields["read_address"], fields["read_quantity"], fields["write_address"], fields["values"]
    ),
}


def _known(vectors: list[FrameVector]) -> list[Any]:
    return rows([vector for vector in vectors if vector.function in FROM_FIELDS])


def _request_of(response: FrameVector) -> Request[Any]:
    """The request that a response answers; one that fits where the example has none."""
    for vector in REQUESTS:
        if vector.id == response.request:
            return FROM_FIELDS[vector.function](vector.fields)
    return ReadHoldingRegisters(0, len(response.fields.get("values", [0])))


def _result_of(response: FrameVector) -> Any:
    fields = response.fields
    if response.function in (1, 2):
        return [value == 1 for value in fields["values"]]
    if response.function in (3, 4, 23):
        return fields["values"]
    if response.function == 20:
        return [sub["values"] for sub in fields["sub_responses"]]
    return None


class TestWorkedExamples:
    def test_there_is_one_of_every_function(self) -> None:
        for vectors in (REQUESTS, RESPONSES):
            assert {vector.function for vector in vectors} >= set(FROM_FIELDS)

    @pytest.mark.parametrize("vector", _known(REQUESTS))
    def test_request_encodes_to_the_bytes(self, vector: FrameVector) -> None:
        assert FROM_FIELDS[vector.function](vector.fields).encode() == vector.pdu

    @pytest.mark.parametrize("vector", _known(REQUESTS))
    def test_request_decodes_from_the_bytes(self, vector: FrameVector) -> None:
        assert decode_request(vector.pdu) == FROM_FIELDS[vector.function](vector.fields)

    @pytest.mark.parametrize("vector", _known(RESPONSES))
    def test_response_encodes_to_the_bytes(self, vector: FrameVector) -> None:
        assert _request_of(vector).encode_response(_result_of(vector)) == vector.pdu

    @pytest.mark.parametrize("vector", _known(RESPONSES))
    def test_response_decodes_to_the_values(self, vector: FrameVector) -> None:
        result = _request_of(vector).decode_response(vector.pdu)
        assert result == _result_of(vector)
        assert type(result) is type(_result_of(vector))
        if vector.function in (1, 2):
            assert set(map(type, result)) == {bool}

    @pytest.mark.parametrize("vector", _known(EXCEPTIONS))
    def test_exception_raises_its_class_with_code_and_request(self, vector: FrameVector) -> None:
        kinds = {1: IllegalFunction, 2: IllegalDataAddress}
        request = next(
            (
                FROM_FIELDS[asked.function](asked.fields)
                for asked in REQUESTS
                if asked.id == vector.request
            ),
            ReadHoldingRegisters(0, 1),
        )
        with pytest.raises(kinds[vector.fields["exception"]]) as caught:
            request.decode_response(vector.pdu)
        assert caught.value.code == vector.fields["exception"]
        assert caught.value.function == vector.function
        assert str(request) in str(caught.value)

    @pytest.mark.parametrize(
        "vector", rows([vector for vector in REQUESTS if vector.function in pdu.REQUESTS])
    )
    def test_decoded_request_encodes_to_the_same_bytes(self, vector: FrameVector) -> None:
        request = decode_request(vector.pdu)
        assert type(request) is pdu.REQUESTS[vector.function]
        assert request.function == vector.function
        assert request.encode() == vector.pdu


class TestLengthRules:
    @pytest.mark.parametrize("vector", _known(REQUESTS))
    def test_request_length_is_known_from_the_head_and_right(self, vector: FrameVector) -> None:
        lengths = [pdu.request_length(vector.pdu[:end]) for end in range(1, len(vector.pdu) + 1)]
        assert lengths[-1] == len(vector.pdu)
        assert set(lengths) <= {None, len(vector.pdu)}

    @pytest.mark.parametrize("vector", _known(RESPONSES + EXCEPTIONS))
    def test_response_length_is_known_from_the_head_and_right(self, vector: FrameVector) -> None:
        lengths = [pdu.response_length(vector.pdu[:end]) for end in range(1, len(vector.pdu) + 1)]
        assert lengths[-1] == len(vector.pdu)
        assert set(lengths) <= {None, len(vector.pdu)}

    @pytest.mark.parametrize("code", [0x80, 0x81, 0xAB, 0xFF])
    def test_every_exception_response_has_two_bytes(self, code: int) -> None:
        assert pdu.response_length(bytes([code])) == 2

    def test_unknown_functions_have_no_rule(self) -> None:
        for code in set(range(256)) - set(pdu.REQUESTS):
            with pytest.raises(KeyError):
                pdu.request_length(bytes([code, 0]))
        for code in set(range(128)) - set(pdu.REQUESTS):
            with pytest.raises(KeyError):
                pdu.response_length(bytes([code, 0]))


class Seven:
    """An integer that is no int, as those of numpy are."""

    def __index__(self) -> int:
        return 7


# --- constructors ------------------------------------------------------------------

NO_INTEGERS: list[Any] = [1.5, "1", None, True, b"1", [1]]
NO_SEQUENCES: list[Any] = ["12", b"12", bytearray(b"12"), {1: 2}, {1, 2}, frozenset({1}), 5, None]

# Constructors with one address, and what makes the rest of their arguments.
ADDRESSED: list[tuple[str, Callable[[Any], Request[Any]]]] = [
    ("address", lambda address: ReadCoils(address, 1)),
    ("address", lambda address: ReadDiscreteInputs(address, 1)),
    ("address", lambda address: ReadHoldingRegisters(address, 1)),
    ("address", lambda address: ReadInputRegisters(address, 1)),
    ("address", lambda address: WriteCoil(address, True)),
    ("address", lambda address: WriteRegister(address, 1)),
    ("address", lambda address: WriteCoils(address, [True])),
    ("address", lambda address: WriteRegisters(address, [1])),
    ("address", lambda address: MaskWriteRegister(address, 0, 0)),
    ("read_address", lambda address: ReadWriteRegisters(address, 1, 0, [1])),
    ("write_address", lambda address: ReadWriteRegisters(0, 1, address, [1])),
]

COUNTED: list[tuple[str, int, Callable[[int, Any], Request[Any]]]] = [
    ("count", 2000, ReadCoils),
    ("count", 2000, ReadDiscreteInputs),
    ("count", 125, ReadHoldingRegisters),
    ("count", 125, ReadInputRegisters),
    ("read_count", 125, lambda address, count: ReadWriteRegisters(address, count, 0, [1])),
]

SEQUENCED: list[tuple[str, int, Callable[[int, Any], Request[Any]]]] = [
    ("values", 1968, WriteCoils),
    ("values", 123, WriteRegisters),
    ("values", 121, lambda address, values: ReadWriteRegisters(0, 1, address, values)),
]

REGISTERS: list[tuple[str, Callable[[Any], Request[Any]]]] = [
    ("value", lambda value: WriteRegister(0, value)),
    ("and_mask", lambda value: MaskWriteRegister(0, value, 0)),
    ("or_mask", lambda value: MaskWriteRegister(0, 0, value)),
    (r"values\[2\]", lambda value: WriteRegisters(0, [1, 2, value])),
    (r"values\[2\]", lambda value: ReadWriteRegisters(0, 1, 0, [1, 2, value])),
    (r"records\[0\] values\[1\]", lambda value: WriteFileRecords([(1, 0, [1, value])])),
]


class TestConstructors:
    @pytest.mark.parametrize(("name", "make"), ADDRESSED)
    def test_address_goes_from_0_to_65535(
        self, name: str, make: Callable[[Any], Request[Any]]
    ) -> None:
        for good in (0, 65535):
            assert getattr(make(good), name) == good
        for bad in (-1, 65536, 1 << 40):
            with pytest.raises(ValueError, match=rf"^{name} must be in 0\.\.65535, not {bad}"):
                make(bad)

    @pytest.mark.parametrize("bad", NO_INTEGERS, ids=repr)
    @pytest.mark.parametrize(("name", "make"), ADDRESSED)
    def test_address_is_an_integer(
        self, name: str, make: Callable[[Any], Request[Any]], bad: Any
    ) -> None:
        with pytest.raises(TypeError, match=rf"^{name} must be an integer"):
            make(bad)

    @pytest.mark.parametrize(("name", "make"), ADDRESSED)
    def test_other_kinds_of_integers_become_int(
        self, name: str, make: Callable[[Any], Request[Any]]
    ) -> None:
        address = getattr(make(Seven()), name)
        assert address == 7
        assert type(address) is int

    @pytest.mark.parametrize(("name", "limit", "make"), COUNTED)
    def test_count_goes_from_1_to_its_limit(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]]
    ) -> None:
        for good in (1, limit):
            assert getattr(make(0, good), name) == good
        for bad in (0, -1, limit + 1, 65536):
            with pytest.raises(ValueError, match=rf"^{name} must be in 1\.\.{limit}, not {bad}"):
                make(0, bad)

    @pytest.mark.parametrize("bad", NO_INTEGERS, ids=repr)
    @pytest.mark.parametrize(("name", "limit", "make"), COUNTED)
    def test_count_is_an_integer(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]], bad: Any
    ) -> None:
        with pytest.raises(TypeError, match=rf"^{name} must be an integer in 1\.\.{limit}"):
            make(0, bad)

    @pytest.mark.parametrize(("name", "limit", "make"), COUNTED)
    def test_address_and_count_do_not_pass_65536(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]]
    ) -> None:
        make(65535, 1)
        make(65536 - limit, limit)
        for address, count in ((65535, 2), (65536 - limit + 1, limit)):
            with pytest.raises(ValueError, match=rf"address \+ {name} .* 65536"):
                make(address, count)

    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_values_hold_1_to_their_limit(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]]
    ) -> None:
        for good in (1, limit):
            assert len(getattr(make(0, [1] * good), name)) == good
        for bad in ([], [1] * (limit + 1), itertools.repeat(1)):
            with pytest.raises(ValueError, match=rf"^{name} must hold 1\.\.{limit} values"):
                make(0, bad)

    @pytest.mark.parametrize("bad", NO_SEQUENCES, ids=repr)
    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_values_are_no_text_set_mapping_or_number(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]], bad: Any
    ) -> None:
        with pytest.raises(TypeError, match=rf"^{name} must be a sequence of 1\.\.{limit} values"):
            make(0, bad)

    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_values_of_any_iterable_are_kept_as_a_tuple(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]]
    ) -> None:
        for values in ([1, 0], (1, 0), range(1, -1, -1), (value for value in (1, 0))):
            kept = getattr(make(0, values), name)
            assert kept == (1, 0)
            assert type(kept) is tuple

    def test_registers_of_other_kinds_of_integers_become_int(self) -> None:
        assert repr(WriteRegisters(0, [1, Seven()]).values) == "(1, 7)"

    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_address_and_values_do_not_pass_65536(
        self, name: str, limit: int, make: Callable[[int, Any], Request[Any]]
    ) -> None:
        make(65536 - limit, [1] * limit)
        with pytest.raises(ValueError, match=rf"address \+ len\({name}\) .* 65536"):
            make(65536 - limit + 1, [1] * limit)

    @pytest.mark.parametrize(("name", "make"), REGISTERS)
    def test_registers_go_from_0_to_65535(
        self, name: str, make: Callable[[Any], Request[Any]]
    ) -> None:
        make(0)
        make(65535)
        for bad in (-1, 65536):
            with pytest.raises(ValueError, match=rf"^{name} must be in 0\.\.65535, not {bad}"):
                make(bad)
        for bad in NO_INTEGERS:
            with pytest.raises(TypeError, match=rf"^{name} must be an integer in 0\.\.65535"):
                make(bad)

    @pytest.mark.parametrize(
        ("name", "make"),
        [
            ("value", lambda value: WriteCoil(0, value)),
            (r"values\[1\]", lambda value: WriteCoils(0, [True, value])),
        ],
    )
    def test_coils_are_true_false_1_or_0(
        self, name: str, make: Callable[[Any], Request[Any]]
    ) -> None:
        assert make(1) == make(True)
        assert make(0) == make(False)
        assert make(0) != make(1)
        for bad in (2, -1, 0xFF00):
            with pytest.raises(ValueError, match=rf"^{name} must be in 0\.\.1, not {bad}"):
                make(bad)
        for bad in (1.0, "1", None, b"\1"):
            with pytest.raises(TypeError, match=rf"^{name} must be an integer in 0\.\.1"):
                make(bad)

    @pytest.mark.parametrize(
        ("record", "error", "words"),
        [
            ((0, 0, 1), ValueError, r"records\[1\] file must be in 1\.\.65535, not 0"),
            ((65536, 0, 1), ValueError, r"records\[1\] file must be in 1\.\.65535"),
            (("1", 0, 1), TypeError, r"records\[1\] file must be an integer"),
            ((1, -1, 1), ValueError, r"records\[1\] record must be in 0\.\.9999"),
            ((1, 10_000, 1), ValueError, r"records\[1\] record must be in 0\.\.9999"),
            ((1, 1.5, 1), TypeError, r"records\[1\] record must be an integer"),
            ((1, 9999, 2), ValueError, r"records\[1\] record \+ length must not pass 10000"),
            ((1, 0, 0), ValueError, r"records\[1\] length must be in 1\.\.124"),
            ((1, 0, 125), ValueError, r"records\[1\] length must be in 1\.\.124"),
            ((1, 0, True), TypeError, r"records\[1\] length must be an integer"),
            ((1, 0), TypeError, r"records\[1\] must be a tuple \(file, record, length\)"),
            ((1, 0, 1, 1), TypeError, r"records\[1\] must be a tuple \(file, record, length\)"),
            ("abc", TypeError, r"records\[1\] must be a tuple \(file, record, length\)"),
            (5, TypeError, r"records\[1\] must be a tuple \(file, record, length\)"),
        ],
    )
    def test_read_file_records_names_the_bad_piece(
        self, record: Any, error: type[Exception], words: str
    ) -> None:
        with pytest.raises(error, match=f"^{words}"):
            ReadFileRecords([(1, 0, 1), record])

    @pytest.mark.parametrize(
        ("record", "error", "words"),
        [
            ((0, 0, [1]), ValueError, r"records\[1\] file must be in 1\.\.65535, not 0"),
            ((65536, 0, [1]), ValueError, r"records\[1\] file must be in 1\.\.65535"),
            ((1, 10_000, [1]), ValueError, r"records\[1\] record must be in 0\.\.9999"),
            ((1, 9999, [1, 2]), ValueError, r"records\[1\] record \+ length must not pass 10000"),
            ((1, 0, []), ValueError, r"records\[1\] values must hold 1\.\.122 values"),
            ((1, 0, [1] * 123), ValueError, r"records\[1\] values must hold 1\.\.122 values"),
            ((1, 0, "ab"), TypeError, r"records\[1\] values must be a sequence"),
            ((1, 0, 1), TypeError, r"records\[1\] values must be a sequence"),
            ((1, 0), TypeError, r"records\[1\] must be a tuple \(file, record, values\)"),
        ],
    )
    def test_write_file_records_names_the_bad_piece(
        self, record: Any, error: type[Exception], words: str
    ) -> None:
        with pytest.raises(error, match=f"^{words}"):
            WriteFileRecords([(1, 0, [1]), record])

    @pytest.mark.parametrize("kind", [ReadFileRecords, WriteFileRecords])
    def test_records_are_a_sequence_of_at_least_one(self, kind: Any) -> None:
        with pytest.raises(ValueError, match=r"^records must hold 1"):
            kind([])
        for bad in NO_SEQUENCES:
            with pytest.raises(TypeError, match=r"^records must be a sequence"):
                kind(bad)

    def test_file_pieces_fit_one_message(self) -> None:
        """Section 6.14 and 6.15: what the PDU of 253 bytes holds, to the last register."""
        ReadFileRecords([(1, 0, 124)])
        ReadFileRecords([(1, 0, 1)] * 35)
        ReadFileRecords([(1, 0, 61)] * 2)  # 2 * (2 + 122) = 248
        with pytest.raises(ValueError, match=r"^records ask for a response of 252 bytes"):
            ReadFileRecords([(1, 0, 62)] * 2)
        with pytest.raises(ValueError, match=r"^records must hold 1\.\.35"):
            ReadFileRecords([(1, 0, 1)] * 36)
        assert len(WriteFileRecords([(1, 0, [1] * 122)]).encode()) == 253
        WriteFileRecords([(1, 0, [1])] * 27)
        with pytest.raises(ValueError, match=r"^records take 252 bytes, more than 251"):
            WriteFileRecords([(1, 0, [1] * 59), (2, 0, [1] * 60)])
        with pytest.raises(ValueError, match=r"^records must hold 1\.\.27"):
            WriteFileRecords([(1, 0, [1])] * 28)

    def test_requests_are_values(self) -> None:
        request = WriteRegisters(1, [1, 2])
        assert request == WriteRegisters(1, (1, 2))
        assert hash(request) == hash(WriteRegisters(1, (1, 2)))
        assert request != WriteRegisters(1, [1, 3])
        assert ReadCoils(0, 1) != ReadDiscreteInputs(0, 1)
        with pytest.raises(AttributeError):
            request.address = 2  # type: ignore[misc]

    def test_list_given_is_not_kept(self) -> None:
        values = [1, 2]
        request = WriteRegisters(1, values)
        values.append(3)
        assert request.values == (1, 2)

    def test_text_names_the_arguments_and_stays_short(self) -> None:
        assert str(ReadCoils(3, 5)) == "ReadCoils(address=3, count=5)"
        assert len(str(WriteCoils(0, [True] * 1968))) < 200
        assert len(str(WriteFileRecords([(1, 0, [1])] * 27))) < 300

    def test_only_requests_that_change_the_device_alone_can_be_broadcast(self) -> None:
        writes = {code for code, request in pdu.REQUESTS.items() if request.is_write}
        assert writes & set(FROM_FIELDS) == {5, 6, 15, 16, 21, 22}


# --- bad requests --------------------------------------------------------------------


def words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


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
    ("20 file 0 and size", read_file((6, 0, 0, 122)), IllegalDataValue),
    ("20 record and byte count", read_file((6, 1, 10_000, 1)) + b"\0", IllegalDataValue),
    ("21 no pieces", b"\x15\0", IllegalDataValue),
    ("21 only the code", b"\x15", IllegalDataValue),
    ("21 length 0", write_file((6, 1, 0, 0, 0)), IllegalDataValue),
    ("21 length 0 behind a piece", write_file((6, 1, 0, 1, 1), (6, 1, 0, 0, 0)), IllegalDataValue),
    ("21 data short", write_file((6, 1, 0, 2, 1)), IllegalDataValue),
    ("21 data long", write_file((6, 1, 0, 1, 2)), IllegalDataValue),
    ("21 half a piece", write_file((6, 1, 0, 1, 1)) + b"\x06", IllegalDataValue),
    ("21 byte count 252", write_file(*[(6, 1, 0, 1, 1)] * 28), IllegalDataValue),
    ("21 byte count 255", b"\x15\xff" + bytes(255), IllegalDataValue),
    ("21 length far past the data", write_file((6, 1, 0, 65535, 1)), IllegalDataValue),
    ("21 type 7", write_file((7, 1, 0, 1, 1)), IllegalDataAddress),
    ("21 file 0", write_file((6, 0, 0, 1, 1)), IllegalDataAddress),
    ("21 record 10000", write_file((6, 1, 10_000, 1, 1)), IllegalDataAddress),
    ("21 past record 9999", write_file((6, 1, 9_999, 2, 2)), IllegalDataAddress),
    ("21 type and data short", write_file((7, 1, 0, 2, 1)), IllegalDataValue),
    ("21 file 0, then length 0", write_file((6, 0, 0, 1, 1), (6, 1, 0, 0, 0)), IllegalDataValue),
]


class TestBadRequests:
    """Sections 6.1 to 6.17: length and quantity are refused with 3, before addresses with 2."""

    @pytest.mark.parametrize(
        ("request_pdu", "error"),
        BAD_READS + [pytest.param(bad, error, id=why) for why, bad, error in BAD_REQUESTS],
    )
    def test_server_must_answer_with(
        self, request_pdu: bytes, error: type[ExceptionResponse]
    ) -> None:
        with pytest.raises(ExceptionResponse) as caught:
            decode_request(request_pdu)
        assert type(caught.value) is error
        assert caught.value.function == request_pdu[0]

    @pytest.mark.parametrize(
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
            write_file((6, 65535, 9878, 122, 122)),
            write_file(*[(6, 1, 0, 1, 1)] * 27),
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


# --- bad responses -------------------------------------------------------------------


def one_of_each() -> list[Request[Any]]:
    return [
        ReadCoils(0, 10),
        ReadDiscreteInputs(0, 8),
        ReadHoldingRegisters(0, 2),
        ReadInputRegisters(0, 2),
        WriteCoil(1, True),
        WriteRegister(1, 2),
        WriteCoils(1, [True, False]),
        WriteRegisters(1, [2, 3]),
        ReadFileRecords([(1, 2, 1), (3, 4, 2)]),
        WriteFileRecords([(1, 2, [3]), (4, 5, [6, 7])]),
        MaskWriteRegister(1, 2, 3),
        ReadWriteRegisters(1, 2, 3, [4]),
    ]


def good_result(request: Request[Any]) -> Any:
    match request:
        case ReadCoils() | ReadDiscreteInputs():
            return [True] * request.count
        case ReadHoldingRegisters() | ReadInputRegisters():
            return [7] * request.count
        case ReadWriteRegisters():
            return [7] * request.read_count
        case ReadFileRecords():
            return [[7] * length for _, _, length in request.records]
        case _:
            return None


each_request = pytest.mark.parametrize(
    "request_", one_of_each(), ids=lambda request: type(request).__name__
)


class TestBadResponses:
    @each_request
    def test_empty_cut_and_prolonged_responses_are_invalid(self, request_: Request[Any]) -> None:
        good = request_.encode_response(good_result(request_))
        assert request_.decode_response(good) == good_result(request_)
        for end in range(len(good)):
            with pytest.raises(InvalidResponse):
                request_.decode_response(good[:end])
        with pytest.raises(InvalidResponse):
            request_.decode_response(good + b"\0")

    @each_request
    def test_other_function_is_invalid_and_the_error_names_the_request(
        self, request_: Request[Any]
    ) -> None:
        good = request_.encode_response(good_result(request_))
        for other in {0, *pdu.REQUESTS, 0x7F} - {request_.function}:
            with pytest.raises(InvalidResponse) as caught:
                request_.decode_response(bytes([other]) + good[1:])
            assert str(request_) in str(caught.value)
            assert caught.value.function == request_.function

    @each_request
    def test_refusal_of_another_function_is_invalid(self, request_: Request[Any]) -> None:
        for other in {*pdu.REQUESTS, 0, 0x7F} - {request_.function}:
            with pytest.raises(InvalidResponse):
                request_.decode_response(bytes([other | 0x80, 2]))

    @each_request
    def test_refusal_of_other_length_is_invalid(self, request_: Request[Any]) -> None:
        for tail in (b"", b"\2\0", b"\2\0\0\0"):
            with pytest.raises(InvalidResponse):
                request_.decode_response(bytes([request_.function | 0x80]) + tail)

    def test_refusal_keeps_its_code(self) -> None:
        kinds = {
            1: IllegalFunction,
            2: IllegalDataAddress,
            3: IllegalDataValue,
            4: ServerDeviceFailure,
            5: Acknowledge,
            6: ServerDeviceBusy,
            7: NegativeAcknowledge,
            8: MemoryParityError,
            10: GatewayPathUnavailable,
            11: GatewayTargetFailedToRespond,
        }
        for code in range(256):
            with pytest.raises(ExceptionResponse) as caught:
                ReadCoils(0, 1).decode_response(bytes([0x81, code]))
            assert type(caught.value) is kinds.get(code, ExceptionResponse)
            assert caught.value.code == code
            assert f"exception {code})" in str(caught.value)

    @pytest.mark.parametrize(
        ("request_", "response"),
        [
            (ReadCoils(0, 10), b"\1\1\1"),  # bytes for 8
            (ReadCoils(0, 10), b"\1\3\1\1\1"),  # bytes for 24
            (ReadCoils(0, 8), b"\1\0"),
            (ReadHoldingRegisters(0, 2), b"\3\2\0\1"),
            (ReadHoldingRegisters(0, 2), b"\3\6" + bytes(6)),
            (ReadHoldingRegisters(0, 2), b"\3\3" + bytes(3)),
            (ReadHoldingRegisters(0, 2), b"\3\0"),
            (ReadWriteRegisters(0, 2, 0, [1]), b"\x17\2\0\1"),
            (ReadFileRecords([(1, 0, 1)]), b"\x14\0"),
            (ReadFileRecords([(1, 0, 1)]), b"\x14\4\3\5\0\1"),  # reference type
            (ReadFileRecords([(1, 0, 1)]), b"\x14\4\4\6\0\1"),  # length of the piece
            (ReadFileRecords([(1, 0, 1)]), b"\x14\6\5\6\0\1\0\1"),  # one register more
            (ReadFileRecords([(1, 0, 1)]), b"\x14\x08" + b"\3\6\0\1" * 2),  # one piece more
            (ReadFileRecords([(1, 0, 1)] * 2), b"\x14\4\3\6\0\1"),  # one piece less
            (ReadFileRecords([(1, 0, 1), (1, 0, 2)]), b"\x14\x0a\5\6\0\1\0\2\3\6\0\1"),  # order
        ],
    )
    def test_byte_counts_that_do_not_fit_the_request_are_invalid(
        self, request_: Request[Any], response: bytes
    ) -> None:
        with pytest.raises(InvalidResponse):
            request_.decode_response(response)

    @pytest.mark.parametrize(
        "request_",
        [request for request in one_of_each() if request.is_write],
        ids=lambda request: type(request).__name__,
    )
    def test_every_byte_of_an_echo_counts(self, request_: Request[Any]) -> None:
        good = request_.encode_response(None)
        for at in range(1, len(good)):
            spoilt = bytearray(good)
            spoilt[at] ^= 1
            with pytest.raises(InvalidResponse):
                request_.decode_response(bytes(spoilt))

    def test_padding_bits_of_coils_are_ignored(self) -> None:
        assert ReadCoils(0, 3).decode_response(b"\1\1\xfd") == [True, False, True]

    def test_padding_bits_are_sent_as_0(self) -> None:
        assert ReadCoils(0, 3).encode_response([True] * 3) == b"\1\1\7"
        assert WriteCoils(0, [True] * 9).encode()[-2:] == b"\xff\1"

    def test_client_takes_more_from_files_than_a_server_may_send(self) -> None:
        """The table of section 6.14 ends at 245 bytes, the PDU at 251."""
        request = ReadFileRecords([(1, 0, 124)])
        response = request.encode_response([range(124)])
        assert len(response) == 252
        assert request.decode_response(response) == [list(range(124))]


class TestEncodeResponse:
    @pytest.mark.parametrize(
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
        ],
    )
    def test_result_must_be_what_was_asked_for(
        self, request_: Request[Any], result: Any, error: type[Exception]
    ) -> None:
        with pytest.raises(error, match="result"):
            request_.encode_response(result)


# --- properties ------------------------------------------------------------------------

registers = st.integers(0, 65535)


def at(count: int) -> st.SearchStrategy[int]:
    """An address from which `count` items fit."""
    return st.integers(0, 65536 - count)


@st.composite
def requests(draw: st.DrawFn) -> Request[Any]:
    function = draw(st.sampled_from(sorted(FROM_FIELDS)))
    if function in (1, 2, 3, 4):
        count = draw(st.integers(1, 2000 if function < 3 else 125))
        return pdu.REQUESTS[function](draw(at(count)), count)  # type: ignore[call-arg]
    if function == 5:
        return WriteCoil(draw(registers), draw(st.booleans()))
    if function == 6:
        return WriteRegister(draw(registers), draw(registers))
    if function == 15:
        bits = draw(st.lists(st.booleans(), min_size=1, max_size=1968))
        return WriteCoils(draw(at(len(bits))), bits)
    if function == 16:
        values = draw(st.lists(registers, min_size=1, max_size=123))
        return WriteRegisters(draw(at(len(values))), values)
    if function == 20:
        lengths = draw(st.lists(st.integers(1, 5), min_size=1, max_size=20))
        return ReadFileRecords(
            [(draw(st.integers(1, 65535)), draw(st.integers(0, 9995)), n) for n in lengths]
        )
    if function == 21:
        pieces = draw(
            st.lists(st.lists(registers, min_size=1, max_size=5), min_size=1, max_size=14)
        )
        return WriteFileRecords(
            [(draw(st.integers(1, 65535)), draw(st.integers(0, 9995)), v) for v in pieces]
        )
    if function == 22:
        return MaskWriteRegister(draw(registers), draw(registers), draw(registers))
    values = draw(st.lists(registers, min_size=1, max_size=121))
    count = draw(st.integers(1, 125))
    return ReadWriteRegisters(draw(at(count)), count, draw(at(len(values))), values)


def results(request: Request[Any]) -> st.SearchStrategy[Any]:
    def exactly(item: st.SearchStrategy[Any], count: int) -> st.SearchStrategy[list[Any]]:
        return st.lists(item, min_size=count, max_size=count)

    match request:
        case ReadCoils() | ReadDiscreteInputs():
            return st.binary(min_size=1, max_size=1).map(
                lambda pattern: [bool(pattern[0] >> at % 8 & 1) for at in range(request.count)]
            )
        case ReadHoldingRegisters() | ReadInputRegisters():
            return exactly(registers, request.count)
        case ReadWriteRegisters():
            return exactly(registers, request.read_count)
        case ReadFileRecords():
            return st.tuples(*(exactly(registers, n) for _, _, n in request.records)).map(list)
        case _:
            return st.none()


def attempt(decode: Callable[[bytes], Any], data: bytes) -> Any:
    """What a decoder gives, or what it raises, as a value."""
    try:
        return decode(data)
    except Exception as error:
        return error


class TestProperties:
    @settings(max_examples=120, deadline=None)
    @given(requests())
    def test_requests_survive_the_wire(self, request_: Request[Any]) -> None:
        encoded = request_.encode()
        assert decode_request(encoded) == request_
        assert len(encoded) <= pdu.MAX_PDU
        assert pdu.request_length(encoded) == len(encoded)

    @settings(max_examples=120, deadline=None)
    @given(st.data())
    def test_results_survive_the_wire(self, data: st.DataObject) -> None:
        request = data.draw(requests())
        result = data.draw(results(request))
        encoded = request.encode_response(result)
        assert request.decode_response(encoded) == result
        assert len(encoded) <= pdu.MAX_PDU
        assert pdu.response_length(encoded) == len(encoded)

    @settings(max_examples=400, deadline=None)
    @given(
        st.binary(max_size=260)
        | st.builds(
            lambda code, tail: bytes([code]) + tail,
            st.sampled_from(sorted(pdu.REQUESTS)),
            st.binary(max_size=30),
        )
    )
    @example(b"\x15\x09" + bytes(9))
    @example(b"\x14\x07" + bytes(7))
    def test_any_request_is_decoded_or_refused(self, data: bytes) -> None:
        outcome = attempt(decode_request, data)
        if isinstance(outcome, ExceptionResponse):
            assert type(outcome) in (IllegalFunction, IllegalDataAddress, IllegalDataValue)
        elif isinstance(outcome, ValueError):
            assert data == b""
        elif outcome.function == 15:  # unused bits are the sender's own
            assert outcome.encode()[:-1] == data[:-1]
        else:
            assert outcome.encode() == data

    @settings(max_examples=400, deadline=None)
    @given(
        st.sampled_from(one_of_each()),
        st.binary(max_size=260),
        st.booleans(),
        st.sampled_from([0, 0x80]),
    )
    def test_any_response_is_decoded_or_an_error(
        self, request_: Request[Any], data: bytes, with_function: bool, mark: int
    ) -> None:
        if with_function:
            data = bytes([request_.function | mark]) + data
        outcome = attempt(request_.decode_response, data)
        if isinstance(outcome, ExceptionResponse):
            assert data == bytes([request_.function | 0x80, outcome.code])
        elif isinstance(outcome, InvalidResponse):
            assert outcome.function == request_.function
        else:
            assert not isinstance(outcome, Exception)
            assert data[:1] == bytes([request_.function])
