"""
Captures of a network: Modbus/TCP in pcap and pcapng files of any kind, written here by hand from
the published formats, and put together from segments that came twice, late, cut or not at all.
"""

import random
import struct
from collections.abc import Sequence
from pathlib import Path

import pytest

from libmodbus_py.listen import CaptureError, Transaction, listen
from tests.support.cases import each_case

CLIENT, SERVER = bytes([192, 0, 2, 1]), bytes([192, 0, 2, 9])
CLIENT_6, SERVER_6 = bytes([0x20, 1, *bytes(13), 1]), bytes([0x20, 1, *bytes(13), 9])

# The example of the application protocol, 6.3, behind an MBAP header; and one of 6.1.
ASKED = bytes.fromhex("0001 0000 0006 01 03 006B 0003")
ANSWERED = bytes.fromhex("0001 0000 0009 01 03 06 022B 0000 0064")
ASKED_2 = bytes.fromhex("0002 0000 0006 01 01 0013 0013")
ANSWERED_2 = bytes.fromhex("0002 0000 0006 01 01 03 CD 6B 05")

LINES = [
    "unit 1: ReadHoldingRegisters(address=107, count=3) -> [555, 0, 100]",
    "unit 1: ReadCoils(address=19, count=19) -> [True, False, True, True, False, False, True, True,"
    " True, True, False, True, False, True, True, False, True, False, True]",
]


def tcp(
    data: bytes,
    number: int,
    *,
    asks: bool,
    flags: int = 0x08,
    ports: tuple[int, int],
    acknowledged: int = 0,
) -> bytes:
    ends = ports if asks else ports[::-1]
    return (
        struct.pack(">HHIIBBHHH", *ends, number & 0xFFFFFFFF, acknowledged, 0x50, flags, 512, 0, 0)
        + data
    )


def ip(data: bytes, *, asks: bool, total: int | None = None) -> bytes:
    ends = CLIENT + SERVER if asks else SERVER + CLIENT
    length = 20 + len(data) if total is None else total
    return struct.pack(">BBHHHBBH", 0x45, 0, length, 7, 0x4000, 64, 6, 0) + ends + data


def ip_6(data: bytes, *, asks: bool) -> bytes:
    """A packet with a header of options of 16 bytes between."""
    ends = CLIENT_6 + SERVER_6 if asks else SERVER_6 + CLIENT_6
    options = bytes([6, 1, 1, 12, *bytes(12)])
    head = struct.pack(">IHBB", 0x60000000, len(options) + len(data), 0, 64)
    return head + ends + options + data


def packet(
    data: bytes,
    number: int,
    *,
    asks: bool,
    flags: int = 0x08,
    ports: tuple[int, int] = (50000, 502),
) -> bytes:
    return ip(tcp(data, number, asks=asks, flags=flags, ports=ports), asks=asks)


def pcap(
    packets: Sequence[bytes], link: int = 101, order: str = "<", *, nanos: bool = False
) -> bytes:
    """A file with a packet each millisecond from 1 700 000 000 on."""
    magic, unit = (0xA1B23C4D, 1_000_000) if nanos else (0xA1B2C3D4, 1000)
    data = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)
    for at, packet in enumerate(packets):
        head = (1_700_000_000, at * unit, len(packet), len(packet))
        data += struct.pack(order + "IIII", *head) + packet
    return data


def pcapng(packets: Sequence[bytes], link: int, order: str, resolution: int) -> bytes:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        size = struct.pack(order + "I", 12 + len(body))
        return struct.pack(order + "I", kind) + size + body + size

    ticks = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    options = struct.pack(order + "HHB3xHH", 9, 1, resolution, 0, 0)
    data = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    data += block(1, struct.pack(order + "HHI", link, 0, 0) + options)
    for at, packet in enumerate(packets):
        time = 1_700_000_000 * ticks + at * ticks // 1000
        head = (0, time >> 32, time & 0xFFFFFFFF, len(packet), len(packet))
        data += block(6, struct.pack(order + "IIIII", *head) + packet)
    return data


def read(path: Path) -> list[Transaction]:
    with listen(str(path)) as capture:
        return list(capture)


