"""
Frames on the three kinds of lines: worked examples whole, in single bytes and glued together,
and everything a line can do to them.
"""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import assume, given, settings
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
    delimiter_after,
    is_delimiter,
    lrc,
    make_framer,
)
from tests.support.cases import each_case
from tests.support.vectors import (
    CHECKSUMS,
    FRAMES,
    Checksum,
    FrameVector,
    rows,
)

AnyFramer = TcpFramer | RtuFramer | AsciiFramer


def take(framer: AnyFramer, data: bytes = b"") -> tuple[list[Frame], list[FrameError]]:
    """Feed bytes, and go on until the framer has nothing more to say about them."""
    frames: list[Frame] = []
    errors: list[FrameError] = []
    while True:
        try:
            found = framer.feed(data)
        except FrameError as error:
            errors.append(error)
            if not framer.in_step:
                return frames, errors
            found = []
        else:
            if not found:
                return frames, errors
        frames += found
        data = b""


def quiet(framer: AnyFramer) -> list[Frame]:
    """Return the frames that silence ends; its errors do not matter here."""
    frames: list[Frame] = []
    with contextlib.suppress(FrameError):
        frames += framer.silence()
    return frames + take(framer)[0]


def taken(framer: AnyFramer, data: bytes) -> list[Frame]:
    """Frames in bytes that silence follows, and no errors."""
    frames, errors = take(framer, data)
    frames += framer.silence()
    assert errors == []
    return frames


def single_bytes(data: bytes) -> Iterator[bytes]:
    return (data[at : at + 1] for at in range(len(data)))


def fed_in_bytes(framer: AnyFramer, data: bytes) -> list[Frame]:
    """Return the frames that the last byte completes; none is complete before."""
    for byte in single_bytes(data[:-1]):
        assert framer.feed(byte) == []
    return framer.feed(data[-1:])


def taken_in_bytes(framer: AnyFramer, data: bytes) -> list[Frame]:
    """Return the frames that the last byte, or silence behind it, completes."""
    return fed_in_bytes(framer, data) + framer.silence()


def _shifted(crc: int) -> int:
    for _ in range(8):
        crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


CRC_TABLE = [_shifted(byte) for byte in range(256)]


def rtu(unit: int, body: bytes) -> bytes:
    """An RTU frame, built apart from the package."""
    crc = 0xFFFF
    for byte in bytes([unit]) + body:
        crc = _shifted(crc ^ byte)
    return bytes([unit]) + body + bytes([crc & 0xFF, crc >> 8])


def ascii_frame(unit: int, body: bytes, end: bytes = b"\r\n") -> bytes:
    """An ASCII frame, built apart from the package."""
    data = bytes([unit]) + body
    check = (0x100 - sum(data) % 0x100) % 0x100
    return b":" + data.hex().upper().encode() + b"%02X" % check + end


def mbap(transaction: int, protocol: int, length: int, unit: int, body: bytes) -> bytes:
    return b"".join(
        number.to_bytes(size, "big")
        for number, size in ((transaction, 2), (protocol, 2), (length, 2), (unit, 1))
    ) + bytes(body)


READ = Frame(17, b"\x03\x00\x6b\x00\x03")
REFUSAL = Frame(17, b"\x83\x02")
ANSWER = Frame(17, b"\x03\x02\x12\x34")
WRITE = Frame(17, b"\x06\x00\x01\x00\x03")
LONGEST = Frame(17, b"\x15\xfb\x06\x00\x04\x00\x07\x00\x7a" + bytes(range(244)))


# --- the worked examples ---------------------------------------------------------------


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

    def test_encodes_to_exactly_the_bytes(self, line: str, vector: FrameVector) -> None:
        framer, wire, frame = self.parts(line, vector)
        assert framer.encode(frame) == wire

    def test_is_found_with_its_last_byte(self, line: str, vector: FrameVector) -> None:
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

    def test_is_found_between_neighbours(self, line: str, vector: FrameVector) -> None:
        framer, wire, frame = self.parts(line, vector)
        assert taken(framer, wire * 3) == [frame] * 3

    def test_is_found_cut_anywhere_in_a_pair(self, line: str, vector: FrameVector) -> None:
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


def test_checksums_of_nothing() -> None:
    assert crc16(b"") == 0xFFFF
    assert lrc(b"") == 0


