"""A second device, written from the specification with dicts alone."""

import struct

from tests.device.devices import BITS, FILES, REGISTERS


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
        bits = bytearray(-(-count // 8))
        for at, cell in enumerate(self.cells(table, start, count)):
            bits[at // 8] |= table[cell] << at % 8
        return bytes([len(bits)]) + bits

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
        start, count, to, quantity, size = struct.unpack(">HHHHB", body[:9])
        self.need(1 <= count <= 125 and 1 <= quantity <= 121, 3)
        self.need(size == 2 * quantity == len(body) - 9, 3)
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
