"""
Frames on the three kinds of lines: worked examples whole, in single bytes and glued together,
frames over TCP, and everything a line can do to framers.
"""

import time
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import (
    AsciiFramer,
    Frame,
    RtuFramer,
    TcpFramer,
    UdpFramer,
    crc16,
    lrc,
    make_framer,
)
from tests.support.cases import each_case
from tests.support.framing import (
    ALL_FRAMERS,
    READ,
    REFUSAL,
    AnyFramer,
    after_silence,
    ascii_frame,
    each_framer,
    mbap,
    pieces,
    rtu,
    single_bytes,
    take,
)
from tests.support.vectors import CHECKSUMS, FRAMES, Checksum, FrameVector, rows


def _role(vector: FrameVector) -> str:
    return "server" if vector.kind == "request" else "client"


LINES: dict[str, tuple[Callable[[FrameVector], Any], Callable[[FrameVector], bytes]]] = {
    "tcp": (lambda vector: TcpFramer(), lambda vector: vector.tcp),
    "rtu": (lambda vector: RtuFramer(_role(vector)), lambda vector: vector.rtu),  # type: ignore[arg-type]
    "ascii": (lambda vector: AsciiFramer(), lambda vector: vector.ascii),
}


def ends_with_silence(line: str, vector: FrameVector) -> bool:
    """Return True for RTU frames of functions that tell no length."""
    return line == "rtu" and (vector.pdu[:3] == b"\x08\0\0" or vector.pdu[:2] == b"\x2b\x0d")


@each_case("line", list(LINES))
@each_case("vector", rows(FRAMES))
class TestWorkedExamples:
    @staticmethod
    def parts(line: str, vector: FrameVector) -> tuple[AnyFramer, bytes, Frame]:
        make, form = LINES[line]
        frame = vector.tcp_frame if line == "tcp" else vector.frame
        return make(vector), form(vector), frame

    def test_a_frame_encodes_to_exactly_the_bytes(self, line: str, vector: FrameVector) -> None:
        framer, wire, frame = self.parts(line, vector)
        assert framer.encode(frame) == wire

    def test_a_frame_is_found_with_its_last_byte(self, line: str, vector: FrameVector) -> None:
        framer, wire, frame = self.parts(line, vector)
        *first, last = single_bytes(wire)
        for fed, byte in enumerate(first, start=1):
            assert framer.feed(byte) == []
            assert framer.pending == fed
        if ends_with_silence(line, vector):
            assert framer.feed(last) == []
            assert framer.silence() == [frame]
        else:
            assert framer.feed(last) == [frame]
        assert framer.pending == 0

    def test_a_frame_is_found_wherever_two_frames_are_cut(self, line: str, vector: FrameVector):
        framer, wire, frame = self.parts(line, vector)
        for cut in range(2 * len(wire) + 1):
            first, second = framer.feed((2 * wire)[:cut]), framer.feed((2 * wire)[cut:])
            if ends_with_silence(line, vector):
                assert not first + second
                second = framer.silence()
            else:
                assert len(first) == cut // len(wire)
            assert first + second == [frame] * 2


@each_case("checksum", rows(CHECKSUMS))
class TestChecksums:
    def test_crc_is_that_of_the_example(self, checksum: Checksum) -> None:
        assert crc16(checksum.data) == checksum.crc
        assert crc16(checksum.data).to_bytes(2, "little") == checksum.crc_on_the_wire

    def test_crc_over_a_frame_with_its_crc_is_0(self, checksum: Checksum) -> None:
        assert crc16(checksum.data + checksum.crc_on_the_wire) == 0

    def test_lrc_is_that_of_the_example(self, checksum: Checksum) -> None:
        assert lrc(checksum.data) == checksum.lrc
        assert lrc(checksum.data + bytes([checksum.lrc])) == 0


def test_checksums_of_no_bytes_are_their_initial_values() -> None:
    assert crc16(b"") == 0xFFFF
    assert lrc(b"") == 0