# --- encoding ----------------------------------------------------------------------------

ALL_FRAMERS: dict[str, Callable[[], AnyFramer]] = {
    "tcp": TcpFramer,
    "rtu server": lambda: RtuFramer("server"),
    "rtu client": lambda: RtuFramer("client"),
    "ascii": AsciiFramer,
}
each_framer = each_case("make", ALL_FRAMERS.values(), ids=ALL_FRAMERS)


class TestMakeFramer:
    @pytest.mark.parametrize("role", ["client", "server"])
    def test_each_framing_has_its_framer(self, role: Any) -> None:
        kinds = {"tcp": TcpFramer, "udp": UdpFramer, "ascii": AsciiFramer, "rtu": RtuFramer}
        for framing, kind in kinds.items():
            assert type(make_framer(framing, role)) is kind  # type: ignore[arg-type]
        frame = REFUSAL if role == "client" else READ
        assert make_framer("rtu", role).feed(rtu(*frame[:2])) == [frame]

    def test_others_are_refused_by_name(self) -> None:
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
    def test_frames_that_cannot_be_are_refused_by_name(
        self, make: Callable[[], AnyFramer], frame: Frame, name: str
    ) -> None:
        with pytest.raises(ValueError, match=f"^{name} must "):
            make().encode(frame)

    def test_transaction_goes_onto_tcp_only(self) -> None:
        frame = Frame(1, b"\3\0\0\0\1", 0xBEEF)
        assert TcpFramer().encode(frame)[:2] == b"\xbe\xef"
        assert RtuFramer("client").encode(frame) == rtu(1, frame.pdu)
        assert AsciiFramer().encode(frame) == ascii_frame(1, frame.pdu)


# --- TCP -----------------------------------------------------------------------------------


class TestTcp:
    good = mbap(7, 0, 6, 17, READ.pdu)
    frame = READ._replace(transaction=7)

    @pytest.mark.parametrize("protocol", [1, 256, 65535])
    def test_other_protocol_is_skipped(self, protocol: int) -> None:
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

    def test_frames_before_the_end_of_the_stream_are_given_first(self) -> None:
        framer = TcpFramer()
        assert framer.feed(self.good * 2 + mbap(8, 0, 0, 1, b"")) == [self.frame] * 2
        assert not framer.in_step
        for _ in range(3):
            with pytest.raises(FrameError):
                framer.feed(self.good)

    def test_silence_means_nothing(self) -> None:
        framer = TcpFramer()
        for byte in single_bytes(self.good[:-1]):
            assert framer.feed(byte) == []
            assert framer.silence() == []
        assert framer.feed(self.good[-1:]) == [self.frame]


# --- RTU -----------------------------------------------------------------------------------


def accidental(stream: bytes, end: int) -> bool:
    """Return True if bytes that begin before `end` have a valid CRC, by a chance of 1 in 65536."""
    for start in range(end):
        crc = 0xFFFF
        for at, byte in enumerate(stream[start : start + 256], start=1):
            crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 0xFF]
            if crc == 0 and at >= 4:
                return True
    return False


# Requests and responses of known functions that do not say how long they are.
ENDLESS = [b"\x08\0\0", b"\x2b\x0d"]


@pytest.fixture
def own_class() -> Iterator[int]:
    """The code of a class that is known while the test runs; its third byte counts the rest."""

    class Own(pdu.RawRequest):
        function = 0x6E
        request_length = pdu.counted(2, at=1)
        response_length = pdu.counted(2, at=1)

    yield pdu.register(Own).function
    pdu.REQUESTS.pop(Own.function)


