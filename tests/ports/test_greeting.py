"""
What devices send that is no Modbus, in pieces of any size.
"""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.ports.greeting import Greeting, greeting_of
from tests.support.cases import each_case
from tests.support.talk import rtu

IMEI = b"865123456789012"
HEARTBEAT = b"www.usr.cn"
MBAP = bytes.fromhex("000100000005 11 03 02 022B")  # the answer 555 of unit 17
LONG = bytes.fromhex("0002000000FB 11 03 F8") + IMEI * 16 + bytes(8)  # a text as the greeting
RTU = rtu("11 03 02 022B")


@each_case(
    ("text", "greeting"),
    [
        ("20 bytes", (20, ())),
        ("1 byte", (1, ())),
        ("20bytes", (20, ())),
        ("865123456789012", (0, (IMEI,))),
        ("20 bytes,www.usr.cn", (20, (HEARTBEAT,))),
        ("0x0123456789,ping", (0, (bytes.fromhex("0123456789"), b"ping"))),
        ("Zähler", (0, ("Zähler".encode(),))),
    ],
)
def test_items_of_a_greeting(text: str, greeting: Any) -> None:
    assert greeting_of("greeting", text) == greeting


@each_case(
    ("text", "reason"),
    [
        (20, "greeting must be a string, not int"),
        ("", "greeting must be such as"),
        ("a,,b", "greeting must be such as"),
        ("0x", "greeting must be such as"),
        ("0x123", "greeting must have pairs of hex"),
    ],
)
def test_what_is_no_greeting_is_refused(text: Any, reason: str) -> None:
    with pytest.raises((TypeError, ValueError), match=reason):
        greeting_of("greeting", text)


def frames(greeting: Greeting, data: bytes, size: int) -> bytes:
    greeting.begin()
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    return b"".join(map(greeting.drop, pieces))


@given(st.lists(st.sampled_from([IMEI, HEARTBEAT, MBAP, LONG]), max_size=6), st.integers(1, 300))
def test_texts_between_frames_with_a_header_are_dropped(parts: list[bytes], size: int) -> None:
    """Also from the middle of what was received together; a frame may contain such a text."""
    greeting = Greeting(0, (IMEI, HEARTBEAT), has_header=True)
    expected = b"".join(part for part in parts if part in (MBAP, LONG))
    assert frames(greeting, b"".join(parts), size) == expected


@each_case("chunks", [[IMEI, RTU], [IMEI + RTU], [RTU + HEARTBEAT], [IMEI[:4], IMEI[4:], RTU]])
def test_texts_around_a_frame_of_a_line_are_dropped(chunks: list[bytes]) -> None:
    greeting = Greeting(0, (IMEI, HEARTBEAT), has_header=False)
    assert b"".join(map(greeting.drop, chunks)) == RTU


def test_an_answer_of_a_line_that_comes_in_pieces_is_passed_on() -> None:
    greeting = Greeting(0, (IMEI, HEARTBEAT), has_header=False)
    assert frames(greeting, RTU, 1) == RTU


@each_case("size", [1, 7, 20, 100])
def test_the_first_bytes_of_each_connection_are_dropped(size: int) -> None:
    greeting = Greeting(20, (), has_header=True)
    for _ in range(2):
        assert frames(greeting, bytes(20) + MBAP, size) == MBAP


def test_a_frame_may_begin_behind_what_was_none() -> None:
    greeting = Greeting(0, (HEARTBEAT,), has_header=True)
    greeting.drop(b"hello, this is no frame")
    greeting.expect_frame()
    assert greeting.drop(HEARTBEAT + MBAP) == MBAP


def test_texts_may_follow_the_first_bytes() -> None:
    greeting = Greeting(20, (HEARTBEAT,), has_header=True)
    assert frames(greeting, bytes(20) + HEARTBEAT + MBAP + HEARTBEAT, 64) == MBAP
