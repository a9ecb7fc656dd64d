"""The sizes of frames, and ranges of numbers."""

import pytest

from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, Framing, cut, is_one_frame, make_framer, split

# Application protocol, section 4.1: a PDU has 253 bytes at most; the ADU of a serial line 256,
# that of TCP 260. Serial line, section 2.5.2.1: in ASCII mode 513 characters.
LONGEST: list[tuple[Framing, int]] = [("tcp", 260), ("udp", 260), ("rtu", 256), ("ascii", 513)]

# Function 23 with 125 registers read and 121 written is the longest of the worked functions.
PDU = bytes.fromhex("17 0000 007d 0000 0079 f2") + bytes(242)


@pytest.mark.parametrize(("framing", "size"), LONGEST)
def test_the_longest_frame_has_the_size_that_its_framing_allows(framing, size) -> None:
    framer = make_framer(framing, "client")
    whole = framer.encode(Frame(1, PDU + bytes(253 - len(PDU))))
    assert len(whole) == getattr(framer, "max_size", size) == size  # a stream has no limit
    with pytest.raises(ValueError, match=r"254"):
        framer.encode(Frame(1, bytes(254)))


@pytest.mark.parametrize("framing", dict(LONGEST))
def test_the_longest_request_arrives(framing: Framing) -> None:
    framer = make_framer(framing, "server")
    frames = framer.scan(framer.encode(Frame(1, PDU))) + framer.scan_silence()
    assert [frame[:2] for frame in frames if isinstance(frame, Frame)] == [(1, PDU)]


def errors(framing: Framing, data: bytes) -> list[FrameError]:
    framer = make_framer(framing, "server")
    results = framer.scan(data) + framer.scan_silence()
    assert results
    assert all(isinstance(result, FrameError) for result in results), results
    return [result for result in results if isinstance(result, FrameError)]


def test_only_too_many_characters_are_an_overrun() -> None:
    assert [error.overrun for error in errors("ascii", b":" + b"00" * 300)] == [True]
    assert {error.overrun for error in errors("ascii", b":010300000001FF\r\n")} == {False}
    assert {error.overrun for error in errors("ascii", b":0103zz")} == {False}
    assert {error.overrun for error in errors("rtu", bytes.fromhex("01 03 0000 0001 ffff"))} == {
        False
    }


def mbap(length: int, body: bytes, protocol: int = 0, transaction: int = 7) -> bytes:
    numbers = (transaction, protocol, length)
    return b"".join(number.to_bytes(2, "big") for number in numbers) + body


def test_one_frame_has_the_length_that_its_header_says_and_protocol_0() -> None:
    for size in range(264):  # of the unit and the PDU
        for length in (size - 1, size, size + 1, size ^ 0x100, size + 0x400):
            for protocol in (0, 1, 0x100):
                data = mbap(max(0, length), bytes(size), protocol)
                fits = protocol == 0 and length == size and 2 <= size <= 254
                assert is_one_frame(data) is fits, (size, length, protocol)


def test_the_beginning_of_a_header_is_no_frame() -> None:
    whole = mbap(6, bytes.fromhex("11 03 006B 0003"))
    assert is_one_frame(whole)
    assert not any(is_one_frame(whole[:end]) for end in range(len(whole)))


def test_a_chunk_is_split_into_its_frames() -> None:
    frames = [mbap(1 + size, b"\x11" + b"\x07" * size) for size in (1, 5, 253, 2, 253)]
    assert list(split(b"".join(frames))) == frames
    assert list(split(b"")) == []


def test_frames_are_cut_out_up_to_the_number_that_is_wanted() -> None:
    frames = [mbap(3, bytes([17, 3, at]), transaction=at) for at in range(5)]
    data = b"\xff" + b"".join(frames)
    for most in range(7):
        results: list[Frame | FrameError] = []
        end = cut(data, 1, results, most)
        count = min(most, 5)
        assert results == [Frame(17, bytes([3, at]), at) for at in range(count)]
        assert end == 1 + 9 * count