class TestRtu:
    def test_role_says_which_length_rule_holds(self) -> None:
        """A response of function 3 with two bytes less than a request, and one with more."""
        for values in (b"\0\1", b"\0\1\0\2\0\3"):
            response = rtu(17, bytes([3, len(values)]) + values)
            assert RtuFramer("client").feed(response) == [Frame(17, response[1:-2])]
            server = RtuFramer("server")
            frames, _ = take(server, response)
            assert frames == []
        request = rtu(17, READ.pdu)
        assert RtuFramer("server").feed(request) == [READ]
        assert take(RtuFramer("client"), request)[0] == []

    @each_case("code", [0x81, 0x83, 0x97, 0xAB, 0xE5])
    def test_client_takes_exceptions_of_any_function(self, code: int) -> None:
        framer = RtuFramer("client")
        response = rtu(17, bytes([code, 2]))
        assert take(framer, response * 2) == ([Frame(17, bytes([code, 2]))] * 2, [])

    @each_case("tail", ["0e 02", "02 0e", "0d 01", "01 0d"])
    def test_client_takes_an_exception_with_a_mei_type(self, tail: str) -> None:
        frame = Frame(17, b"\xab" + bytes.fromhex(tail))
        good = rtu(*frame[:2])
        framer = RtuFramer("client")
        for _ in range(2):
            assert fed_in_bytes(framer, good) == [frame]
        short = Frame(17, b"\xab\x01")
        stream = good + rtu(*short[:2]) + good + rtu(*ANSWER[:2])
        assert take(framer, stream) == ([frame, short, frame, ANSWER], [])
        frames = take(framer, b"\xff\xff\xff" + good)[0]
        assert frames + quiet(framer) == [frame]

    @pytest.mark.parametrize("body", [b"\xab\1\2", b"\xac\x0e\2", b"\xab\x0e\2\0"])
    def test_other_exceptions_are_two_bytes(self, body: bytes) -> None:
        framer = RtuFramer("client")
        frames, _ = take(framer, rtu(17, body) + rtu(*ANSWER[:2]))
        assert frames + quiet(framer) == [ANSWER]

    def test_server_takes_no_exceptions(self) -> None:
        framer = RtuFramer("server")
        assert take(framer, rtu(17, b"\x83\2") + rtu(*READ[:2])) == ([READ], [])

    @settings(max_examples=75)
    @given(
        st.binary(min_size=1, max_size=20),
        st.sampled_from(
            [("server", READ), ("server", LONGEST), ("client", ANSWER), ("client", REFUSAL)]
        ),
    )
    def test_good_frame_is_found_behind_garbage(
        self, garbage: bytes, role_and_frame: tuple[Any, Frame]
    ) -> None:
        role, frame = role_and_frame
        good = rtu(*frame[:2])
        stream = garbage + good
        assume(not accidental(stream, len(garbage)))
        framer = RtuFramer(role)
        found, _ = take(framer, stream)
        assert found + quiet(framer) == [frame]
        assert framer.pending == 0
        assert take(framer, good) == ([frame], [])

    @settings(max_examples=50)
    @given(st.binary(min_size=1, max_size=20))
    def test_garbage_in_front_of_a_frame_is_reported(self, garbage: bytes) -> None:
        stream = garbage + rtu(*READ[:2])
        assume(not accidental(stream, len(garbage)))
        framer = RtuFramer("server")
        reports: list[FrameError] = []
        for call in (lambda: framer.feed(stream), framer.silence, lambda: framer.feed(b"")):
            try:
                call()
            except FrameError as error:
                reports.append(error)
        assert reports
        assert reports[0].received.startswith(garbage[:1])

    @each_case("at", range(8))
    def test_one_spoilt_bit_costs_only_its_own_frame(self, at: int) -> None:
        framer = RtuFramer("server")
        bad = bytearray(rtu(*READ[:2]))
        bad[at] ^= 0x40
        frames: list[Frame] = []
        for data in (bytes(bad), rtu(*WRITE[:2])):
            frames += take(framer, data)[0] + quiet(framer)
        assert frames == [WRITE]
        assert take(framer, rtu(*WRITE[:2])) == ([WRITE], [])

    def test_bad_crc_is_reported_at_once(self) -> None:
        good = rtu(*READ[:2])
        with pytest.raises(FrameError, match="CRC") as caught:
            RtuFramer("server").feed(good[:-1] + bytes([good[-1] ^ 1]))
        # What can still begin a frame is kept.
        assert caught.value.received
        assert good.startswith(caught.value.received)

    def test_frames_before_and_behind_a_bad_one_are_given_before_the_error(self) -> None:
        framer = RtuFramer("server")
        good, bad = rtu(*READ[:2]), bytearray(rtu(*WRITE[:2]))
        bad[-1] ^= 0xFF
        assert framer.feed(good + bad + good) == [READ]
        assert framer.silence() == [READ]
        with pytest.raises(FrameError):
            framer.feed(b"")
        assert framer.feed(b"") == []

    def test_cut_frame_gives_way_to_the_next_one(self) -> None:
        """A write of which the line lost the end, and whose length swallows the next frame."""
        long = rtu(17, b"\x10\0\0\0\x40\x80" + bytes(128))
        framer = RtuFramer("server")
        assert framer.feed(long[:40]) == []
        assert quiet(framer) == []
        assert framer.feed(rtu(*READ[:2])) == []  # may still belong to the write
        assert quiet(framer) == [READ]
        assert framer.pending == 0

    def test_unfinished_frame_outlives_a_silence(self) -> None:
        good = rtu(*LONGEST[:2])
        framer = RtuFramer("server")
        for byte in single_bytes(good[:-1]):
            assert framer.feed(byte) == []
            assert framer.silence() == []
        assert framer.feed(good[-1:]) == [LONGEST]

    def test_frame_within_a_frame_is_data(self) -> None:
        inner = rtu(17, b"\x06\x00\x01\x00\x03")
        outer = rtu(17, b"\x10\x00\x00\x00\x06\x0c" + inner + inner[:4])
        framer = RtuFramer("server")
        assert fed_in_bytes(framer, outer) == [Frame(17, outer[1:-2])]
        assert take(framer, outer + inner) == ([Frame(17, outer[1:-2]), WRITE], [])

    def test_frame_within_a_response_is_data(self) -> None:
        inner = rtu(17, b"\x83\x02")
        outer = rtu(17, b"\x03\x0a" + inner * 2)
        framer = RtuFramer("client")
        assert fed_in_bytes(framer, outer) == [Frame(17, outer[1:-2])]

    @each_case(
        ("head", "size"),
        [
            *((head, size) for head in (b"\x41", b"\x48", b"\x6e") for size in (0, 1, 30, 252)),
            *((head, size) for head in ENDLESS for size in (2, 4, 30, 250)),
        ],
    )
    @each_case("role", ["client", "server"])
    def test_function_without_length_ends_with_its_crc(
        self, role: Any, head: bytes, size: int
    ) -> None:
        body = head + bytes(at * 11 & 0xFF for at in range(size))
        good = rtu(17, body)
        assert not accidental(good[:-1], 1)
        framer = RtuFramer(role)
        for _ in range(2):  # right after silence, and right after a good frame
            assert taken_in_bytes(framer, good) == [Frame(17, body)]
        assert taken(framer, good * 3) == [Frame(17, body)] * 3
        write = rtu(*WRITE[:2])
        assert taken(framer, write + good + write) == [WRITE, Frame(17, body), WRITE]

    @each_case("noise", [b"\x00", b"\x11\x03\x00", b"\x11\x41"])
    @each_case("body", [b"\x41\x01\x02", *(head + b"\xa5\x37" for head in ENDLESS)])
    @each_case("role", ["client", "server"])
    def test_function_without_length_is_taken_after_a_silence(
        self, role: Any, body: bytes, noise: bytes
    ) -> None:
        framer = RtuFramer(role)
        frames = take(framer, noise)[0] + quiet(framer)
        for _ in range(3):
            frames += take(framer, rtu(17, body))[0] + quiet(framer)
        assert frames == [Frame(17, body)] * 3

    @pytest.mark.parametrize("head", ENDLESS)
    def test_known_function_without_length_does_not_swallow_the_next(self, head: bytes) -> None:
        """Its CRC is lost; what follows after a silence is found all the same."""
        framer = RtuFramer("server")
        spoilt = bytearray(rtu(17, head + b"\xa5\x37"))
        spoilt[-1] ^= 1
        frames = take(framer, bytes(spoilt))[0] + quiet(framer)
        for _ in range(2):
            frames += take(framer, rtu(*READ[:2]))[0] + quiet(framer)
        assert frames == [READ] * 2

    @each_case("sub_function", [1, 4, 10, 11, 20, 21, 65535])
    @each_case("role", ["client", "server"])
    def test_other_diagnostics_have_their_length(self, role: Any, sub_function: int) -> None:
        head = b"\x11\x08" + sub_function.to_bytes(2, "big")
        early = head[1:] + crc16(head).to_bytes(2, "little")  # a CRC that fits, in the data
        whole = rtu(17, early)
        framer = RtuFramer(role)
        assert fed_in_bytes(framer, whole) == [Frame(17, early)]

    @pytest.mark.parametrize("role", ["client", "server"])
    def test_class_of_ones_own_is_read_by_its_rule(self, role: Any, own_class: int) -> None:
        """A frame with a fitting CRC in its data, which nothing but the rule can tell."""
        head = bytes([17, own_class, 4])
        early = head[1:] + crc16(head).to_bytes(2, "little") + b"\1\2"
        whole = rtu(17, early)
        framer = RtuFramer(role)
        assert fed_in_bytes(framer, whole) == [Frame(17, early)]
        assert take(framer, whole * 2) == ([Frame(17, early)] * 2, [])
        # And it is found behind garbage, which a code without a rule is not.
        found = [*framer.scan(b"\xff\xff\xff" + whole), *framer.scan_silence()]
        assert [each for each in found if isinstance(each, Frame)] == [Frame(17, early)]
        assert any(isinstance(each, FrameError) for each in found)

    def test_rule_in_python_is_asked_and_may_fail(self) -> None:
        asked: list[bytes] = []

        def rule(head: bytes) -> int | None:
            asked.append(head)
            if head[1:2] == b"\xee":
                raise LookupError("a mistake in a rule")
            return 4 + head[1] if len(head) > 1 else None

        class Own(pdu.RawRequest):
            function = 0x6D
            request_length = staticmethod(rule)  # type: ignore[assignment]

        pdu.register(Own)
        try:
            framer = RtuFramer("server")
            frame = Frame(17, b"\x6d\2abcd")
            good = rtu(*frame[:2])
            assert fed_in_bytes(framer, good) == [frame]
            frames = take(framer, b"\xff\xff\xff" + good)[0] + quiet(framer)
            frames += take(framer, good + rtu(*READ[:2]))[0]
            assert frames == [frame, frame, READ]
            take(framer, b"\1\x6d\xff" + bytes(60))
            assert all(1 <= len(head) <= pdu.MAX_PDU for head in asked)
            assert take(framer, b"\1\x6d\xee")[0] + quiet(framer) == []
            assert take(framer, rtu(*READ[:2]))[0] + quiet(framer) == [READ]
        finally:
            pdu.REQUESTS.pop(Own.function)

    @each_case(
        "rule",
        [
            pdu.fixed(254),
            pdu.fixed(1 << 40),
            pdu.counted(1 << 40, 1),
            pdu.counted(2, at=1 << 40),
            pdu.counted(2, at=253),
            lambda head: 1 << 40,
            lambda head: None,
        ],
    )
    def test_rules_beyond_a_message_find_nothing(self, rule: Any) -> None:
        class Own(pdu.RawRequest):
            function = 0x6D
            response_length = rule

        pdu.register(Own)
        try:
            framer = RtuFramer("client")
            frames = take(framer, b"\1\x6d\1" + bytes(300))[0] + quiet(framer)
            frames += take(framer, rtu(*ANSWER[:2]))[0] + quiet(framer)
            assert frames == [ANSWER]
        finally:
            pdu.REQUESTS.pop(Own.function)

    def test_refusal_of_a_class_of_ones_own_is_found(self, own_class: int) -> None:
        refusal = Frame(17, bytes([own_class | 0x80, 3]))
        framer = RtuFramer("client")
        assert take(framer, rtu(*refusal[:2]) * 2) == ([refusal] * 2, [])
        frames = take(framer, b"\xff\xff\xff" + rtu(*refusal[:2]))[0]
        assert frames + quiet(framer) == [refusal]

    @each_case("count", [32, 124, 125, 126, 0x7FFF])
    def test_queue_longer_than_a_message_is_no_frame(self, count: int) -> None:
        size = 2 + 2 * count & 0xFFFF
        head = b"\x18" + size.to_bytes(2, "big") + count.to_bytes(2, "big")
        response = rtu(17, head + bytes(2 * min(count, 150)))
        framer = RtuFramer("client")
        frames, _ = take(framer, response)
        assert frames == ([Frame(17, response[1:-2])] if count <= 124 else [])
        quiet(framer)
        assert take(framer, rtu(*ANSWER[:2]))[0] + quiet(framer) == [ANSWER]

    def test_function_without_length_rule_or_crc_is_given_up(self) -> None:
        framer = RtuFramer("server")
        frames, errors = take(framer, b"\x11\x41" + bytes(254))
        assert frames == []
        assert errors
        assert take(framer, rtu(*READ[:2]))[0] + quiet(framer) == [READ]

    def test_other_units_on_the_bus_do_not_hide_our_requests(self) -> None:
        """A server hears every request and every response, by the rule for requests alone."""
        others = [
            (rtu(18, b"\x03\x00\x00\x00\x01"), rtu(18, b"\x03\x02\x12\x34")),
            (rtu(18, b"\x03\x00\x00\x00\x08"), rtu(18, b"\x03\x10" + bytes(range(16)))),
            (rtu(19, b"\x01\x00\x00\x00\x09"), rtu(19, b"\x01\x02\xff\x01")),
            (rtu(19, b"\x06\x00\x01\x00\x03"), rtu(19, b"\x06\x00\x01\x00\x03")),
            (rtu(20, b"\x10\x00\x01\x00\x01\x02\x12\x34"), rtu(20, b"\x10\x00\x01\x00\x01")),
            (rtu(20, b"\x0f\x00\x01\x00\x01\x01\x01"), rtu(20, b"\x0f\x00\x01\x00\x01")),
            (rtu(21, b"\x17\0\0\0\1\0\0\0\1\2\0\1"), rtu(21, b"\x17\x02\x00\x01")),
            (rtu(21, b"\x04\x00\x00\x00\x01"), rtu(21, b"\x84\x02")),
            (rtu(22, b"\x03\x00\x00\x00\x7d"), rtu(22, b"\x03\xfa" + bytes(range(250)))),
            (rtu(23, b"\x16\0\1\0\2\0\3"), rtu(23, b"\x16\0\1\0\2\0\3")),
            (rtu(24, b"\x07"), rtu(24, b"\x07\x6d")),
            (rtu(24, b"\x08\0\0\xa5\x37"), rtu(24, b"\x08\0\0\xa5\x37")),
            (rtu(24, b"\x08\0\x0b\0\0"), rtu(24, b"\x08\0\x0b\1\x21")),
            (rtu(25, b"\x0b"), rtu(25, b"\x0b\xff\xff\1\x08")),
            (rtu(25, b"\x0c"), rtu(25, b"\x0c\x08\0\0\1\x08\1\x21\x20\0")),
            (rtu(26, b"\x11"), rtu(26, b"\x11\x08\1\xffdevice")),
            (rtu(26, b"\x18\4\xde"), rtu(26, b"\x18\0\6\0\2\1\xb8\x12\x84")),
            (rtu(27, b"\x2b\x0e\1\0"), rtu(27, b"\x2b\x0e\1\1\0\0\1\0\5hello")),
            (rtu(27, b"\x2b\x0d\1\2"), rtu(27, b"\x2b\x0d\3\4\5")),
        ]
        for turns in ([1], [3, 2], [1] * 300):
            framer = RtuFramer("server")
            ours: list[Frame] = []
            for message in (rtu(*READ[:2]), *(each for pair in others for each in pair)):
                for own in (b"", rtu(*WRITE[:2])):
                    for data in (message, own):
                        pieces, at = [], 0
                        for size in turns:
                            pieces.append(data[at : at + size])
                            at += size
                        pieces.append(data[at:])
                        for piece in pieces:
                            ours += take(framer, piece)[0]
                        ours += quiet(framer)
            own_frames = [frame for frame in ours if frame.unit == 17]
            assert own_frames.count(WRITE) == 1 + 2 * len(others)
            assert own_frames.count(READ) == 2
            assert len(own_frames) == 3 + 2 * len(others)