class TestMakeFramer:
    @pytest.mark.parametrize("role", ["client", "server"])
    def test_each_framing_has_its_framer(self, role: Any) -> None:
        kinds = {"tcp": TcpFramer, "udp": UdpFramer, "ascii": AsciiFramer, "rtu": RtuFramer}
        for framing, kind in kinds.items():
            assert type(make_framer(framing, role)) is kind  # type: ignore[arg-type]
        frame = REFUSAL if role == "client" else READ
        assert make_framer("rtu", role).feed(rtu(*frame[:2])) == [frame]

    def test_unknown_framings_and_roles_are_refused_by_name(self) -> None:
        for bad in ("tls", "", None, 1):
            with pytest.raises(ValueError, match=r"^framing must be"):
                make_framer(bad, "client")  # type: ignore[arg-type]
        for bad in ("master", "", None, 1):
            with pytest.raises(ValueError, match=r"^role must be"):
                make_framer("rtu", bad)  # type: ignore[arg-type]


class TestEncode:
    @each_framer
    @each_case(
        ("frame", "name"),
        [
            (Frame(-1, b"\3"), "unit"),
            (Frame(256, b"\3"), "unit"),
            (Frame(1, b""), "pdu"),
            (Frame(1, bytes(254)), "pdu"),
            (Frame(1, b"\3", -1), "transaction"),
            (Frame(1, b"\3", 65536), "transaction"),
        ],
    )
    def test_frames_that_cannot_exist_are_refused_by_name(
        self, make: Callable[[], AnyFramer], frame: Frame, name: str
    ) -> None:
        with pytest.raises(ValueError, match=f"^{name} must "):
            make().encode(frame)

    def test_only_tcp_frames_contain_the_transaction(self) -> None:
        frame = Frame(1, b"\3\0\0\0\1", 0xBEEF)
        assert TcpFramer().encode(frame)[:2] == b"\xbe\xef"
        assert RtuFramer("client").encode(frame) == rtu(1, frame.pdu)
        assert AsciiFramer().encode(frame) == ascii_frame(1, frame.pdu)


class TestTcp:
    good = mbap(7, 0, 6, 17, READ.pdu)
    frame = READ._replace(transaction=7)

    @pytest.mark.parametrize("protocol", [1, 256, 65535])
    def test_another_protocol_is_skipped(self, protocol: int) -> None:
        framer = TcpFramer()
        other = mbap(6, protocol, 6, 17, READ.pdu)
        frames, errors = take(framer, other + self.good)
        assert frames == [self.frame]
        assert len(errors) == 1
        assert "protocol" in str(errors[0])
        assert framer.in_step
        assert take(framer, self.good) == ([self.frame], [])

    @each_case("length", [0, 1, 255, 256, 65535])
    @each_case("protocol", [0, 1])
    def test_impossible_length_ends_the_stream(self, length: int, protocol: int) -> None:
        framer = TcpFramer()
        with pytest.raises(FrameError, match="length") as caught:
            framer.feed(mbap(7, protocol, length, 17, READ.pdu))
        assert caught.value.received.startswith(b"\0\7")
        assert not framer.in_step
        for data in (b"", self.good, self.good * 2, b"\0"):
            with pytest.raises(FrameError):
                framer.feed(data)
            assert framer.pending == 0

    def test_impossible_length_is_seen_with_the_sixth_byte(self) -> None:
        framer = TcpFramer()
        for byte in single_bytes(b"\0\1\0\0\0"):
            assert framer.feed(byte) == []
        with pytest.raises(FrameError):
            framer.feed(b"\0")

    def test_frames_before_the_end_of_the_stream_are_returned_first(self) -> None:
        framer = TcpFramer()
        assert framer.feed(self.good * 2 + mbap(8, 0, 0, 1, b"")) == [self.frame] * 2
        assert not framer.in_step
        for _ in range(3):
            with pytest.raises(FrameError):
                framer.feed(self.good)

    def test_silence_ends_no_frame_of_tcp(self) -> None:
        framer = TcpFramer()
        for byte in single_bytes(self.good[:-1]):
            assert framer.feed(byte) == []
            assert framer.silence() == []
        assert framer.feed(self.good[-1:]) == [self.frame]


PENDING = {TcpFramer: 260, RtuFramer: 264, AsciiFramer: 513}


