"""
Answers that are none: the right error, and the next request on the same context succeeds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    ExceptionResponse,
    FrameError,
    IllegalDataAddress,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    framing,
)
from tests.support.clients import Connect
from tests.support.fake import Answer, FakeServer, FakeUnit, mbap
from tests.support.pace import LATE

GOOD = b"\x03\x06\x02\x2b\x00\x00\x00\x64"
VALUES = [555, 0, 100]
TIMEOUT = 0.5


def good_tcp(request: bytes) -> list[bytes]:
    return [mbap(request, GOOD)]


def tcp(pdu: bytes, **changed: int) -> Answer:
    return lambda request: [mbap(request, pdu, **changed)]


def read(context: Any) -> Any:
    return context.read_holding_registers(107, 3)


def rtu(body: str, spoil: int = 0) -> Answer:
    data = bytes.fromhex(body)
    crc = framing.crc16(data) ^ spoil
    return lambda request: [data + crc.to_bytes(2, "little")]


def ascii_frame(body: str, spoil: int = 0) -> Answer:
    data = bytes.fromhex(body)
    digits = (data + bytes([framing.lrc(data) ^ spoil])).hex().upper()
    return lambda request: [f":{digits}\r\n".encode()]


GOOD_RTU = rtu("01 0306022B00000064")
GOOD_ASCII = ascii_frame("01 0306022B00000064")

# What is answered -> the error, where each request meets a fresh context.
BAD_TCP: dict[str, tuple[Answer, type[ModbusError]]] = {
    "other unit": (tcp(GOOD, unit=9), InvalidResponse),
    "other function": (tcp(b"\x04" + GOOD[1:]), InvalidResponse),
    "other transaction": (tcp(GOOD, transaction=7), ModbusTimeoutError),
    "other protocol": (tcp(GOOD, protocol=7), FrameError),
    "length 0": (tcp(GOOD, length=0), FrameError),
    "length 1": (tcp(GOOD, length=1), FrameError),
    "length 255": (tcp(GOOD, length=255), FrameError),
    "length 65535": (tcp(GOOD, length=65535), FrameError),
    "length too short by one": (tcp(GOOD, length=len(GOOD)), InvalidResponse),
    "length too long by one": (tcp(GOOD, length=len(GOOD) + 2), ModbusTimeoutError),
    "fewer registers": (tcp(b"\x03\x04\x02\x2b\x00\x00"), InvalidResponse),
    "more registers": (tcp(b"\x03\x08" + bytes(8)), InvalidResponse),
    "lying byte count": (tcp(b"\x03\xff\x02\x2b\x00\x00\x00\x64"), InvalidResponse),
    "function alone": (tcp(b"\x03"), InvalidResponse),
    "exception without a code": (tcp(b"\x83"), InvalidResponse),
    "exception of another function": (tcp(b"\x84\x02"), InvalidResponse),
    "half an answer": (lambda request: [good_tcp(request)[0][:10]], ModbusTimeoutError),
    "half a header": (lambda request: [good_tcp(request)[0][:3]], ModbusTimeoutError),
    "nothing": (lambda request: [], ModbusTimeoutError),
    "random bytes": (lambda request: [b"\xde\xad\xbe\xef" * 5], FrameError),
}


@pytest.mark.parametrize("name", BAD_TCP)
def test_tcp_error_and_next_request_succeeds(connect: Connect, name: str) -> None:
    answer, error = BAD_TCP[name]
    with (
        FakeServer(answer, good_tcp) as server,
        connect(server.url, timeout=TIMEOUT) as context,
    ):
        with pytest.raises(error) as caught:
            read(context)
        assert caught.value.unit == 1
        assert caught.value.function == 3
        assert caught.value.sent == server.requests[0]
        assert caught.value.received == b"".join(answer(server.requests[0]))
        assert read(context) == VALUES


def test_tcp_answer_followed_by_garbage(connect: Connect) -> None:
    def with_garbage(request: bytes) -> list[bytes]:
        return [mbap(request, GOOD) + b"\xde\xad\xbe\xef"]

    with (
        FakeServer(with_garbage, with_garbage, good_tcp) as server,
        connect(server.url, timeout=TIMEOUT) as context,
    ):
        for _ in range(4):
            assert read(context) == VALUES


def test_exception_codes_keep_their_number(connect: Connect) -> None:
    """The address asked is the code answered."""

    def refuse(request: bytes) -> list[bytes]:
        return [mbap(request, bytes([0x83, request[9]]))]

    with (
        FakeServer(good_tcp, refuse) as server,
        connect(server.url) as context,
    ):
        read(context)
        for code in range(1, 256):
            with pytest.raises(ExceptionResponse) as caught:
                context.read_holding_registers(code, 3)
            assert caught.value.code == code
            assert caught.value.received[-2:] == bytes([0x83, code])
            assert (type(caught.value) is ExceptionResponse) == (code in (9, *range(12, 256)))


def test_answer_in_pieces_is_whole(connect: Connect) -> None:
    def in_pieces(request: bytes) -> list[bytes]:
        return [bytes([byte]) for byte in mbap(request, GOOD)]

    with (
        FakeServer(in_pieces) as server,
        connect(server.url) as context,
    ):
        for _ in range(3):
            assert read(context) == VALUES


def test_a_skipped_frame_beside_an_answer_does_not_spoil_the_next_one(connect: Connect) -> None:
    def with_other_protocol(request: bytes) -> list[bytes]:
        return [mbap(request, GOOD, protocol=7) + mbap(request, GOOD)]

    def in_pieces(request: bytes) -> list[bytes]:
        class Slow(list[bytes]):
            def __iter__(self):  # type: ignore[no-untyped-def]
                for piece in (mbap(request, GOOD)[:9], mbap(request, GOOD)[9:]):
                    time.sleep(0.02)
                    yield piece

        return Slow()

    with (
        FakeServer(with_other_protocol, in_pieces) as server,
        connect(server.url) as context,
    ):
        for _ in range(3):
            assert read(context) == VALUES
        assert server.connections == 1


def test_trickling_answer_does_not_extend_the_deadline(connect: Connect) -> None:
    def trickle(request: bytes) -> list[bytes]:
        class Slow(list[bytes]):
            def __iter__(self):  # type: ignore[no-untyped-def]
                for byte in mbap(request, GOOD):
                    time.sleep(0.05)
                    yield bytes([byte])

        return Slow()

    with (
        FakeServer(trickle) as server,
        connect(server.url, timeout=0.2) as context,
    ):
        context.connect()
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError):
            read(context)
        assert time.monotonic() - start < 0.2 + LATE


def test_timeout_is_kept(connect: Connect) -> None:
    with (
        FakeServer(lambda request: []) as server,
        connect(server.url, timeout=0.2) as context,
    ):
        for _ in range(4):
            start = time.monotonic()
            with pytest.raises(ModbusTimeoutError, match=r"no answer within 0\.2 s"):
                read(context)
            assert 0.19 < time.monotonic() - start < 0.2 + LATE


def test_connection_closed_in_mid_answer(connect: Connect) -> None:
    def half_and_close(request: bytes) -> list[bytes]:
        class Closing(list[bytes]):
            def __iter__(self):  # type: ignore[no-untyped-def]
                yield mbap(request, GOOD)[:9]
                raise OSError

        return Closing()

    with (
        FakeServer(good_tcp, half_and_close, good_tcp) as server,
        connect(server.url, timeout=20) as context,
    ):
        read(context)
        start = time.monotonic()
        with pytest.raises(ModbusConnectionError) as caught:
            read(context)
        assert caught.value.errno
        assert time.monotonic() - start < LATE
        assert read(context) == VALUES
        assert server.connections == 2


def test_connection_closed_while_idle_is_made_again(connect: Connect) -> None:
    def and_close(request: bytes) -> list[bytes]:
        class Closing(list[bytes]):
            def __iter__(self):  # type: ignore[no-untyped-def]
                yield mbap(request, GOOD)
                raise OSError

        return Closing()

    with (
        FakeServer(and_close) as server,
        connect(server.url) as context,
    ):
        for _ in range(3):
            assert read(context) == VALUES
            time.sleep(0.02)  # let the end of the connection arrive
        assert server.connections == 3


def test_late_answers_never_answer_another_request(connect: Connect) -> None:
    """Each answer comes 50 ms after the timeout, and is the value of the address asked."""
    slow = slow_server(TIMEOUT + 0.05)
    with (
        FakeServer(slow) as server,
        connect(server.url, timeout=TIMEOUT) as context,
    ):
        outcomes = {"right": 0, "wrong": 0, "failed": 0}
        for address in range(10):
            try:
                right = context.read_holding_registers(address, 1) == [address]
                outcomes["right" if right else "wrong"] += 1
            except ModbusError:
                outcomes["failed"] += 1
        assert outcomes["wrong"] == 0
        slow.delay = 0  # type: ignore[attr-defined]
        time.sleep(TIMEOUT * 2)
        assert context.read_holding_registers(77, 1) == [77]
        for address in range(5):
            assert context.read_holding_registers(address, 1) == [address]


def slow_server(delay: float) -> Answer:
    """Answers the address as the value, after a delay that can be changed."""

    class Slow:
        def __init__(self) -> None:
            self.delay = delay

        def __call__(self, request: bytes) -> list[bytes]:
            time.sleep(self.delay)
            # The server reads what had queued up as one piece: answer all of it.
            return [
                mbap(request[at : at + 12], b"\x03\x02" + request[at + 8 : at + 10])
                for at in range(0, len(request), 12)
            ]

    return Slow()


# --- serial lines --------------------------------------------------------------------

BAD_SERIAL: dict[str, tuple[str, int, type[ModbusError]]] = {
    # unit and PDU, what the check bytes are spoilt with, and the error
    "wrong check": ("01 0306022B00000064", 1, FrameError),
    "other unit": ("09 0306022B00000064", 0, InvalidResponse),
    "other function": ("01 0406022B00000064", 0, InvalidResponse),
    "fewer registers": ("01 0304022B0000", 0, InvalidResponse),
    "exception of another function": ("01 8402", 0, InvalidResponse),
    "exception": ("01 8302", 0, IllegalDataAddress),
    "unknown exception": ("01 8377", 0, ExceptionResponse),
}


SERIAL = pytest.mark.parametrize(
    ("kind", "frame", "good"), [("rtu", rtu, GOOD_RTU), ("ascii", ascii_frame, GOOD_ASCII)]
)


def on_line(connect: Connect, kind: str, unit: FakeUnit) -> Any:
    return connect(f"{kind}://{unit.path}?baudrate=115200", timeout=TIMEOUT)


@pytest.mark.parametrize("name", BAD_SERIAL)
@SERIAL
def test_serial_error_and_next_request_succeeds(
    connect: Connect, name: str, kind: str, frame: Callable[..., Answer], good: Answer
) -> None:
    body, spoil, error = BAD_SERIAL[name]
    bad = frame(body, spoil)
    with FakeUnit(good, bad, good) as unit, on_line(connect, kind, unit) as context:
        assert read(context) == VALUES
        with pytest.raises(error) as caught:
            read(context)
        assert caught.value.sent == unit.requests[1]
        assert caught.value.received == bad(b"")[0]
        if name == "unknown exception":
            assert caught.value.code == 0x77  # type: ignore[attr-defined]
        assert read(context) == VALUES


@SERIAL
def test_serial_noise_and_other_units_before_the_answer_do_not_matter(
    connect: Connect, kind: str, frame: Callable[..., Answer], good: Answer
) -> None:
    stranger = frame("09 0302FFFF")(b"")
    noisy: Answer = lambda request: [b"\x00\xff\x55", *stranger, *good(request)]  # noqa: E731
    with FakeUnit(noisy) as unit, on_line(connect, kind, unit) as context:
        assert read(context) == VALUES


@SERIAL
@pytest.mark.parametrize("trouble", ["noise before", "garbage behind", "half", "nothing"])
def test_serial_resynchronises_after_trouble(
    connect: Connect, trouble: str, kind: str, frame: Callable[..., Answer], good: Answer
) -> None:
    def troubled(request: bytes) -> list[bytes]:
        (data,) = good(request)
        return {
            "noise before": [b"\x00" + data],
            "garbage behind": [data + b"\x01\x03\x06\xff"],
            "half": [data[: len(data) // 2]],
            "nothing": [],
        }[trouble]

    with (
        FakeUnit(good, good, troubled, good) as unit,
        on_line(connect, kind, unit) as context,
    ):
        assert read(context) == VALUES
        assert read(context) == VALUES
        try:
            assert read(context) == VALUES
        except ModbusError as error:
            assert not isinstance(error, ExceptionResponse)  # noqa: PT017
        for _ in range(3):
            assert read(context) == VALUES


@SERIAL
def test_serial_late_answers_never_answer_another_request(
    connect: Connect, kind: str, frame: Callable[..., Answer], good: Answer
) -> None:
    class Slow:
        delay = TIMEOUT + 0.05

        def __call__(self, request: bytes) -> list[bytes]:
            address = request[2:4] if kind == "rtu" else bytes.fromhex(request[5:9].decode())
            time.sleep(self.delay)
            return frame(f"01 0302{address.hex()}")(request)

    slow = Slow()
    with FakeUnit(slow) as unit, on_line(connect, kind, unit) as context:
        for address in range(6):
            with contextlib.suppress(ModbusTimeoutError):
                assert context.read_holding_registers(address, 1) == [address]
        slow.delay = 0
        assert context.read_holding_registers(77, 1) == [77]
        assert context.late_answers > 0


@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_serial_timeout_is_kept(connect: Connect, kind: str) -> None:
    with FakeUnit(lambda request: []) as unit, on_line(connect, kind, unit) as context:
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError):
            read(context)
        assert TIMEOUT - 0.01 < time.monotonic() - start < TIMEOUT + LATE
