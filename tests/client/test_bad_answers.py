"""Answers that are none: the right error, at the right time, and the next request succeeds."""

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
from tests.support.clients import World, read
from tests.support.peers import Answer, Write, answer, answering, mbap

GOOD = b"\x03\x06\x02\x2b\x00\x00\x00\x64"
VALUES = [555, 0, 100]
TIMEOUT = 0.5

# The time on a line for an answer of 100 bytes, and for its silences.
ON_LINE = 0.03


def good_tcp(request: bytes) -> list[bytes]:
    return [mbap(request, GOOD)]


def tcp(pdu: bytes, **fields: int) -> Answer:
    return lambda request: [mbap(request, pdu, **fields)]


def values(context: Any) -> Any:
    return context.read_holding_registers(107, 3)


def rtu(body: str, spoil: int = 0) -> Answer:
    data = bytes.fromhex(body)
    crc = framing.crc16(data) ^ spoil
    return lambda request: [data + crc.to_bytes(2, "little")]


def ascii_frame(body: str, spoil: int = 0) -> Answer:
    data = bytes.fromhex(body)
    digits = (data + bytes([framing.lrc(data) ^ spoil])).hex().upper()
    return lambda request: [f":{digits}\r\n".encode()]


GOOD_SERIAL = "01 0306022B00000064"

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
    "length too long by two": (tcp(GOOD, length=len(GOOD) + 3), ModbusTimeoutError),
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
# Those whose bytes would answer another request.
ANOTHERS = {"other unit", "other transaction", "other function", "exception of another function"}

# A frame of another protocol is skipped, and the request still waits.
WAITED_OUT = {"other protocol"} | {
    name for name, (_, error) in BAD_TCP.items() if error is ModbusTimeoutError
}


@pytest.mark.parametrize("name", BAD_TCP)
def test_tcp_error_and_next_request_succeeds(world: World, name: str) -> None:
    bad, error = BAD_TCP[name]
    peer = world.peer("tcp", answering(bad, good_tcp))
    with world.connect(peer.url, timeout=30) as context:
        waited = 30.0 if name in WAITED_OUT else 0.0
        with world.lasting(waited), pytest.raises(error) as caught:
            values(context)
        assert caught.value.unit == 1
        assert caught.value.function == 3
        assert caught.value.sent == peer.requests[0]
        assert caught.value.received == b"".join(bad(peer.requests[0]))
        assert caught.value.answers_another is (name in ANOTHERS)
        assert values(context) == VALUES


@pytest.mark.parametrize("scheme", ["tcp", "tls", "udp", "unix"])
def test_a_response_whose_header_counts_one_byte_too_many_is_accepted(world: World, scheme) -> None:
    """wlcrs/tmodbus#146: exceptions of 9 bytes whose header says 4 in place of 3."""
    refusal, response = tcp(b"\x83\x02", length=4), tcp(GOOD, length=len(GOOD) + 2)
    peer = world.peer(scheme, answering(refusal, refusal, response, response))
    with world.connect(peer.url) as context:
        for _ in range(2):
            with world.lasting(0, 0.01), pytest.raises(IllegalDataAddress):
                values(context)
        with world.lasting(0, 0.01):
            assert [values(context) for _ in range(2)] == [VALUES] * 2
    assert peer.connections <= 1


def test_a_byte_after_an_exception_response_is_dropped(world: World) -> None:
    def refuse(request: bytes, write: Write) -> None:
        write(mbap(request, b"\x83\x02", length=4))
        write(b"\0", after=0.1)
        peer.on_request = answering(good_tcp)

    peer = world.peer("tcp", refuse)
    with world.connect(peer.url, retries=1) as context:
        with pytest.raises(IllegalDataAddress):
            values(context)
        world.sleep(0.2)
        for _ in range(3):
            assert values(context) == VALUES
    assert peer.connections == 1


