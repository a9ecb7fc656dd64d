"""
The echo of what was sent is taken out of what is received, with stray bytes before it or without.
"""

from __future__ import annotations

import pytest

from libmodbus_py.protocol.returned import MOST_STRAY, AwaitedEcho, begins_with_echo

SENT = bytes.fromhex("010300000001840A")
ANSWER = bytes.fromhex("01030200057847")


def test_an_echo_is_taken_out_once() -> None:
    awaited = AwaitedEcho(SENT)
    assert not awaited.came
    assert not awaited.is_over
    assert awaited.without(SENT) == b""
    assert awaited.came
    assert awaited.is_over
    assert not awaited.is_holding
    assert awaited.without(SENT) == SENT


def test_what_comes_behind_an_echo_is_returned_with_it() -> None:
    assert AwaitedEcho(SENT).without(SENT + ANSWER) == ANSWER


def test_without_anything_sent_no_echo_is_awaited() -> None:
    awaited = AwaitedEcho(b"")
    assert awaited.is_over
    assert not awaited.came
    assert awaited.without(SENT) == SENT


def test_a_beginning_is_held_back_byte_by_byte() -> None:
    awaited = AwaitedEcho(SENT)
    for byte in SENT[:-1]:
        assert awaited.without(bytes([byte])) == b""
        assert awaited.is_holding
        assert not awaited.is_over
    assert awaited.without(SENT[-1:] + b"\x07") == b"\x07"
    assert awaited.came


@pytest.mark.parametrize("count", range(1, MOST_STRAY + 1))
def test_stray_bytes_before_an_echo_are_taken_out_with_it(count: int) -> None:
    awaited = AwaitedEcho(SENT)
    assert awaited.without(b"\xff" * count + SENT + ANSWER) == ANSWER
    assert awaited.came


def test_more_stray_bytes_than_a_transceiver_adds_are_no_echo() -> None:
    received = b"\xff" * (MOST_STRAY + 1) + SENT
    awaited = AwaitedEcho(SENT)
    assert awaited.without(received) == received
    assert awaited.is_over
    assert not awaited.came


def test_stray_bytes_are_counted_over_all_pieces() -> None:
    awaited = AwaitedEcho(SENT)
    for _ in range(MOST_STRAY):
        assert awaited.without(b"\xff") == b"\xff"
        assert not awaited.is_holding
        assert not awaited.is_over
    assert awaited.without(SENT + ANSWER) == ANSWER
    assert awaited.came

    awaited = AwaitedEcho(SENT)
    assert [awaited.without(b"\xff" * 2) for _ in range(3)] == [b"\xff" * 2] * 3
    assert awaited.is_over
    assert not awaited.came


def test_behind_stray_bytes_one_byte_of_the_echo_is_not_held_back() -> None:
    awaited = AwaitedEcho(SENT)
    assert awaited.without(b"\xff" + SENT[:1]) == b"\xff" + SENT[:1]
    assert not awaited.is_holding


def test_behind_stray_bytes_two_bytes_of_the_echo_are_held_back() -> None:
    awaited = AwaitedEcho(SENT)
    assert awaited.without(b"\xff" + SENT[:2]) == b""
    assert awaited.is_holding
    assert awaited.without(SENT[2:]) == b""
    assert awaited.came


def test_other_bytes_after_a_beginning_are_released() -> None:
    awaited = AwaitedEcho(SENT)
    assert awaited.without(SENT[:3]) == b""
    assert awaited.without(b"\xee" * 4) == SENT[:3] + b"\xee" * 4
    assert awaited.is_over
    assert not awaited.came


def test_silence_releases_what_is_held_back() -> None:
    awaited = AwaitedEcho(SENT)
    awaited.without(SENT[:3])
    assert awaited.release() == SENT[:3]
    assert awaited.is_over
    assert not awaited.came
    assert not awaited.is_holding
    assert awaited.release() == b""


def test_more_that_is_sent_at_once_has_one_echo() -> None:
    awaited = AwaitedEcho(SENT)
    awaited.expect(ANSWER)
    assert awaited.without(SENT) == b""
    assert not awaited.came
    assert awaited.without(ANSWER) == b""
    assert awaited.came


def test_after_an_echo_another_may_be_expected_with_stray_bytes_again() -> None:
    awaited = AwaitedEcho(SENT)
    assert awaited.without(b"\xff" * MOST_STRAY) == b"\xff" * MOST_STRAY
    assert awaited.without(SENT) == b""
    awaited.expect(ANSWER)
    assert not awaited.is_over
    assert not awaited.came
    assert awaited.without(b"\xff" * MOST_STRAY) == b"\xff" * MOST_STRAY
    assert not awaited.is_over
    assert awaited.without(ANSWER) == b""
    assert awaited.came


@pytest.mark.parametrize("count", range(MOST_STRAY + 2))
def test_an_echo_begins_within_as_many_stray_bytes(count: int) -> None:
    received = b"\xff" * count + SENT + ANSWER
    assert begins_with_echo(received, SENT) is (count <= MOST_STRAY)


def test_a_part_of_an_echo_is_none() -> None:
    assert not begins_with_echo(SENT[:-1], SENT)
    assert not begins_with_echo(ANSWER, SENT)
