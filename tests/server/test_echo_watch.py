"""
What tells an echo from a client that sends the bytes of the last answer: times and bytes only.
"""

from __future__ import annotations

import pytest

from libmodbus_py.server.echo import LATER, LONGER, MOST_HEARD, MOST_RETURNS, EchoWatch
from tests.support.talk import ascii_frame, rtu

WRITE = rtu("01 06 0001 0003")  # its answer is the same
ANSWER = rtu("01 03 02 0007")  # this one is not a request
PAUSE, CHARACTER = 0.004, 0.001


def watch(character: float = CHARACTER, longest: float = 0.5) -> EchoWatch:
    return EchoWatch("rtu", PAUSE, character, longest)


def test_an_answer_that_is_no_request_shows_an_echo_whenever_it_comes() -> None:
    made = watch()
    assert made.has_echo is None
    assert made.sent(ANSWER, 1.0) == b""
    assert made.without_echo(ANSWER[:3], 1.001) == b""
    assert made.without_echo(ANSWER[3:] + WRITE, 9.0) == WRITE
    assert made.has_echo is True
    # From now on the port drops echoes.
    assert made.without_echo(ANSWER, 10.0) == ANSWER


def test_other_bytes_show_that_there_is_no_echo() -> None:
    made = watch()
    made.sent(ANSWER, 1.0)
    assert made.without_echo(WRITE, 1.0) == WRITE
    assert made.has_echo is False


@pytest.mark.parametrize(
    ("character", "earliest"), [(CHARACTER, 2 * len(WRITE) * CHARACTER), (0.0, PAUSE)]
)
@pytest.mark.parametrize("is_early", [True, False])
def test_a_request_with_the_bytes_of_the_answer_takes_its_time(
    character: float, earliest: float, is_early: bool
) -> None:
    made = watch(character)
    made.sent(WRITE, 1.0)
    at = 1.0 + earliest + (-1e-6 if is_early else 1e-6)
    assert made.without_echo(WRITE, at) == (b"" if is_early else WRITE)
    assert made.has_echo is (True if is_early else None)


def test_what_comes_after_longer_than_any_echo_takes_is_a_request() -> None:
    on_line = len(WRITE) * CHARACTER
    for way, has_echo in ((on_line + 0.499, None), (on_line + 0.501, False)):
        made = watch()
        made.sent(WRITE, 1.0)
        assert made.without_echo(WRITE, 1.0 + way) == WRITE
        assert made.has_echo is has_echo


def returned(made: EchoWatch, times: int, now: float = 1.0, way: float = 0.1) -> float:
    """Let an answer come back so many times, as if it were the next request."""
    for _ in range(times):
        assert made.sent(WRITE, now) == b""
        assert made.without_echo(WRITE, now + way) == WRITE
        now += 1.0
    return now


def test_after_many_returns_the_last_byte_is_held_back() -> None:
    made = watch()
    now = returned(made, MOST_RETURNS + 1)
    assert not made.is_trying
    assert made.sent(WRITE, now) == WRITE[-1:]
    assert made.is_trying
    assert made.gap == pytest.approx(LONGER * 0.1 + LATER)


def test_the_longest_way_counts_of_the_same_answer() -> None:
    made = watch()
    returned(made, 1, way=0.3)
    returned(made, 1, way=0.1)
    assert made.gap == pytest.approx(LONGER * 0.3 + LATER)
    other = rtu("01 06 0001 0004")
    made.sent(other, 9.0)
    assert made.without_echo(other, 9.2) == other
    assert made.gap == pytest.approx(LONGER * 0.2 + LATER)


def test_returns_of_another_answer_begin_anew() -> None:
    made = watch()
    now = returned(made, MOST_RETURNS)
    other = rtu("01 06 0001 0004")
    made.sent(other, now)
    made.without_echo(other, now + 0.1)
    returned(made, MOST_RETURNS + 1, now + 1)
    assert not made.is_trying


def test_what_comes_back_without_the_last_byte_is_an_echo() -> None:
    made = watch()
    now = returned(made, MOST_RETURNS + 1)
    made.sent(WRITE, now)
    assert made.without_echo(WRITE[:-1], now + 0.1) == b""
    assert made.end_trial(now + 0.2) == b""
    assert made.has_echo is True
    assert not made.is_trying


def test_a_client_that_does_not_wait_is_heard_after_the_trial() -> None:
    """Its whole requests are none of the echo; the next trial is eight times as far away."""
    made = watch()
    now = returned(made, MOST_RETURNS + 1)
    made.sent(WRITE, now)
    assert made.without_echo(WRITE, now + 0.1) == b""
    assert made.end_trial(now + 0.2) == WRITE
    assert made.has_echo is None
    made.without_echo(WRITE, now + 0.3)
    now = returned(made, 8 * MOST_RETURNS, now + 1)
    assert made.sent(WRITE, now) == WRITE[-1:]


def test_silence_in_a_trial_is_no_echo() -> None:
    made = watch()
    now = returned(made, MOST_RETURNS + 1)
    made.sent(WRITE, now)
    assert made.end_trial(now + 0.2) == b""
    assert made.has_echo is None
    # The bytes before the last one left before, and their time on the line counts.
    earliest = now + 0.2 - (len(WRITE) - 1) * CHARACTER + 2 * len(WRITE) * CHARACTER
    assert made.without_echo(WRITE, earliest + 1e-6) == WRITE
    assert made.has_echo is None


def test_more_than_an_echo_ends_a_trial() -> None:
    made = watch()
    now = returned(made, MOST_RETURNS + 1)
    made.sent(WRITE, now)
    assert made.without_echo(bytes(MOST_HEARD), now + 0.1) == b""
    assert made.is_trying
    assert made.without_echo(b"\0", now + 0.1) == bytes(MOST_HEARD + 1)
    assert not made.is_trying


def test_an_ascii_answer_is_judged_by_what_it_says() -> None:
    for answer, is_certain in ((ascii_frame("01 06 0001 0003"), False), (b":0103", True)):
        made = EchoWatch("ascii", 0.0, 0.0)
        made.sent(answer, 1.0)
        assert made.without_echo(answer, 1.01) == (b"" if is_certain else answer)
        assert made.has_echo is (True if is_certain else None)


def test_the_earliest_request_is_one() -> None:
    made = EchoWatch("rtu", 0.5, 0.0, 10.0)
    made.sent(WRITE, 1.0)
    assert made.without_echo(WRITE, 1.5) == WRITE
    assert made.has_echo is None