# --- ASCII ---------------------------------------------------------------------------------


class TestAscii:
    good = ascii_frame(17, READ.pdu)

    @each_case(
        "before",
        [
            b"0",
            b"\r\n",
            b"\n",
            b"\r",
            b"garbage 0123\r\n",
            b"1103006B00037E\r\n",
            bytes(range(0x3A)),
            b"\xff" * 600,
        ],
    )
    def test_everything_before_the_colon_is_skipped(self, before: bytes) -> None:
        framer = AsciiFramer()
        assert take(framer, before + self.good) == ([READ], [])
        for byte in single_bytes(before):
            assert framer.feed(byte) == []
            assert framer.pending == 0
        assert take(framer, self.good) == ([READ], [])

    @each_case("cut", range(1, 15))
    def test_colon_inside_a_frame_starts_a_new_one(self, cut: int) -> None:
        framer = AsciiFramer()
        frames, errors = take(framer, self.good[:cut] + self.good)
        assert frames == [READ]
        assert len(errors) == 1
        frames = []
        for byte in single_bytes(self.good[:cut] + self.good):
            frames += take(framer, byte)[0]
        assert frames == [READ]

    @each_case("end", [b"\r\r\n", b"\rX\n", b"\r\0\n", b"\r0", b"\r", b"\n"])
    def test_other_end_than_cr_and_lf_drops_the_frame(self, end: bytes) -> None:
        framer = AsciiFramer()
        frames, errors = take(framer, self.good[:-2] + end + self.good)
        assert frames == [READ]
        assert len(errors) == 1

    def test_lower_case_digits_are_taken(self) -> None:
        assert AsciiFramer().feed(self.good.lower()) == [READ]
        assert AsciiFramer().feed(b":1103006b00037E\r\n") == [READ]

    @each_case(
        "bad",
        [
            b":1103006B00037\r\n",  # odd
            b":1103006B000337E\r\n",  # odd
            b":\r\n",
            b":11\r\n",
            b":11EF\r\n",  # no function code; the LRC is right
            b":00\r\n",
            b":0000\r\n",
            b":1103006B00037F\r\n",  # LRC
            b":1103006B00047E\r\n",  # LRC
            b":1103006G00037E\r\n",
            b":1103006 B00037E\r\n",
            b":11 03006B00037E\r\n",
            b":1103006B00037E \r\n",
            b": 1103006B00037E\r\n",
            b":+103006B00037E0\r\n",
            b":1103006\x0000037E\r\n",
            b":1103006\xb200037E\r\n",
            b":11_03_006B_000_37E\r\n",
            b":1103\n006B00037E\r\n",
            b":" + b"00" * 256 + b"\r\n",  # 512 digits: two more than a frame may have
        ],
    )
    def test_bad_frame_is_an_error_and_the_next_one_is_found(self, bad: bytes) -> None:
        with pytest.raises(FrameError) as caught:
            AsciiFramer().feed(bad)
        assert caught.value.received[:1] == b":"
        framer = AsciiFramer()
        frames, errors = take(framer, bad + self.good)
        assert frames == [READ]
        assert errors
        frames, errors = [], []
        for byte in single_bytes(bad + self.good):
            found, rejected = take(framer, byte)
            frames += found
            errors += rejected
        assert frames == [READ]
        assert errors

    def test_frame_that_never_ends_is_dropped(self) -> None:
        framer = AsciiFramer()
        errors = 0
        for byte in single_bytes(b":" + b"0" * 2000):
            errors += len(take(framer, byte)[1])
            assert framer.pending <= 513
        assert errors == 1
        assert take(framer, self.good) == ([READ], [])

    def test_delimiter_can_be_changed(self) -> None:
        framer = AsciiFramer()
        framer.delimiter = ord("#")
        changed = self.good[:-1] + b"#"
        assert framer.encode(READ) == changed
        assert take(framer, changed * 2) == ([READ] * 2, [])
        frames, errors = take(framer, self.good + changed)
        assert frames == [READ]
        assert len(errors) == 1
        framer.delimiter = 0x0A
        assert framer.encode(READ) == self.good

    @each_case(
        ("answer", "delimiter"),
        [
            ("08 00 03 23 00", 0x23),
            ("08 00 03 0A 00", 0x0A),
            ("08 00 03 3A 00", 0x24),  # a colon begins a frame
            ("08 00 03 41 00", 0x24),
            ("08 00 03 80 00", 0x24),
            ("08 00 03 23 01", 0x24),  # 00 follows the delimiter
            ("08 00 03 23", 0x24),
            ("08 00 01 00 00", 0x0A),
            ("08 00 01 FF 00", 0x0A),
            ("08 00 00 23 00", 0x24),
            ("88 03", 0x24),
            ("03 02 00 03", 0x24),
        ],
    )
    def test_delimiter_after_an_answer(self, answer: str, delimiter: int) -> None:
        assert delimiter_after(bytes.fromhex(answer), 0x24) == delimiter

    @each_case("delimiter", [-1, 128, 256, *b":\r0123456789ABCDEFabcdef"])
    def test_delimiter_with_another_use_is_refused(self, delimiter: int) -> None:
        framer = AsciiFramer()
        assert not is_delimiter(delimiter)
        with pytest.raises(ValueError, match="delimiter"):
            framer.delimiter = delimiter
        assert framer.delimiter == 0x0A

    @each_case("cut", range(1, 17))
    def test_silence_drops_an_unfinished_frame(self, cut: int) -> None:
        framer = AsciiFramer()
        assert framer.feed(self.good[:cut]) == []
        with pytest.raises(FrameError, match="unfinished"):
            framer.silence()
        assert framer.pending == 0
        assert framer.feed(self.good[cut:]) == []
        assert framer.feed(self.good) == [READ]

    def test_silence_between_frames_is_no_error(self) -> None:
        framer = AsciiFramer()
        assert framer.silence() == []
        framer.feed(self.good)
        assert framer.silence() == []