streams = st.lists(
    st.binary(max_size=30)
    | st.sampled_from(
        [
            mbap(1, 0, 6, 17, READ.pdu),
            mbap(1, 1, 6, 17, READ.pdu),
            rtu(17, READ.pdu),
            rtu(17, b"\x41\x01"),
            rtu(17, b"\x08\0\0\xa5\x37"),
            rtu(17, b"\x18\0\x06\0\2\1\2\3\4"),
            rtu(17, b"\x2b\x0d\1"),
            rtu(17, b"\x2b\x0e\1\1\0\0\2\0\1a\1\1b")[:14],
            rtu(17, b"\x83\x02"),
            rtu(17, b"\x10\0\0\0\1\2\0\1")[:9],
            ascii_frame(17, READ.pdu),
            b":1103\r",
        ]
    ),
    max_size=8,
).map(b"".join)
cuts = st.lists(st.integers(0, 12), max_size=20)


class TestWhateverComes:
    @each_framer
    @settings(max_examples=60)
    @given(stream=streams, sizes=cuts, silences=st.sets(st.integers(0, 20)))
    def test_nothing_but_frame_errors_is_raised(
        self, make: Callable[[], AnyFramer], stream: bytes, sizes: list[int], silences: set[int]
    ) -> None:
        framer = make()
        for turn, piece in enumerate(pieces(stream, sizes)):
            frames, _ = take(framer, piece)
            if turn in silences:
                frames += after_silence(framer)
            for frame in frames:
                assert 0 <= frame.unit <= 255
                assert 1 <= len(frame.pdu) <= pdu.MAX_PDU
                assert type(frame.pdu) is bytes
            assert framer.pending <= PENDING[type(framer)]

    @each_framer
    @settings(max_examples=30)
    @given(
        unit=st.integers(0, 255),
        values=st.lists(st.integers(0, 65535), min_size=1, max_size=123),
        transaction=st.integers(0, 65535),
        sizes=cuts,
    )
    def test_a_frame_is_the_same_after_encoding_and_decoding(
        self,
        make: Callable[[], AnyFramer],
        unit: int,
        values: list[int],
        transaction: int,
        sizes: list[int],
    ) -> None:
        framer = make()
        if make is ALL_FRAMERS["rtu client"]:
            body = pdu.ReadHoldingRegisters(0, len(values)).encode_response(values)
        else:
            body = pdu.WriteRegisters(0, values).encode()
        frame = Frame(unit, body, transaction if isinstance(framer, TcpFramer) else 0)
        frames: list[Frame] = []
        for piece in pieces(framer.encode(frame) * 2, sizes):
            frames += framer.feed(piece)
        assert frames == [frame, frame]
        assert framer.pending == 0

    @each_case("size", [1, 300, 65536])
    @each_case(
        ("name", "pattern"),
        [
            ("rtu server", bytes.fromhex("01 10 00 00 00 7b f6")),
            ("rtu server", b"\x14"),
            ("rtu client", b"\x03\xab"),
            ("rtu client", bytes.fromhex("01 2b 0e 01 01 00 00 ff 00 00")),
            ("rtu client", b"\xab\x0e"),
            ("rtu server", b"\x11\x10\xff"),
            ("rtu server", b"\0\x08"),
            ("rtu server", b"\x2b\x0d"),
            ("ascii", b":\r"),
            ("ascii", b":1103006B00037F\r\n"),
            ("ascii", b"0"),
            ("tcp", bytes.fromhex("0001 0001 0002 0103")),
            ("tcp", b"\xff"),
        ],
    )
    def test_flood_costs_little_and_is_answered_with_few_errors(self, name, pattern, size) -> None:
        framer = ALL_FRAMERS[name]()
        flood = pattern * (65536 // len(pattern))
        began = time.process_time()
        for at in range(0, len(flood), size):
            results = framer.scan(flood[at : at + size])
            assert len(results) <= 8
            assert all(isinstance(result, FrameError) for result in results)
            assert all(len(item.received) <= 600 for item in results)  # type: ignore[union-attr]
            assert framer.pending <= PENDING[type(framer)]
        # At most 3 us a byte, and 4 us a call; the rest is for slow and busy machines.
        assert time.process_time() - began < 1 + 40e-6 * len(flood) / size

    def test_a_row_of_more_than_eight_errors_is_shortened(self) -> None:
        bad, good = b":1103006B00037F\r\n", b":1103006B00037E\r\n"
        results = AsciiFramer().scan(bad * 3 + good + bad * 20 + good + bad)
        assert [type(result) for result in results] == [
            *[FrameError] * 3,
            Frame,
            *[FrameError] * 8,
            Frame,
            FrameError,
        ]