def read_of(tmp_path: Path, packets: Sequence[bytes]) -> list[str]:
    path = tmp_path / "x.pcap"
    path.write_bytes(pcap(packets))
    return [str(packet) for packet in read(path)]


TWO = [
    packet(ASKED, 100, asks=True),
    packet(ANSWERED, 900, asks=False),
    packet(ASKED_2, 112, asks=True),
    packet(ANSWERED_2, 915, asks=False),
]

ETHERNET = bytes(12)


@each_case(
    ("link", "head"),
    [
        (0, b"\2\0\0\0"),
        (1, ETHERNET + b"\x08\0"),
        (1, ETHERNET + b"\x81\0\0\7\x08\0"),
        (101, b""),
        (108, b"\0\0\0\2"),
        (113, bytes(14) + b"\x08\0"),
        (228, b""),
        (276, b"\x08\0" + bytes(18)),
    ],
)
def test_captures_of_each_link_type_are_decoded(link: int, head: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    other = ETHERNET + b"\x08\x06" + bytes(28) if link == 1 else b""  # ARP, or nothing
    path.write_bytes(pcap([head + entry for entry in TWO] + [other], link))
    assert [str(packet) for packet in read(path)] == LINES


@each_case("order", ["<", ">"])
def test_captures_of_each_byte_order_and_resolution_are_decoded(order: str, tmp_path: Path) -> None:
    files = [pcap(TWO, 101, order, nanos=nanos) for nanos in (False, True)]
    files += [pcapng(TWO, 101, order, resolution) for resolution in (3, 6, 9, 0x8A)]
    for data in files:
        path = tmp_path / "x.pcapng"  # the name says nothing
        path.write_bytes(data)
        first, second = read(path)
        assert [str(first), str(second)] == LINES
        assert (first.time, second.time) == pytest.approx((1.7e9, 1.7e9 + 0.002), abs=1e-3)
        assert first.duration == pytest.approx(0.001, abs=1e-3)


def test_ipv6_with_an_extension_header_is_decoded(tmp_path: Path) -> None:
    packets = [
        ip_6(tcp(ASKED, 1, asks=True, ports=(50000, 502)), asks=True),
        ip_6(tcp(ANSWERED, 1, asks=False, ports=(50000, 502)), asks=False),
    ]
    assert read_of(tmp_path, packets) == LINES[:1]


SYN = packet(b"", 2**32 - 6, asks=True, flags=0x02, ports=(1024, 60502))
SYN_ACK = packet(b"", 4, asks=False, flags=0x12, ports=(1024, 60502))


def ask(data: bytes, number: int) -> bytes:
    return packet(data, number, asks=True, ports=(1024, 60502))


def answer(data: bytes, number: int) -> bytes:
    return packet(data, number, asks=False, ports=(1024, 60502))


FIRST = 2**32 - 5  # so that numbers begin again at 0 within a request

BOTH = ASKED + ASKED_2


@each_case(
    "packets",
    [
        # Several ADUs in a segment; one cut into bytes.
        [SYN, SYN_ACK, ask(BOTH, FIRST), answer(ANSWERED + ANSWERED_2, 5)],
        [
            *(SYN, SYN_ACK),
            *(ask(BOTH[at : at + 1], FIRST + at) for at in range(len(BOTH))),
            answer(ANSWERED + ANSWERED_2, 5),
        ],
        # Sent again: the same, longer, and after the response; each packet captured twice.
        [
            *(SYN, SYN, SYN_ACK, ask(ASKED, FIRST), ask(ASKED, FIRST), ask(BOTH, FIRST)),
            *(answer(ANSWERED, 5), ask(ASKED, FIRST), answer(ANSWERED + ANSWERED_2, 5)),
        ],
        # In another order.
        [
            *(SYN, SYN_ACK, ask(ASKED_2, FIRST + 12), ask(ASKED, FIRST)),
            *(answer(ANSWERED_2, 20), answer(ANSWERED, 5)),
        ],
        # A padded Ethernet frame, and a length of 0, as network cards that cut packets leave it.
        [SYN, SYN_ACK, ask(BOTH, FIRST) + bytes(6), answer(ANSWERED + ANSWERED_2, 5)],
        [
            *(SYN, SYN_ACK, ask(BOTH, FIRST)),
            answer(ANSWERED + ANSWERED_2, 5).replace(b"\x45\0\0\x43", b"\x45\0\0\0"),
        ],
        # Not from the beginning, and another protocol beside it.
        [
            packet(b"SSH-2.0-OpenSSH_9.2\r\n", 5, asks=True, ports=(4000, 22)),
            *(SYN, SYN_ACK, ask(ASKED[7:], FIRST), ask(BOTH, FIRST + 5)),
            answer(ANSWERED + ANSWERED_2, 5),
        ],
    ],
)
def test_tcp_segments_are_joined(packets: list[bytes], tmp_path: Path) -> None:
    assert sorted(read_of(tmp_path, packets)) == sorted(LINES)


def test_requests_are_paired_by_their_ids(tmp_path: Path) -> None:
    packets = [
        *(packet(ASKED, 100, asks=True), packet(ASKED_2, 112, asks=True)),
        *(packet(ANSWERED_2, 900, asks=False), packet(ANSWERED, 912, asks=False)),
    ]
    assert read_of(tmp_path, packets) == LINES[::-1]


def test_a_lost_segment_costs_its_transaction_only(tmp_path: Path) -> None:
    """Though each transaction has the same id, as of simple clients."""

    def segment(data: bytes, number: int, acknowledged: int, *, asks: bool) -> bytes:
        ports = (50000, 502)
        options = {"flags": 0x18, "ports": ports, "acknowledged": acknowledged}
        return ip(tcp(data, number, asks=asks, **options), asks=asks)  # type: ignore[arg-type]

    many = []
    for at in range(100):
        many.append(segment(ASKED, 100 + 12 * at, 900 + 15 * at, asks=True))
        many.append(segment(ANSWERED, 900 + 15 * at, 112 + 12 * at, asks=False))
    del many[21]
    unanswered = LINES[0].replace("[555, 0, 100]", "no answer")
    assert sorted(read_of(tmp_path, many)) == sorted([*99 * LINES[:1], unanswered])


def test_a_capture_has_each_kind_of_outcome(tmp_path: Path) -> None:
    refusal, other_unit = (
        bytes.fromhex("0001 0000 0003 01 83 02"),
        ANSWERED[:6] + b"\2" + ANSWERED[7:],
    )
    packets = [
        *(packet(ASKED, 100, asks=True), packet(refusal, 900, asks=False)),
        *(packet(ASKED, 112, asks=True), packet(other_unit, 909, asks=False)),
        packet(b"", 7, asks=True, flags=0x02),  # the port is used again
        *(packet(ASKED, 8, asks=True), packet(b"", 0, asks=False, flags=0x04)),
    ]
    lines = read_of(tmp_path, packets)
    assert [line.partition("-> ")[2] for line in lines] == [
        *("illegal data address (exception 2)", "unasked: " + repr(ANSWERED[8:])),
        *("no answer", "no answer"),
    ]


@each_case("seed", range(20))
def test_damaged_files_are_read_or_refused(seed: int, tmp_path: Path) -> None:
    choose = random.Random(seed)
    path = tmp_path / "x.pcap"
    for make in (pcap(TWO, 101), pcapng(TWO, 101, ">", 9)):
        for _ in range(20):
            data = bytearray(make)
            for _ in range(choose.randint(1, 20)):
                data[choose.randrange(len(data))] = choose.choice([0, 255, choose.randrange(256)])
            path.write_bytes(data[: choose.choice([None, choose.randrange(len(data))])])
            try:
                for packet in read(path):
                    str(packet)
            except CaptureError as error:
                assert str(error).startswith(str(path))  # noqa: PT017  # either is right


@each_case(
    ("data", "message"),
    [
        (pcap(TWO, 147), "packets of link type 147, not 0, 1, 12, 101, 108, 113, 228, 229, 252"),
        (pcap(TWO)[:-1], "byte [0-9]+: the file ends inside a block"),
        (pcap(TWO)[:30], "byte 24: the file ends inside a block"),
        (pcap(TWO)[:32] + b"\xff" * 8, "byte 24: a packet of 4294967295 bytes"),
    ],
)
def test_a_file_that_is_wrong_is_named(data: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=f"^{path}: .*{message}"):
        read(path)