def test_a_write_whose_echo_has_one_byte_too_many_was_carried_out(world: World) -> None:
    """IndustrialShields/arduino-Tools40#7: function 6 is answered with a stray byte, counted."""
    peer = world.peer("tcp", answering(lambda request: [mbap(request, request[7:] + b"\6")]))
    with world.connect(peer.url) as context:
        context.write_register(0, 7)
        context.write_coil(0, True)
    peer.on_request = answering(lambda request: [mbap(request, b"\x06\0\0\0\x08\6")])
    with (
        world.connect(peer.url) as context,
        pytest.raises(InvalidResponse, match="6 bytes: 06 00 00 00 08 06"),
    ):
        context.write_register(0, 7)


def test_tcp_answer_followed_by_garbage(world: World) -> None:
    def with_garbage(request: bytes) -> list[bytes]:
        return [mbap(request, GOOD) + b"\xde\xad\xbe\xef"]

    with world.client_of("tcp", answering(with_garbage, with_garbage, good_tcp)) as context:
        for _ in range(4):
            assert values(context) == VALUES


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
            assert values(context) == VALUES
        assert peer.connections == 1


def test_trickling_answer_does_not_extend_the_deadline(world: World) -> None:
    def trickle(request: bytes, write: Write) -> None:
        for at, byte in enumerate(mbap(request, GOOD)):
            write(bytes([byte]), after=at * 0.3)

    with world.client_of("tcp", trickle, timeout=0.2) as context:
        for _ in range(2):
            with world.lasting(0.2), pytest.raises(ModbusTimeoutError):
                values(context)


def test_connection_closed_in_mid_answer(world: World) -> None:
    def half_and_close(request: bytes, write: Write) -> None:
        write(mbap(request, GOOD)[:9])
        write(None)
        peer.on_request = answering(good_tcp)

    peer = world.peer("tcp", answering(good_tcp))
    with world.connect(peer.url, timeout=60) as context:
        values(context)
        peer.on_request = half_and_close
        with world.lasting(0.0), pytest.raises(ModbusConnectionError) as caught:
            values(context)
        assert caught.value.errno
        assert values(context) == VALUES
        assert peer.connections == 2


BAD_SERIAL: dict[str, tuple[str, int, type[ModbusError]]] = {
    # unit and PDU, what the check bytes are spoilt with, and the error
    "wrong check": (GOOD_SERIAL, 1, FrameError),
    "other unit": ("09 0306022B00000064", 0, InvalidResponse),
    "other function": ("01 0406022B00000064", 0, InvalidResponse),
    "fewer registers": ("01 0304022B0000", 0, InvalidResponse),
    "exception of another function": ("01 8402", 0, InvalidResponse),
    "exception": ("01 8302", 0, IllegalDataAddress),
    "unknown exception": ("01 8377", 0, ExceptionResponse),
}


FRAMES = {"rtu": rtu, "ascii": ascii_frame}

SERIAL = pytest.mark.parametrize("scheme", FRAMES)


@pytest.mark.parametrize("name", BAD_SERIAL)
@SERIAL
def test_serial_error_and_next_request_succeeds(world: World, name: str, scheme: str) -> None:
    body, spoil, error = BAD_SERIAL[name]
    bad, good = FRAMES[scheme](body, spoil), FRAMES[scheme](GOOD_SERIAL)
    # What answers another unit or function does not end the wait, for the own answer may follow.
    waited = TIMEOUT if "other" in name else 0.0
    unit = world.peer(scheme, answering(good, bad, good))
    with world.connect(unit.url, timeout=TIMEOUT) as context:
        assert values(context) == VALUES
        with world.lasting(waited, more=ON_LINE), pytest.raises(error) as caught:
            values(context)
        assert caught.value.sent == unit.requests[1]
        assert caught.value.received == bad(b"")[0]
        assert caught.value.answers_another is (name in ANOTHERS)
        if name == "unknown exception":
            assert caught.value.code == 0x77  # type: ignore[attr-defined]
        # The unit is silent for a few times its slowest answer; then its answer is held.
        with world.lasting(0.0, more=7 * ON_LINE):
            assert values(context) == VALUES