# --- whatever comes -----------------------------------------------------------------------

PENDING = {TcpFramer: 260, RtuFramer: 256, AsciiFramer: 513}


def pieces(data: bytes, sizes: list[int]) -> Iterator[bytes]:
    at = 0
    for size in sizes:
        yield data[at : at + size]
        at += size
    yield data[at:]


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
                frames += quiet(framer)
            for frame in frames:
                assert 0 <= frame.unit <= 255
                assert 1 <= len(frame.pdu) <= pdu.MAX_PDU
                assert type(frame.pdu) is bytes
            assert framer.pending <= PENDING[type(framer)]

    @each_framer
    @settings(max_examples=60)
    @given(stream=streams, sizes=cuts)
    def test_frames_do_not_depend_on_how_bytes_arrive(
        self, make: Callable[[], AnyFramer], stream: bytes, sizes: list[int]
    ) -> None:
        whole = take(make(), stream)[0]
        framer = make()
        frames: list[Frame] = []
        for piece in pieces(stream, sizes):
            frames += take(framer, piece)[0]
        assert frames == whole

    @each_framer
    @settings(max_examples=30)
    @given(
        unit=st.integers(0, 255),
        values=st.lists(st.integers(0, 65535), min_size=1, max_size=123),
        transaction=st.integers(0, 65535),
        sizes=cuts,
    )
    def test_frames_survive_the_line(
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

    @each_framer
    def test_a_megabyte_of_noise_is_borne(self, make: Callable[[], AnyFramer]) -> None:
        noise = random.Random(20).randbytes(1 << 20)
        sizes = random.Random(21)
        framer = make()
        at = 0
        began = time.process_time()
        while at < len(noise):
            size = sizes.choice((1, 3, 17, 300, 5000))
            take(framer, noise[at : at + size])
            assert framer.pending <= PENDING[type(framer)]
            at += size
            if sizes.random() < 0.01:
                quiet(framer)
            if not framer.in_step:
                framer = make()
        if isinstance(framer, TcpFramer):
            return  # nothing marks where a header begins
        quiet(framer)
        good = framer.encode(WRITE)  # request and response alike
        for _ in range(2):
            found = take(framer, good)[0] + quiet(framer)
            assert found[-1:] == [WRITE]
        assert time.process_time() - began < 20

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
    def test_flood_costs_little_and_is_answered_with_few_errors(
        self, name: str, pattern: bytes, size: int
    ) -> None:
        framer = ALL_FRAMERS[name]()
        flood = pattern * (65536 // len(pattern))
        began = time.process_time()
        for at in range(0, len(flood), size):
            found = framer.scan(flood[at : at + size])
            assert len(found) <= 8
            assert all(isinstance(each, FrameError) for each in found)
            assert all(len(each.received) <= 600 for each in found)  # type: ignore[union-attr]
            assert framer.pending <= PENDING[type(framer)]
        # At most 3 us a byte, and 4 us a call; the rest is for slow and busy machines.
        assert time.process_time() - began < 1 + 40e-6 * len(flood) / size

    def test_errors_are_left_out_in_one_row_only(self) -> None:
        bad, good = b":1103006B00037F\r\n", b":1103006B00037E\r\n"
        found = AsciiFramer().scan(bad * 3 + good + bad * 20 + good + bad)
        assert [type(each) for each in found] == [
            *[FrameError] * 3,
            Frame,
            *[FrameError] * 8,
            Frame,
            FrameError,
        ]
