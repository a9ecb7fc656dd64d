"""What framers find on an RTU line: the ends of frames, noise, other units, own functions."""

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, RtuFramer, crc16
from tests.support.cases import each_case
from tests.support.framing import (
    ANSWER,
    LONGEST,
    READ,
    REFUSAL,
    WRITE,
    after_silence,
    feed_bytes,
    frames_in,
    frames_in_bytes,
    registration,
    rtu,
    single_bytes,
    take,
)


def accidental(stream: bytes, end: int) -> bool:
    """Return True if bytes that begin before `end` have a valid CRC, by a chance of 1 in 65536."""
    return any(
        crc16(stream[start:stop]) == 0
        for start in range(end)
        for stop in range(start + 4, min(start + 256, len(stream)) + 1)
    )


# Requests and responses of known functions that do not say how long they are.
ENDLESS = [b"\x08\0\0", b"\x2b\x0d"]


@pytest.fixture
def own_class() -> Iterator[int]:
    """The code of a class that is known while the test runs; its third byte counts the rest."""
    with registration(pdu.counted(2, at=1)) as own:
        yield own.function


class TestRtu:
    def test_the_role_selects_the_length_rule(self) -> None:
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
    def test_a_client_accepts_exceptions_of_any_function(self, code: int) -> None:
        framer = RtuFramer("client")
        response = rtu(17, bytes([code, 2]))
        assert take(framer, response * 2) == ([Frame(17, bytes([code, 2]))] * 2, [])

    @each_case("tail", ["0e 02", "02 0e", "0d 01", "01 0d"])
    def test_a_client_accepts_an_exception_with_a_mei_type(self, tail: str) -> None:
        frame = Frame(17, b"\xab" + bytes.fromhex(tail))
        good = rtu(*frame[:2])
        framer = RtuFramer("client")
        for _ in range(2):
            assert feed_bytes(framer, good) == [frame]
        short = Frame(17, b"\xab\x01")
        stream = good + rtu(*short[:2]) + good + rtu(*ANSWER[:2])
        assert take(framer, stream) == ([frame, short, frame, ANSWER], [])
        frames = take(framer, b"\xff\xff\xff" + good)[0]
        assert frames + after_silence(framer) == [frame]

    @pytest.mark.parametrize("body", [b"\xab\1\2", b"\xac\x0e\2", b"\xab\x0e\2\0"])
    def test_other_exceptions_are_two_bytes(self, body: bytes) -> None:
        framer = RtuFramer("client")
        frames, _ = take(framer, rtu(17, body) + rtu(*ANSWER[:2]))
        assert frames + after_silence(framer) == [ANSWER]

    def test_a_server_ignores_exception_responses(self) -> None:
        framer = RtuFramer("server")
        assert take(framer, rtu(17, b"\x83\2") + rtu(*READ[:2])) == ([READ], [])

    @settings(max_examples=75)
    @given(
        st.binary(min_size=1, max_size=20),
        st.sampled_from(
            [("server", READ), ("server", LONGEST), ("client", ANSWER), ("client", REFUSAL)]
        ),
    )
    def test_a_good_frame_is_found_after_noise(
        self, garbage: bytes, role_and_frame: tuple[Any, Frame]
    ) -> None:
        role, frame = role_and_frame
        good = rtu(*frame[:2])
        stream = garbage + good
        assume(not accidental(stream, len(garbage)))
        framer = RtuFramer(role)
        frames, _ = take(framer, stream)
        assert frames + after_silence(framer) == [frame]
        assert framer.pending == 0
        assert take(framer, good) == ([frame], [])

    @settings(max_examples=50)
    @given(st.binary(min_size=1, max_size=20))
    def test_noise_before_a_frame_is_reported(self, garbage: bytes) -> None:
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
            frames += take(framer, data)[0] + after_silence(framer)
        assert frames == [WRITE]
        assert take(framer, rtu(*WRITE[:2])) == ([WRITE], [])

    def test_a_bad_crc_is_reported_at_the_silence(self) -> None:
        """It may be noise before a request until then."""
        good = rtu(*READ[:2])
        bad = good[:-1] + bytes([good[-1] ^ 1])
        framer = RtuFramer("server")
        assert framer.feed(bad) == []
        with pytest.raises(FrameError, match="CRC") as caught:
            framer.silence()
        assert bad.startswith(caught.value.received)

    def test_frames_around_a_bad_one_are_returned_before_the_error(self) -> None:
        framer = RtuFramer("server")
        good, bad = rtu(*READ[:2]), bytearray(rtu(*WRITE[:2]))
        bad[-1] ^= 0xFF
        assert framer.feed(good + bad + good) == [READ]
        assert framer.silence() == [READ]
        with pytest.raises(FrameError):
            framer.feed(b"")
        assert framer.feed(b"") == []

    def test_an_incomplete_frame_is_dropped_for_the_next_one(self) -> None:
        """A write of which the line lost the end, and whose length swallows the next frame."""
        long = rtu(17, b"\x10\0\0\0\x40\x80" + bytes(128))
        framer = RtuFramer("server")
        assert framer.feed(long[:40]) == []
        assert after_silence(framer) == []
        assert framer.feed(rtu(*READ[:2])) == []  # may still belong to the write
        assert after_silence(framer) == [READ]
        assert framer.pending == 0

    def test_an_incomplete_frame_is_kept_over_a_silence(self) -> None:
        good = rtu(*LONGEST[:2])
        framer = RtuFramer("server")
        for byte in single_bytes(good[:-1]):
            assert framer.feed(byte) == []
            assert framer.silence() == []
        assert framer.feed(good[-1:]) == [LONGEST]

    def test_a_request_inside_a_request_is_data(self) -> None:
        inner = rtu(17, b"\x06\x00\x01\x00\x03")
        outer = rtu(17, b"\x10\x00\x00\x00\x06\x0c" + inner + inner[:4])
        framer = RtuFramer("server")
        assert feed_bytes(framer, outer) == [Frame(17, outer[1:-2])]
        assert take(framer, outer + inner) == ([Frame(17, outer[1:-2]), WRITE], [])

    def test_a_request_inside_a_response_is_data(self) -> None:
        inner = rtu(17, b"\x83\x02")
        outer = rtu(17, b"\x03\x0a" + inner * 2)
        framer = RtuFramer("client")
        assert feed_bytes(framer, outer) == [Frame(17, outer[1:-2])]

    @each_case(
        ("head", "size"),
        [
            *((head, size) for head in (b"\x41", b"\x48", b"\x6e") for size in (0, 1, 30, 252)),
            *((head, size) for head in ENDLESS for size in (2, 4, 30, 250)),
        ],
    )
    @each_case("role", ["client", "server"])
    def test_a_function_without_length_rule_ends_at_its_crc(self, role, head, size) -> None:
        body = head + bytes(at * 11 & 0xFF for at in range(size))
        good = rtu(17, body)
        assert not accidental(good[:-1], 1)
        framer = RtuFramer(role)
        for _ in range(2):  # right after silence, and right after a good frame
            assert frames_in_bytes(framer, good) == [Frame(17, body)]
        assert frames_in(framer, good * 3) == [Frame(17, body)] * 3
        write = rtu(*WRITE[:2])
        assert frames_in(framer, write + good + write) == [WRITE, Frame(17, body), WRITE]

    @each_case("noise", [b"\x00", b"\x11\x03\x00", b"\x11\x41"])
    @each_case("body", [b"\x41\x01\x02", *(head + b"\xa5\x37" for head in ENDLESS)])
    @each_case("role", ["client", "server"])
    def test_a_function_without_length_rule_ends_at_a_silence(self, role, body, noise) -> None:
        framer = RtuFramer(role)
        frames = take(framer, noise)[0] + after_silence(framer)
        for _ in range(3):
            frames += take(framer, rtu(17, body))[0] + after_silence(framer)
        assert frames == [Frame(17, body)] * 3

    @pytest.mark.parametrize("head", ENDLESS)
    def test_a_damaged_frame_without_length_rule_does_not_contain_the_next(self, head: bytes):
        """Its CRC is lost; what follows after a silence is found all the same."""
        framer = RtuFramer("server")
        frame = bytearray(rtu(17, head + b"\xa5\x37"))
        frame[-1] ^= 1
        frames = take(framer, bytes(frame))[0] + after_silence(framer)
        for _ in range(2):
            frames += take(framer, rtu(*READ[:2]))[0] + after_silence(framer)
        assert frames == [READ] * 2

    @each_case("sub_function", [1, 4, 10, 11, 20, 21, 65535])
    @each_case("role", ["client", "server"])
    def test_other_diagnostics_have_length_rules(self, role: Any, sub_function: int) -> None:
        head = b"\x11\x08" + sub_function.to_bytes(2, "big")
        early = head[1:] + crc16(head).to_bytes(2, "little")  # a CRC that fits, in the data
        whole = rtu(17, early)
        framer = RtuFramer(role)
        assert feed_bytes(framer, whole) == [Frame(17, early)]

    @pytest.mark.parametrize("role", ["client", "server"])
    def test_a_registered_class_is_read_by_its_length_rule(self, role: Any, own_class: int) -> None:
        """A frame with a valid CRC in its data, so that only the rule gives the right end."""
        head = bytes([17, own_class, 4])
        early = head[1:] + crc16(head).to_bytes(2, "little") + b"\1\2"
        whole = rtu(17, early)
        framer = RtuFramer(role)
        assert feed_bytes(framer, whole) == [Frame(17, early)]
        assert take(framer, whole * 2) == ([Frame(17, early)] * 2, [])
        # And the frame is found after noise, unlike one of a code without a rule.
        results = [*framer.scan(b"\xff\xff\xff" + whole), *framer.scan_silence()]
        assert [result for result in results if isinstance(result, Frame)] == [Frame(17, early)]
        assert any(isinstance(result, FrameError) for result in results)

    def test_a_length_rule_in_python_is_called(self) -> None:
        heads: list[bytes] = []

        def rule(head: bytes) -> int | None:
            heads.append(head)
            return 4 + head[1] if len(head) > 1 else None

        with registration(rule):
            framer = RtuFramer("server")
            frame = Frame(17, b"\x6d\2abcd")
            good = rtu(*frame[:2])
            assert feed_bytes(framer, good) == [frame]
            frames = take(framer, b"\xff\xff\xff" + good)[0] + after_silence(framer)
            frames += take(framer, good + rtu(*READ[:2]))[0]
            assert frames == [frame, frame, READ]
            take(framer, b"\1\x6d\xff" + bytes(60))
            assert all(1 <= len(head) <= pdu.MAX_PDU for head in heads)

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
    def test_a_length_rule_beyond_the_largest_message_finds_no_frame(self, rule: Any) -> None:
        with registration(rule):
            framer = RtuFramer("client")
            frames = take(framer, b"\1\x6d\1" + bytes(300))[0] + after_silence(framer)
            frames += take(framer, rtu(*ANSWER[:2]))[0] + after_silence(framer)
            assert frames == [ANSWER]

    def test_a_refusal_of_a_registered_class_is_found(self, own_class: int) -> None:
        refusal = Frame(17, bytes([own_class | 0x80, 3]))
        framer = RtuFramer("client")
        assert take(framer, rtu(*refusal[:2]) * 2) == ([refusal] * 2, [])
        frames = take(framer, b"\xff\xff\xff" + rtu(*refusal[:2]))[0]
        assert frames + after_silence(framer) == [refusal]

    @each_case("count", [32, 124, 125, 126, 0x7FFF])
    def test_a_queue_longer_than_a_message_is_no_frame(self, count: int) -> None:
        size = 2 + 2 * count & 0xFFFF
        head = b"\x18" + size.to_bytes(2, "big") + count.to_bytes(2, "big")
        response = rtu(17, head + bytes(2 * min(count, 150)))
        framer = RtuFramer("client")
        frames, _ = take(framer, response)
        assert frames == ([Frame(17, response[1:-2])] if count <= 124 else [])
        after_silence(framer)
        assert take(framer, rtu(*ANSWER[:2]))[0] + after_silence(framer) == [ANSWER]

    def test_bytes_without_length_rule_or_crc_are_dropped(self) -> None:
        framer = RtuFramer("server")
        frames, errors = take(framer, b"\x11\x41" + bytes(264))
        assert frames == []
        assert errors
        assert take(framer, rtu(*READ[:2]))[0] + after_silence(framer) == [READ]
