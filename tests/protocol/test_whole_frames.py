"""
Chunks of whole frames with MBAP headers (MODBUS Messaging on TCP/IP V1.0b, 3.1.3), cut without a
framer.
"""

from __future__ import annotations

from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, cut, is_one_frame, split


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


def test_as_many_frames_are_cut_out_as_are_wanted() -> None:
    frames = [mbap(3, bytes([17, 3, at]), transaction=at) for at in range(5)]
    data = b"\xff" + b"".join(frames)
    for most in range(7):
        found: list[Frame | FrameError] = []
        end = cut(data, 1, found, most)
        count = min(most, 5)
        assert found == [Frame(17, bytes([3, at]), at) for at in range(count)]
        assert end == 1 + 9 * count
