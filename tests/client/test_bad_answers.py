"""
Answers that are none: the right error, at the right time, and the next request succeeds.
"""

from __future__ import annotations

import contextlib
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
from tests.support.clients import EVERYWHERE, KINDS, World
from tests.support.peers import Answer, Write, answer, answering, ignore, mbap

GOOD = b"\x03\x06\x02\x2b\x00\x00\x00\x64"
VALUES = [555, 0, 100]
TIMEOUT = 0.5

# What a line needs for an answer of 100 bytes, and for its silences.
ON_LINE = 0.03


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
# Those whose bytes answer another request than the one that was asked.
ANOTHERS = {"other unit", "other transaction", "other function", "exception of another function"}

# A frame of another protocol is skipped, and its request waits on.
WAITED_OUT = {"other protocol"} | {
    name for name, (_, error) in BAD_TCP.items() if error is ModbusTimeoutError
}

CASES = [
    (kind, name) for kind in KINDS for name in BAD_TCP if kind != "native" or name not in WAITED_OUT
]


@pytest.mark.parametrize(("world", "name"), CASES, indirect=["world"])
def test_tcp_error_and_next_request_succeeds(world: World, name: str) -> None:
    bad, error = BAD_TCP[name]
    peer = world.peer("tcp", answering(bad, good_tcp))
    with world.connect(peer.url, timeout=30) as context:
        waited = 30.0 if name in WAITED_OUT else 0.0
        with world.lasting(waited), pytest.raises(error) as caught:
            read(context)
        assert caught.value.unit == 1
        assert caught.value.function == 3
        assert caught.value.sent == peer.requests[0]
        assert caught.value.received == b"".join(bad(peer.requests[0]))
        assert caught.value.answers_another is (name in ANOTHERS)
        assert read(context) == VALUES


@EVERYWHERE
def test_tcp_answer_followed_by_garbage(world: World) -> None:
    def with_garbage(request: bytes) -> list[bytes]:
        return [mbap(request, GOOD) + b"\xde\xad\xbe\xef"]

    peer = world.peer("tcp", answering(with_garbage, with_garbage, good_tcp))
    with world.connect(peer.url) as context:
        for _ in range(4):
            assert read(context) == VALUES


@EVERYWHERE
def test_exception_codes_keep_their_number(world: World) -> None:
    """The address asked is the code answered."""

    def refuse(request: bytes) -> list[bytes]:
        return [mbap(request, bytes([0x83, request[9]]))]

    peer = world.peer("tcp", answering(good_tcp, refuse))
    with world.connect(peer.url) as context:
        read(context)
        for code in range(1, 256):
            with pytest.raises(ExceptionResponse) as caught:
                context.read_holding_registers(code, 3)
            assert caught.value.code == code
            assert caught.value.received[-2:] == bytes([0x83, code])
            assert (type(caught.value) is ExceptionResponse) == (code in (9, *range(12, 256)))


@EVERYWHERE
def test_answer_in_pieces_is_whole(world: World) -> None:
    def in_pieces(request: bytes, write: Write) -> None:
        for at, byte in enumerate(mbap(request, GOOD)):
            write(bytes([byte]), after=at * 0.001)

    peer = world.peer("tcp", in_pieces)
    with world.connect(peer.url) as context:
        for _ in range(3):
            assert read(context) == VALUES


@EVERYWHERE
def test_a_skipped_frame_beside_an_answer_does_not_spoil_the_next_one(world: World) -> None:
    def with_other_protocol(request: bytes, write: Write) -> None:
        write(mbap(request, GOOD, protocol=7) + mbap(request, GOOD))
        peer.on_request = in_pieces

    def in_pieces(request: bytes, write: Write) -> None:
        write(mbap(request, GOOD)[:9], after=0.02)
        write(mbap(request, GOOD)[9:], after=0.04)

    peer = world.peer("tcp", with_other_protocol)
    with world.connect(peer.url) as context:
        for _ in range(3):
            assert read(context) == VALUES
        assert peer.connections == 1


@EVERYWHERE
def test_trickling_answer_does_not_extend_the_deadline(world: World) -> None:
    def trickle(request: bytes, write: Write) -> None:
        for at, byte in enumerate(mbap(request, GOOD)):
            write(bytes([byte]), after=at * 0.3)

    peer = world.peer("tcp", trickle)
    with world.connect(peer.url, timeout=0.2) as context:
        for _ in range(2):
            with world.lasting(0.2), pytest.raises(ModbusTimeoutError):
                read(context)


@EVERYWHERE
def test_timeout_is_kept(world: World) -> None:
    peer = world.peer("tcp", ignore)
    with world.connect(peer.url, timeout=0.2) as context:
        for attempt in range(4):
            with (
                world.lasting(0.2),
                pytest.raises(ModbusTimeoutError, match=r"no answer within 0\.2 s"),
            ):
                read(context)
            assert peer.connections == 1 + (attempt == 3)  # after three in a row


@EVERYWHERE
def test_connection_closed_in_mid_answer(world: World) -> None:
    def half_and_close(request: bytes, write: Write) -> None:
        write(mbap(request, GOOD)[:9])
        write(None)
        peer.on_request = answering(good_tcp)

    peer = world.peer("tcp", answering(good_tcp))
    with world.connect(peer.url, timeout=60) as context:
        read(context)
        peer.on_request = half_and_close
        with world.lasting(0.0), pytest.raises(ModbusConnectionError) as caught:
            read(context)
        assert caught.value.errno
        assert read(context) == VALUES
        assert peer.connections == 2


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
    ("scheme", "frame", "good"), [("rtu", rtu, GOOD_RTU), ("ascii", ascii_frame, GOOD_ASCII)]
)