@SERIAL
@pytest.mark.parametrize("trouble", ["noise before", "garbage behind", "half", "nothing"])
def test_serial_resynchronises_after_trouble(world: World, trouble: str, scheme: str) -> None:
    good = FRAMES[scheme](GOOD_SERIAL)

    def troubled(request: bytes) -> list[bytes]:
        (data,) = good(request)
        return {
            "noise before": [b"\x00" + data],
            "garbage behind": [data + b"\x01\x03\x06\xff"],
            "half": [data[: len(data) // 2]],
            "nothing": [],
        }[trouble]

    with world.client_of(scheme, answering(good, good, troubled, good), timeout=TIMEOUT) as context:
        assert values(context) == VALUES
        assert values(context) == VALUES
        try:
            assert values(context) == VALUES
        except ModbusError as error:
            assert not isinstance(error, ExceptionResponse)  # noqa: PT017
        for _ in range(3):
            assert values(context) == VALUES


STRAYS: dict[str, Callable[[bytes], bytes]] = {
    "00": lambda request: b"\x00",
    "FF": lambda request: b"\xff",
    "FE 00": lambda request: b"\xfe\x00",
    "00 FF 55": lambda request: b"\x00\xff\x55",
    "01": lambda request: b"\x01",
    "01 03": lambda request: b"\x01\x03",
    "unit": lambda request: answer(request, "rtu", unit=9),
    "echo": lambda request: request,
    "00 and echo": lambda request: b"\x00" + request,
}


@pytest.mark.parametrize("pause", [0, 0.03])
@pytest.mark.parametrize("stray", STRAYS)
def test_noise_before_each_answer_on_a_line_is_dropped(stray, pause, world: World) -> None:
    """Changing direction, a transceiver adds bytes; a pause is longer than the framer's silence."""

    def strayed(request: bytes, write: Write) -> None:
        write(STRAYS[stray](request) + (b"" if pause else answer(request, "rtu")))
        if pause:
            write(answer(request, "rtu"), after=pause)

    with world.client_of("rtu", strayed) as client:
        assert [read(client, address) for address in range(40)] == list(range(40))


def test_a_late_answer_during_a_request_does_not_fail_the_request(world: World) -> None:
    """The answer comes while the second request after its own one waits."""
    owed = b""

    def late(request: bytes, write: Write) -> None:
        nonlocal owed
        address = int.from_bytes(request[8:10], "big")
        if address == 7:
            owed = answer(request, "tcp")
        elif address == 3:
            write(owed, after=0.02)
            write(answer(request, "tcp"), after=0.04)
        else:
            write(answer(request, "tcp"))

    peer = world.peer("tcp", late)
    with world.connect(peer.url, timeout=30) as client:
        for _ in range(3):
            assert read(client, 1) == 1
            client.timeout = 0.05
            with world.lasting(0.05), pytest.raises(ModbusTimeoutError):
                read(client, 7)
            client.timeout = 30
            with world.lasting(0.04):
                assert [read(client, address) for address in (2, 3)] == [2, 3]
        assert client.statistics.late_answers == 3
        assert peer.connections == 1


def test_a_device_that_is_unit_255_is_reached_with_an_option(world: World) -> None:
    peer = world.peer("tcp", answering(lambda request: [answer(request, "tcp", unit=255)]))
    with (
        world.connect(peer.url, unit=3) as client,
        pytest.raises(ModbusError, match='accept_unit="any"') as caught,
    ):
        read(client, 1)
    assert caught.value.received[6] == 255
    for options, query in (({"accept_unit": "any"}, ""), ({}, "?accept_unit=any")):
        with world.connect(peer.url + query, unit=3, **options) as client:
            assert [read(client, address) for address in range(5)] == list(range(5))


def test_frames_that_came_between_two_requests_answer_neither(world: World) -> None:
    """A busy program drops unrequested frames before it sends a request."""

    def twice(request: bytes, write: Write) -> None:
        write(answer(request, "rtu+tcp"))
        write(answer(b"\1\3\0\x63", "rtu+tcp"), after=0.05)

    with world.client_of("rtu+tcp", twice, timeout=1.0) as client:
        client.connect()
        world.compute(0.1)  # the line has no history, and answers to other programs are over
        for address in range(5):
            assert read(client, address) == address
            world.compute(0.1)
