"""Frames of units and bodies, as `driver` computes them, and framers fed with their bytes."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import AsciiFramer, Frame, RtuFramer, TcpFramer
from tests.support import driver
from tests.support.cases import each_case

NO_REQUESTS = [
    "80", "80 01", "83 02", "FF", "FF 0B", "80 01 02", "83 02 00", "81 00 00 00 00", "AB 0E 01",
    "FF" + "00" * 20, "90" + "A5" * 120, "83" + "11" * 252,
]  # fmt: skip
"""Bodies with a function that no request has, and data of any length."""

AnyFramer = TcpFramer | RtuFramer | AsciiFramer


def take(framer: AnyFramer, data: bytes = b"") -> tuple[list[Frame], list[FrameError]]:
    """Feed bytes, and go on until the framer has nothing more to say about them."""
    frames: list[Frame] = []
    errors: list[FrameError] = []
    while True:
        try:
            results = framer.feed(data)
        except FrameError as error:
            errors.append(error)
            if not framer.in_step:
                return frames, errors
            results = []
        else:
            if not results:
                return frames, errors
        frames += results
        data = b""


def after_silence(framer: AnyFramer) -> list[Frame]:
    """Return the frames that silence ends; its errors do not matter here."""
    frames: list[Frame] = []
    with contextlib.suppress(FrameError):
        frames += framer.silence()
    return frames + take(framer)[0]


def frames_in(framer: AnyFramer, data: bytes) -> list[Frame]:
    """Frames in bytes that silence follows, and no errors."""
    frames, errors = take(framer, data)
    frames += framer.silence()
    assert errors == []
    return frames


def single_bytes(data: bytes) -> Iterator[bytes]:
    return (data[at : at + 1] for at in range(len(data)))


def pieces(data: bytes, sizes: list[int]) -> Iterator[bytes]:
    """Pieces of these sizes, and the rest."""
    at = 0
    for size in sizes:
        yield data[at : at + size]
        at += size
    yield data[at:]


def feed_bytes(framer: AnyFramer, data: bytes) -> list[Frame]:
    """Return the frames that the last byte completes; none is complete before."""
    for byte in single_bytes(data[:-1]):
        assert framer.feed(byte) == []
    return framer.feed(data[-1:])


def frames_in_bytes(framer: AnyFramer, data: bytes) -> list[Frame]:
    """Return the frames that the last byte, or silence behind it, completes."""
    return feed_bytes(framer, data) + framer.silence()


def rtu(unit: int, body: bytes) -> bytes:
    return driver.rtu((bytes([unit]) + body).hex())


def ascii_frame(unit: int, body: bytes, end: bytes = b"\r\n") -> bytes:
    return driver.ascii_frame((bytes([unit]) + body).hex(), end)


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


@contextlib.contextmanager
def registration(rule: Callable[[bytes], Any]) -> Iterator[type[pdu.RawRequest]]:
    """A class of one's own, function 6Dh, whose messages are as long as the rule says."""

    class Own(pdu.RawRequest):
        function = 0x6D
        request_length = staticmethod(rule)  # type: ignore[assignment]
        response_length = staticmethod(rule)  # type: ignore[assignment]

    try:
        yield pdu.register(Own)
    finally:
        pdu.REQUESTS.pop(Own.function)


ALL_FRAMERS: dict[str, Callable[[], AnyFramer]] = {
    "tcp": TcpFramer,
    "rtu server": lambda: RtuFramer("server"),
    "rtu client": lambda: RtuFramer("client"),
    "ascii": AsciiFramer,
}
each_framer = each_case("make", ALL_FRAMERS.values(), ids=ALL_FRAMERS)