@pytest.mark.parametrize("name", BAD_SERIAL)
@SERIAL
def test_serial_error_and_next_request_succeeds(
    world: World, name: str, scheme: str, frame: Callable[..., Answer], good: Answer
) -> None:
    body, spoil, error = BAD_SERIAL[name]
    bad = frame(body, spoil)
    # What answers another unit or function does not end the wait, for the own answer may follow.
    waited = TIMEOUT if "other" in name else 0.0
    # Without an answer the line must have been quiet for a time-out before the unit is asked again.
    quiet = 0.0 if issubclass(error, ExceptionResponse) else TIMEOUT
    unit = world.peer(scheme, answering(good, bad, good))
    with world.connect(unit.url, timeout=TIMEOUT) as context:
        assert read(context) == VALUES
        with world.lasting(waited, more=ON_LINE), pytest.raises(error) as caught:
            read(context)
        assert caught.value.sent == unit.requests[1]
        assert caught.value.received == bad(b"")[0]
        assert caught.value.answers_another is (name in ANOTHERS)
        if name == "unknown exception":
            assert caught.value.code == 0x77  # type: ignore[attr-defined]
        with world.lasting(quiet, more=ON_LINE):
            assert read(context) == VALUES


@SERIAL
@pytest.mark.parametrize("world", ["native"], indirect=True)
@pytest.mark.parametrize("name", ["wrong check", "exception"])
def test_serial_error_through_c(
    world: World, name: str, scheme: str, frame: Callable[..., Answer], good: Answer
) -> None:
    body, spoil, error = BAD_SERIAL[name]
    unit = world.peer(scheme, answering(good, frame(body, spoil)))
    with world.connect(unit.url, timeout=30) as context:
        assert read(context) == VALUES
        with pytest.raises(error) as caught:
            read(context)
        assert caught.value.sent == unit.requests[1]
        assert caught.value.received == frame(body, spoil)(b"")[0]


@EVERYWHERE
@SERIAL
def test_serial_noise_and_other_units_before_the_answer_do_not_matter(
    world: World, scheme: str, frame: Callable[..., Answer], good: Answer
) -> None:
    stranger = frame("09 0302FFFF")(b"")
    unit = world.peer(
        scheme, answering(lambda request: [b"\x00\xff\x55", *stranger, *good(request)])
    )
    with world.connect(unit.url, timeout=30) as context, world.lasting(0.0, more=2 * ON_LINE):
        assert read(context) == VALUES


@SERIAL
@pytest.mark.parametrize("trouble", ["noise before", "garbage behind", "half", "nothing"])
def test_serial_resynchronises_after_trouble(
    world: World, trouble: str, scheme: str, frame: Callable[..., Answer], good: Answer
) -> None:
    def troubled(request: bytes) -> list[bytes]:
        (data,) = good(request)
        return {
            "noise before": [b"\x00" + data],
            "garbage behind": [data + b"\x01\x03\x06\xff"],
            "half": [data[: len(data) // 2]],
            "nothing": [],
        }[trouble]

    unit = world.peer(scheme, answering(good, good, troubled, good))
    with world.connect(unit.url, timeout=TIMEOUT) as context:
        assert read(context) == VALUES
        assert read(context) == VALUES
        try:
            assert read(context) == VALUES
        except ModbusError as error:
            assert not isinstance(error, ExceptionResponse)  # noqa: PT017
        for _ in range(3):
            assert read(context) == VALUES


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
def test_serial_late_answers_never_answer_another_request(world: World, scheme: str) -> None:
    """Each comes 50 ms after the time-out; then the unit is quiet for a time-out."""
    delay = 0.0

    def slow(request: bytes, write: Write) -> None:
        write(answer(request, scheme), after=delay)

    unit = world.peer(scheme, slow)
    with world.connect(unit.url, timeout=TIMEOUT) as context:
        assert context.read_holding_registers(76, 1) == [76]
        delay = TIMEOUT + 0.05
        for address in range(20):
            with pytest.raises(ModbusTimeoutError):
                context.read_holding_registers(address, 1)
        delay = 0.0
        with world.lasting(0.05 + TIMEOUT, more=ON_LINE):
            assert context.read_holding_registers(77, 1) == [77]
        assert context.late_answers == 20


@pytest.mark.parametrize("world", ["native"], indirect=True)
def test_a_late_answer_on_a_line_through_c(world: World) -> None:
    """It counts as an answer only where this process was too busy to find it late."""

    delay = 0.0

    def slow(request: bytes, write: Write) -> None:
        write(answer(request, "rtu"), after=delay)

    unit = world.peer("rtu", slow)
    with world.connect(unit.url, timeout=30) as context:
        assert context.read_holding_registers(76, 1) == [76]
        context.timeout = 0.2
        delay = 0.3
        for address in range(2):
            with contextlib.suppress(ModbusTimeoutError):
                assert context.read_holding_registers(address, 1) == [address]
        context.timeout = 30
        unit.on_request = answering(lambda request: [answer(request, "rtu")])
        assert context.read_holding_registers(77, 1) == [77]
