"""What framers find on an ASCII line: colons, ends of lines, digits and delimiters."""

import pytest

from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import AsciiFramer, delimiter_after, is_delimiter
from tests.support.cases import each_case
from tests.support.framing import READ, ascii_frame, single_bytes, take


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

    @each_case("end", [b"\r\r\n", b"\rX\n", b"\r\0\n", b"\r0", b"#", b""])
    def test_other_end_than_cr_and_lf_drops_the_frame(self, end: bytes) -> None:
        framer = AsciiFramer()
        frames, errors = take(framer, self.good[:-2] + end + self.good)
        assert frames == [READ]
        assert len(errors) == 1

    @each_case("end", [b"\r", b"\n", b"\n\r"])
    def test_either_cr_or_lf_alone_ends_a_frame(self, end: bytes) -> None:
        frame = self.good[:-2] + end
        framer = AsciiFramer()
        assert take(framer, frame * 3)[0] + framer.silence() == [READ] * 3
        frames = [entry for byte in single_bytes(frame * 3) for entry in framer.feed(byte)]
        assert frames + framer.silence() == [READ] * 3

    def test_silence_ends_a_frame_behind_a_cr_sooner(self) -> None:
        framer = AsciiFramer()
        assert framer.feed(self.good[:-2]) == []
        assert framer.quiet == 1.0
        assert framer.feed(b"\r") == []
        assert framer.quiet == 0.1
        assert framer.silence() == [READ]
        assert framer.feed(b"\n" + self.good) == [READ]
        assert framer.quiet == 1.0

    def test_lower_case_digits_are_accepted(self) -> None:
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
            accepted, rejected = take(framer, byte)
            frames += accepted
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
        other = self.good[:-1] + b"#"
        assert framer.encode(READ) == other
        assert take(framer, other * 2) == ([READ] * 2, [])
        frames, errors = take(framer, self.good + other)
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
    def test_the_delimiter_changes_with_the_answer(self, answer: str, delimiter: int) -> None:
        assert delimiter_after(bytes.fromhex(answer), 0x24) == delimiter

    @each_case("delimiter", [-1, 128, 256, *b":\r0123456789ABCDEFabcdef"])
    def test_delimiter_with_another_use_is_refused(self, delimiter: int) -> None:
        framer = AsciiFramer()
        assert not is_delimiter(delimiter)
        with pytest.raises(ValueError, match="delimiter"):
            framer.delimiter = delimiter
        assert framer.delimiter == 0x0A

    @each_case("cut", range(1, 16))
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
