"""
Device.answer against a second device, written here from the specification with dicts alone.
"""

from __future__ import annotations

import logging
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vectors import EXCEPTIONS, REQUESTS, RESPONSES, FrameVector, rows

from libmodbus_py import Device, Mapping, RecordFile, pdu
from libmodbus_py import device as device_module

BITS = {1: range(10, 2100), 2: range(20, 2100)}
REGISTERS = {3: range(100, 400), 4: range(200, 400)}
LAST = 65536
FILES: dict[int, dict[int, int]] = {
    4: {record: record * 7 & 0xFFFF for record in range(10_000)},
    3: {9: 0x33CD, 10: 0x0040, 12: 7},
    65535: {0: 1, 1: 2, 2: 3},
}


class Refused(Exception):
    """An exception code of section 7."""


class Model:
    """Section 6 for the functions 1-6, 15, 16, 20-23: tables and files are dicts."""

    def __init__(self) -> None:
        self.bits = {code: dict.fromkeys(addresses, 0) for code, addresses in BITS.items()}
        self.words = {code: dict.fromkeys(addresses, 0) for code, addresses in REGISTERS.items()}
        self.files = {number: dict(records) for number, records in FILES.items()}

    def answer(self, request: bytes) -> bytes:
        code, body = request[0], request[1:]
        if code >= 0x80:
            return b""
        execute = getattr(self, f"function_{code}", None)
        try:
            if execute is None:
                raise Refused(1)
            return bytes([code]) + execute(body)
        except Refused as refused:
            return bytes([code | 0x80, refused.args[0]])

    @staticmethod
    def need(condition: bool, code: int) -> None:
        if not condition:
            raise Refused(code)

    def cells(self, table: dict[int, int], start: int, count: int) -> range:
        cells = range(start, start + count)
        self.need(all(cell in table for cell in cells), 2)
        return cells

    def read_bits(self, table: dict[int, int], body: bytes) -> bytes:
        self.need(len(body) == 4, 3)
        start, count = struct.unpack(">HH", body)
        self.need(1 <= count <= 2000, 3)
        packed = bytearray(-(-count // 8))
        for at, cell in enumerate(self.cells(table, start, count)):
            packed[at // 8] |= table[cell] << at % 8
        return bytes([len(packed)]) + packed

    def function_1(self, body: bytes) -> bytes:
        return self.read_bits(self.bits[1], body)

    def function_2(self, body: bytes) -> bytes:
        return self.read_bits(self.bits[2], body)

    def read_words(self, table: dict[int, int], start: int, count: int) -> bytes:
        return bytes([2 * count]) + b"".join(
            table[cell].to_bytes(2, "big") for cell in self.cells(table, start, count)
        )

    def function_3(self, body: bytes, code: int = 3) -> bytes:
        self.need(len(body) == 4, 3)
        start, count = struct.unpack(">HH", body)
        self.need(1 <= count <= 125, 3)
        return self.read_words(self.words[code], start, count)

    def function_4(self, body: bytes) -> bytes:
        return self.function_3(body, 4)

    def function_5(self, body: bytes) -> bytes:
        self.need(len(body) == 4, 3)
        address, value = struct.unpack(">HH", body)
        self.need(value in (0, 0xFF00), 3)
        self.cells(self.bits[1], address, 1)
        self.bits[1][address] = int(value != 0)
        return body

    def function_6(self, body: bytes) -> bytes:
        self.need(len(body) == 4, 3)
        address, value = struct.unpack(">HH", body)
        self.cells(self.words[3], address, 1)
        self.words[3][address] = value
        return body

    def function_15(self, body: bytes) -> bytes:
        self.need(len(body) >= 5, 3)
        start, count, size = struct.unpack(">HHB", body[:5])
        data = body[5:]
        self.need(1 <= count <= 1968 and size == -(-count // 8) == len(data), 3)
        for at, cell in enumerate(self.cells(self.bits[1], start, count)):
            self.bits[1][cell] = data[at // 8] >> at % 8 & 1
        return body[:4]

    def write_words(self, start: int, data: bytes) -> None:
        for at, cell in enumerate(self.cells(self.words[3], start, len(data) // 2)):
            self.words[3][cell] = int.from_bytes(data[2 * at : 2 * at + 2], "big")

    def function_16(self, body: bytes) -> bytes:
        self.need(len(body) >= 5, 3)
        start, count, size = struct.unpack(">HHB", body[:5])
        self.need(1 <= count <= 123 and size == 2 * count == len(body) - 5, 3)
        self.write_words(start, body[5:])
        return body[:4]

    def function_22(self, body: bytes) -> bytes:
        self.need(len(body) == 6, 3)
        address, and_mask, or_mask = struct.unpack(">HHH", body)
        self.cells(self.words[3], address, 1)
        current = self.words[3][address]
        self.words[3][address] = (current & and_mask) | (or_mask & ~and_mask & 0xFFFF)
        return body

    def function_23(self, body: bytes) -> bytes:
        self.need(len(body) >= 9, 3)
        start, count, to, written, size = struct.unpack(">HHHHB", body[:9])
        self.need(1 <= count <= 125 and 1 <= written <= 121, 3)
        self.need(size == 2 * written == len(body) - 9, 3)
        self.cells(self.words[3], start, count)
        self.write_words(to, body[9:])
        return self.read_words(self.words[3], start, count)

    def place(self, kind: int, file: int, record: int, length: int) -> dict[int, int]:
        self.need(kind == 6 and file in self.files, 2)
        self.cells(self.files[file], record, length)
        return self.files[file]

    def function_20(self, body: bytes) -> bytes:
        self.need(len(body) >= 1 and body[0] == len(body) - 1, 3)
        self.need(7 <= body[0] <= 0xF5 and body[0] % 7 == 0, 3)
        subs = [struct.unpack_from(">BHHH", body, at) for at in range(1, len(body), 7)]
        self.need(all(length for *_, length in subs), 3)
        self.need(sum(2 + 2 * length for *_, length in subs) <= 0xF5, 3)
        answer = b""
        for kind, file, record, length in subs:
            records = self.place(kind, file, record, length)
            answer += bytes([1 + 2 * length, 6]) + b"".join(
                records[at].to_bytes(2, "big") for at in range(record, record + length)
            )
        return bytes([len(answer)]) + answer

    def function_21(self, body: bytes) -> bytes:
        self.need(len(body) >= 1 and body[0] == len(body) - 1 and 9 <= body[0] <= 0xFB, 3)
        subs, at = [], 1
        while at < len(body):
            self.need(at + 7 <= len(body), 3)
            kind, file, record, length = struct.unpack_from(">BHHH", body, at)
            data = body[at + 7 : at + 7 + 2 * length]
            self.need(length >= 1 and len(data) == 2 * length, 3)
            subs.append((kind, file, record, struct.unpack(f">{length}H", data)))
            at += 7 + 2 * length
        places = [self.place(*sub[:3], len(sub[3])) for sub in subs]
        for records, (_, _, record, values) in zip(places, subs, strict=True):
            records.update(enumerate(values, start=record))
        return body


KNOWN = sorted(int(name.removeprefix("function_")) for name in dir(Model) if "function_" in name)


def new_device() -> Device:
    mapping = Mapping(
        coils=BITS[1],
        discrete_inputs=BITS[2],
        holding_registers=REGISTERS[3],
        input_registers=REGISTERS[4],
    )
    return Device(mapping, files=FILES)


def contents(device: Device) -> dict[str, Any]:
    """Everything a client could change."""
    mapping = device.mapping
    return {
        "coils": mapping.coils[:],
        "discrete_inputs": mapping.discrete_inputs[:],
        "holding_registers": mapping.holding_registers[:],
        "input_registers": mapping.input_registers[:],
    } | {f"file {number}": list(file) for number, file in device.files.items()}


def contents_of_model(model: Model) -> dict[str, Any]:
    return {
        "coils": list(model.bits[1].values()),
        "discrete_inputs": list(model.bits[2].values()),
        "holding_registers": list(model.words[3].values()),
        "input_registers": list(model.words[4].values()),
    } | {f"file {number}": list(records.values()) for number, records in model.files.items()}


def words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}H", *values)


# --- differential -----------------------------------------------------------------------

edges = st.sampled_from(
    sorted(
        {
            max(0, min(65535, edge + off))
            for addresses in (*BITS.values(), *REGISTERS.values())
            for edge in (addresses.start, addresses.stop)
            for off in (-2, -1, 0, 1)
        }
        | {0, 300, 65534, 65535}
    )
)
inside = st.integers(100, 399)
addresses = inside | edges
counts = st.integers(1, 20) | st.sampled_from([0, 1, 99, 100, 121, 122, 123, 124, 125, 126, 65535])
bit_counts = counts | st.sampled_from([1967, 1968, 1969, 1999, 2000, 2001])
word = st.integers(0, 65535)


def lied(body: bytes, at: int, draw: st.DrawFn) -> bytes:
    """Sometimes with another byte count at `at`, sometimes shorter or longer than it says."""
    match draw(st.integers(0, 11)):
        case 0:
            return body[:at] + bytes([draw(st.integers(0, 255))]) + body[at + 1 :]
        case 1:
            return body[: draw(st.integers(0, len(body)))]
        case 2:
            return body + draw(st.binary(min_size=1, max_size=3))
        case _:
            return body


@st.composite
def request_pdus(draw: st.DrawFn) -> bytes:
    code = draw(st.sampled_from(KNOWN))
    if code <= 4:
        body = words(draw(addresses), draw(bit_counts if code < 3 else counts))
    elif code == 5:
        body = words(draw(addresses), draw(st.sampled_from([0, 0xFF00, 0xFF00, 1, 0xFF])))
    elif code == 6:
        body = words(draw(addresses), draw(word))
    elif code == 15:
        count = draw(bit_counts)
        size = -(-count // 8) & 0xFF
        pattern = draw(st.binary(min_size=1, max_size=8))
        body = words(draw(addresses), count) + bytes([size]) + (pattern * 246)[: min(size, 246)]
    elif code == 16:
        values = draw(st.lists(word, max_size=6)) * draw(st.sampled_from([1, 1, 20]))
        values = values[:123]
        body = words(draw(addresses), len(values)) + bytes([2 * len(values)]) + words(*values)
    elif code == 20:
        subs = draw(st.lists(pieces(), min_size=0, max_size=4))
        body = b"".join(struct.pack(">BHHH", *sub) for sub in subs)
        body = bytes([len(body)]) + body
    elif code == 21:
        subs = draw(st.lists(pieces(8), min_size=0, max_size=4))
        body = b"".join(
            struct.pack(">BHHH", *sub) + (draw(st.binary(min_size=2, max_size=2)) * sub[3])
            for sub in subs
        )
        body = bytes([len(body)]) + body
    elif code == 22:
        body = words(draw(addresses), draw(word), draw(word))
    else:
        values = draw(st.lists(word, max_size=6)) * draw(st.sampled_from([1, 1, 20]))
        body = words(draw(addresses), draw(counts), draw(addresses), len(values))
        body += bytes([2 * len(values)]) + words(*values)
    count_at = {15: 4, 16: 4, 20: 0, 21: 0, 23: 8}.get(code, 1)
    return (bytes([code]) + lied(body, count_at, draw))[: pdu.MAX_PDU]


@st.composite
def pieces(draw: st.DrawFn, most: int = 125) -> tuple[int, int, int, int]:
    return (
        draw(st.sampled_from([6] * 9 + [5])),
        draw(st.sampled_from([3, 4, 4, 4, 65535, 0, 5])),
        draw(st.sampled_from([0, 1, 7, 9, 10, 11, 12, 9990, 9999, 10_000, 65535])),
        draw(st.sampled_from([1, 1, 2, 3, 0, min(most, 8), min(most, 121), most])),
    )


class TestAgainstTheModel:
    def test_the_model_knows_the_twelve_functions(self) -> None:
        assert KNOWN == [1, 2, 3, 4, 5, 6, 15, 16, 20, 21, 22, 23]

    @settings(max_examples=120, deadline=None)
    @given(st.lists(request_pdus(), min_size=1, max_size=12))
    def test_answers_and_contents_are_the_same(self, requests: list[bytes]) -> None:
        device, model = new_device(), Model()
        # Discrete inputs and input registers are the device's own to set.
        device.mapping.discrete_inputs[20:30] = [1] * 10
        device.mapping.input_registers[200:400] = range(200)
        model.bits[2].update(dict.fromkeys(range(20, 30), 1))
        model.words[4].update(zip(range(200, 400), range(200), strict=True))
        for request in requests:
            assert device.answer(request).hex(" ") == model.answer(request).hex(" ")
        assert contents(device) == contents_of_model(model)

    @settings(max_examples=150, deadline=None)
    @given(
        st.builds(
            lambda code, body: bytes([code]) + body,
            st.sampled_from(KNOWN) | st.integers(128, 255),
            st.binary(max_size=252),
        )
    )
    def test_noise_gets_the_same_answer(self, request_pdu: bytes) -> None:
        device, model = new_device(), Model()
        assert device.answer(request_pdu).hex(" ") == model.answer(request_pdu).hex(" ")
        assert contents(device) == contents_of_model(model)


class TestWorkedExamples:
    @pytest.mark.parametrize(
        "vector",
        rows([vector for vector in RESPONSES if vector.request and vector.function in KNOWN]),
    )
    def test_answer_is_that_of_the_example(self, vector: FrameVector) -> None:
        """On a device that holds what the example's response says."""
        (asked,) = (each for each in REQUESTS if each.id == vector.request)
        mapping = Mapping(*[65536] * 4)
        device = Device(mapping, files={3: range(20), 4: range(20)})
        fields = asked.fields
        start = fields.get("address", fields.get("read_address"))
        values = vector.fields.get("values")
        tables = {
            1: mapping.coils,
            2: mapping.discrete_inputs,
            3: mapping.holding_registers,
            4: mapping.input_registers,
            23: mapping.holding_registers,
        }
        if vector.function in tables:
            tables[vector.function][start : start + len(values)] = values
        if vector.function == 20:
            for wanted, piece in zip(
                fields["sub_requests"], vector.fields["sub_responses"], strict=True
            ):
                for at, value in enumerate(piece["values"]):
                    device.files[wanted["file"]][wanted["record"] + at] = value
        assert device.answer(asked.pdu) == vector.pdu

    @pytest.mark.parametrize("vector", rows([each for each in EXCEPTIONS if each.request]))
    def test_refusal_is_that_of_the_example(self, vector: FrameVector) -> None:
        (asked,) = (each for each in REQUESTS if each.id == vector.request)
        assert Device(Mapping(0, 0, 2048, 0)).answer(asked.pdu) == vector.pdu

    def test_writes_of_the_examples_arrive(self) -> None:
        mapping = Mapping(64, 0, 400, 0)
        device = Device(mapping, files={4: [0] * 20})
        device.answer(bytes.fromhex("0F0013000A02CD01"))
        assert mapping.coils[19:29] == [
            value == 1 for value in (1, 0, 1, 1, 0, 0, 1, 1, 1, 0)
        ]  # section 6.11
        device.answer(bytes.fromhex("100001000204000A0102"))
        assert mapping.holding_registers[0:4] == [0, 10, 258, 0]  # section 6.12
        device.answer(bytes.fromhex("150D0600040007000306AF04BE100D"))
        assert list(device.files[4])[6:11] == [0, 1711, 1214, 4109, 0]  # section 6.15
        mapping.holding_registers[4] = 0x12
        device.answer(bytes.fromhex("16000400F20025"))
        assert mapping.holding_registers[4] == 0x17  # section 6.16


class TestExceptions:
    def test_function_0_is_illegal(self) -> None:
        assert new_device().answer(b"\0") == b"\x80\1"
        assert new_device().answer(b"\0\0\0\0\1") == b"\x80\1"

    def test_unknown_functions_are_illegal(self) -> None:
        device = new_device()
        for code in set(range(128)) - set(pdu.REQUESTS):
            for body in (b"", b"\0\0\0\1"):
                assert device.answer(bytes([code]) + body) == bytes([code | 0x80, 1])

    def test_codes_from_128_on_get_no_answer(self) -> None:
        device = new_device()
        for code in range(128, 256):
            for body in (b"", b"\2", b"\0\0\0\1"):
                assert device.answer(bytes([code]) + body) == b""

    @pytest.mark.parametrize(
        ("request_pdu", "code"),
        [
            # Section 6: quantity and constants before addresses, the length before all.
            (b"\x01" + words(0, 0), 3),
            (b"\x01" + words(0, 2001), 3),
            (b"\x01" + words(0, 1), 2),
            (b"\x01" + words(0, 1) + b"\0", 3),
            (b"\x02" + words(65535, 2001), 3),
            (b"\x02" + words(65535, 2), 2),
            (b"\x02" + words(2099, 2), 2),
            (b"\x03" + words(0, 126), 3),
            (b"\x03" + words(399, 2), 2),
            (b"\x03" + words(99, 2), 2),
            (b"\x04" + words(199, 126), 3),
            (b"\x04" + words(199, 2), 2),
            (b"\x05" + words(0, 1), 3),
            (b"\x05" + words(0, 0), 2),
            (b"\x05" + words(0, 0xFF00), 2),
            (b"\x05" + words(2100, 0x00FF), 3),
            (b"\x06" + words(0, 1), 2),
            (b"\x06" + words(0, 1) + b"\0", 3),
            (b"\x0f" + words(0, 8) + b"\2\0\0", 3),
            (b"\x0f" + words(0, 8) + b"\1\0", 2),
            (b"\x0f" + words(2099, 2) + b"\1\0", 2),
            (b"\x10" + words(0, 1) + b"\4" + words(1, 2), 3),
            (b"\x10" + words(0, 1) + b"\2" + words(1), 2),
            (b"\x10" + words(399, 2) + b"\4" + words(1, 2), 2),
            (b"\x16" + words(0, 1, 1), 2),
            (b"\x16" + words(0, 1), 3),
            (b"\x17" + words(0, 0, 0, 1) + b"\2" + words(1), 3),
            (b"\x17" + words(0, 1, 100, 1) + b"\2" + words(1), 2),
            (b"\x17" + words(100, 1, 0, 1) + b"\2" + words(1), 2),
            (b"\x17" + words(0, 126, 0, 1) + b"\2" + words(1), 3),
        ],
        ids=lambda value: value.hex() if isinstance(value, bytes) else str(value),
    )
    def test_order_of_checks(self, request_pdu: bytes, code: int) -> None:
        device = new_device()
        before = contents(device)
        assert device.answer(request_pdu) == bytes([request_pdu[0] | 0x80, code])
        assert contents(device) == before

    def test_refused_read_write_writes_nothing(self) -> None:
        device = new_device()
        before = contents(device)
        assert device.answer(b"\x17" + words(399, 2, 100, 1) + b"\2" + words(7)) == b"\x97\2"
        assert contents(device) == before

    def test_read_write_writes_first(self) -> None:
        device = new_device()
        answer = device.answer(b"\x17" + words(100, 3, 101, 1) + b"\2" + words(7))
        assert answer == b"\x17\6" + words(0, 7, 0)

    @settings(max_examples=100, deadline=None)
    @given(
        code=st.sampled_from([15, 16, 20, 21, 23]),
        count=st.integers(0, 65535),
        size=st.integers(0, 255),
        data=st.binary(max_size=40),
    )
    def test_lying_byte_counts_change_nothing(
        self, code: int, count: int, size: int, data: bytes
    ) -> None:
        head = words(100, 1) if code == 23 else b""
        head += b"" if code in (20, 21) else words(100, count)
        if size == len(data):
            size ^= 1
        device = new_device()
        before = contents(device)
        answer = device.answer(bytes([code]) + head + bytes([size]) + data)
        assert answer == bytes([code | 0x80, 3])
        assert contents(device) == before


class TestFiles:
    @staticmethod
    def read(*subs: tuple[int, int, int]) -> bytes:
        return pdu.ReadFileRecords(subs).encode()

    @staticmethod
    def write(*subs: tuple[int, int, list[int]]) -> bytes:
        return pdu.WriteFileRecords(subs).encode()

    def test_holes_are_no_records(self) -> None:
        device = Device(Mapping(), files={3: {9: 0x33CD, 10: 0x0040, 12: 7}})
        assert device.answer(self.read((3, 9, 2))) == bytes.fromhex("140605 0633CD0040")
        assert device.answer(self.read((3, 12, 1))) == b"\x14\4\3\6\0\7"
        for sub in ((3, 8, 1), (3, 8, 2), (3, 9, 3), (3, 11, 1), (3, 12, 2), (3, 13, 1), (3, 0, 1)):
            assert device.answer(self.read(sub)) == b"\x94\2"
            assert device.answer(self.write((*sub[:2], [1] * sub[2]))) == b"\x95\2"
        assert device.answer(self.read((2, 9, 1))) == b"\x94\2"
        assert list(device.files[3]) == [0x33CD, 0x0040, 7]

    def test_writes_are_all_or_nothing(self) -> None:
        device = Device(Mapping(), files={1: [0] * 10, 2: [0] * 10})
        for last in ((2, 9, [5, 5]), (3, 0, [5]), (2, 10, [5])):
            answer = device.answer(self.write((1, 0, [1, 2]), (2, 3, [3]), last))
            assert answer == b"\x95\2"
            assert list(device.files[1]) + list(device.files[2]) == [0] * 20
        request = self.write((1, 0, [1, 2]), (2, 3, [3]), (1, 1, [9]))
        assert device.answer(request) == request
        assert list(device.files[1]) == [1, 9, 0, 0, 0, 0, 0, 0, 0, 0]
        assert list(device.files[2]) == [0, 0, 0, 3, 0, 0, 0, 0, 0, 0]

    def test_files_end_with_record_9999(self) -> None:
        device = Device(Mapping(), files={1: range(10_000)})
        assert device.answer(self.read((1, 9999, 1))) == b"\x14\4\3\6\x27\x0f"
        assert device.answer(b"\x14\7\6" + words(1, 9999, 2)) == b"\x94\2"
        assert device.answer(b"\x14\7\6" + words(1, 10_000, 1)) == b"\x94\2"

    def test_answers_end_with_245_bytes(self) -> None:
        device = Device(Mapping(), files={1: range(10_000)})
        answer = device.answer(self.read((1, 0, 121)))
        assert len(answer) == 2 + 244
        assert answer[1:4] == bytes([244, 243, 6])
        assert device.answer(self.read((1, 0, 122))) == b"\x94\3"
        assert len(device.answer(self.read((1, 0, 60), (1, 0, 60)))) == 2 + 244
        assert device.answer(self.read((1, 0, 60), (1, 0, 61))) == b"\x94\3"
        assert len(device.answer(self.read(*[(1, 0, 1)] * 35))) == 2 + 140

    def test_largest_write_arrives(self) -> None:
        device = Device(Mapping(), files={1: [0] * 200})
        request = self.write((1, 50, list(range(1, 123))))
        assert len(request) == 253
        assert device.answer(request) == request
        assert list(device.files[1])[49:173] == [0, *range(1, 123), 0]

    def test_record_file_is_indexed_by_record(self) -> None:
        file = RecordFile({9: 1, 12: 2})
        file[9] = 65535
        assert (file[9], file[12], len(file), list(file)) == (65535, 2, 2, [65535, 2])
        for record in (0, 10, 13, 9999, 10_000, -1, -4):
            with pytest.raises(IndexError):
                file[record]
            with pytest.raises(IndexError):
                file[record] = 1
        for bad in (-1, 65536):
            with pytest.raises(ValueError, match="value"):
                file[9] = bad
        with pytest.raises(TypeError, match="value"):
            file[9] = "1"  # type: ignore[assignment]
        assert list(RecordFile([5, 6])) == [5, 6]
        assert list(RecordFile([])) == list(RecordFile({})) == []

    @pytest.mark.parametrize(
        ("files", "error", "name"),
        [
            ({0: []}, ValueError, "file"),
            ({65536: []}, ValueError, "file"),
            ({"1": []}, TypeError, "file"),
            ({1: {-1: 0}}, ValueError, "record"),
            ({1: {10_000: 0}}, ValueError, "record"),
            ({1: {"1": 0}}, TypeError, "record"),
            ({1: [0] * 10_001}, ValueError, "record"),
            ({1: [65536]}, ValueError, "value"),
            ({1: [-1]}, ValueError, "value"),
            ({1: [None]}, TypeError, "value"),
        ],
        ids=lambda value: str(value)[:30],
    )
    def test_bad_files_are_refused_by_name(
        self, files: Any, error: type[Exception], name: str
    ) -> None:
        with pytest.raises(error, match=f"^{name} must be "):
            Device(Mapping(), files=files)

    def test_mapping_must_be_one(self) -> None:
        for bad in (None, {}, 5):
            with pytest.raises(TypeError, match="mapping must be a Mapping"):
                Device(bad)  # type: ignore[arg-type]

    def test_devices_may_share_a_mapping(self) -> None:
        mapping = Mapping(holding_registers=1)
        Device(mapping).answer(b"\x06" + words(0, 5))
        assert Device(mapping).answer(b"\x03" + words(0, 1)) == b"\x03\2\0\5"


class Broken(RecordFile):
    def has(self, record: int, length: int) -> bool:
        raise ZeroDivisionError("a bug of the application")


class TestFailures:
    def test_bug_is_answered_4_and_logged_once_for_each_function(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        device = Device(Mapping(holding_registers=1))
        device.files[1] = Broken([1])
        read = pdu.ReadFileRecords([(1, 0, 1)]).encode()
        write = pdu.WriteFileRecords([(1, 0, [1])]).encode()
        with caplog.at_level(logging.DEBUG):
            for _ in range(3):
                assert device.answer(read) == b"\x94\4"
                assert device.answer(write) == b"\x95\4"
        assert [record.levelno for record in caplog.records] == [logging.ERROR] * 2
        assert read.hex(" ") in caplog.records[0].getMessage()
        assert write.hex(" ") in caplog.records[1].getMessage()
        for record in caplog.records:
            assert record.exc_info
            assert record.exc_info[0] is ZeroDivisionError
            assert record.name.startswith("libmodbus_py")
        assert device.answer(b"\x03" + words(0, 1)) == b"\x03\2\0\0"

    def test_other_device_logs_its_own_bug(self, caplog: pytest.LogCaptureFixture) -> None:
        for _ in range(2):
            device = Device(Mapping())
            device.files[1] = Broken([1])
            assert device.answer(pdu.ReadFileRecords([(1, 0, 1)]).encode()) == b"\x94\4"
        assert len(caplog.records) == 2

    def test_bug_leaves_the_mapping_free(self, caplog: pytest.LogCaptureFixture) -> None:
        device = Device(Mapping(holding_registers=1))
        device.files[1] = Broken([1])
        device.answer(pdu.ReadFileRecords([(1, 0, 1)]).encode())
        answers: list[bytes] = []
        thread = threading.Thread(
            target=lambda: answers.append(device.answer(b"\x03" + words(0, 1))), daemon=True
        )
        thread.start()
        thread.join(10)
        assert answers == [b"\x03\2\0\0"]
        assert len(caplog.records) == 1

    def test_failure_of_the_engine_is_answered_4(
        self, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        device = new_device()

        def fail() -> None:
            raise OSError("no descriptor left")

        with monkeypatch.context() as patch:
            patch.setattr(device_module, "_engine", fail)
            assert device.answer(b"\x03" + words(100, 1)) == b"\x83\4"
            assert device.answer(b"\x03" + words(0, 1, 1)) == b"\x83\3"
        assert device.answer(b"\x03" + words(100, 1)) == b"\x03\2\0\0"
        assert len(caplog.records) == 1

    def test_interrupted_answer_is_not_given_to_the_next_request(self) -> None:
        """Ctrl-C between libmodbus's reply and its reception."""
        device = new_device()
        device.mapping.holding_registers[100:102] = [1, 2]
        answers: list[Any] = []

        class Interrupted:
            def __init__(self, outer: Any) -> None:
                self._outer = outer

            def recv(self, size: int) -> bytes:
                raise KeyboardInterrupt

            def close(self) -> None:
                self._outer.close()

        def work() -> None:
            engine = device_module._engine()
            engine._outer = Interrupted(engine._outer)  # type: ignore[assignment]
            for address in (100, 101, 100):
                try:
                    answers.append(device.answer(b"\x03" + words(address, 1)))
                except KeyboardInterrupt:
                    answers.append("interrupted")

        thread = threading.Thread(target=work)  # which has an engine of its own
        thread.start()
        thread.join()
        assert answers == ["interrupted", b"\x03\2\0\2", b"\x03\2\0\1"]


@pytest.fixture
def quick_switches() -> Iterator[None]:
    """Let threads take turns within one answer, not only between answers."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


class TestThreadsAndForks:
    @pytest.mark.parametrize("devices", [1, 4])
    def test_threads_get_their_own_answers(self, devices: int, quick_switches: None) -> None:
        """Of one device, whose lock they share, and of their own, where no lock helps."""
        made = [new_device() for _ in range(devices)]
        wrong: list[Any] = []

        def work(number: int) -> None:
            device = made[number % devices]
            address = 100 + number
            for turn in range(400):
                write = b"\x06" + words(address, turn)
                read = b"\x03" + words(address, 1)
                if device.answer(write) != write:
                    wrong.append(("write", number, turn))
                if device.answer(read) != b"\x03\2" + words(turn):
                    wrong.append(("read", number, turn))
                if device.answer(b"\x03" + words(0, 1)) != b"\x83\2":
                    wrong.append(("refusal", number, turn))

        threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert wrong == []

    def test_no_reader_sees_half_a_write(self, quick_switches: None) -> None:
        """Neither half of a run of registers nor one of two pieces of a file."""
        device = new_device()
        stop = threading.Event()
        mixed: list[Any] = []

        def write() -> None:
            turn = 0
            while not stop.is_set():
                turn = (turn + 1) & 0xFFFF
                device.answer(b"\x10" + words(100, 100) + bytes([200]) + words(*[turn] * 100))
                device.answer(two_pieces(turn).encode())

        def two_pieces(turn: int) -> pdu.WriteFileRecords:
            return pdu.WriteFileRecords([(4, 0, [turn] * 2), (4, 100, [turn] * 2)])

        def read_registers() -> None:
            for _ in range(400):
                values = device.answer(b"\x03" + words(100, 100))[2:]
                if values != values[:2] * 100:
                    mixed.append(values)

        def read_table() -> None:
            for _ in range(400):
                values = device.mapping.holding_registers[100:200]
                if len(set(values)) != 1:
                    mixed.append(values)

        def read_file() -> None:
            request = pdu.ReadFileRecords([(4, 0, 2), (4, 100, 2)])
            for _ in range(400):
                first, second = request.decode_response(device.answer(request.encode()))
                if first != second:
                    mixed.append((first, second))

        device.answer(two_pieces(0).encode())
        writer = threading.Thread(target=write)
        readers = [
            threading.Thread(target=read) for read in (read_registers, read_table, read_file)
        ]
        for thread in (writer, *readers):
            thread.start()
        for thread in readers:
            thread.join()
        stop.set()
        writer.join()
        assert mixed == []

    def test_child_and_parent_answer_after_a_fork(self) -> None:
        script = """
import os, struct
from libmodbus_py import Device, Mapping

device = Device(Mapping(holding_registers=4))
READ = b"\\3\\0\\0\\0\\2"

def write(address, value):
    request = b"\\6" + struct.pack(">HH", address, value)
    assert device.answer(request) == request, request

write(0, 1)
children = []
for number in range(3):
    child = os.fork()
    if not child:
        try:
            for turn in range(200):
                write(1, turn)
                answer = device.answer(READ)
                assert answer[:2] == b"\\3\\4", answer
            os._exit(0)
        finally:
            os._exit(1)
    children.append(child)
for turn in range(200):
    write(0, turn)
    answer = device.answer(READ)
    assert answer[:4] == b"\\3\\4" + struct.pack(">H", turn), answer
assert [os.waitpid(child, 0)[1] for child in children] == [0, 0, 0]
write(0, 7)
assert device.answer(READ)[:4] == b"\\3\\4\\0\\7"
print("good")
"""
        run = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, timeout=50, check=False
        )
        assert (run.stdout, run.stderr) == ("good\n", "")
