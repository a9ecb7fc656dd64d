"""The echo of what was sent is taken out of what is received; whether there is one is found out."""

from typing import Any

import pytest

from libmodbus_py.protocol.echo import Echo
from tests.support.driver import rtu, small_memory

WRITE = rtu("01 06 0001 0003")  # its response is the same
READ = rtu("01 03 0001 0001")
ANSWER = rtu("01 03 02 0007")  # which is no request
OTHER = rtu("02 03 0001 0001")


def sent(setting: bool | None, *adus: bytes) -> Echo:
    echo = Echo(setting)
    for adu in adus:
        echo.sent(adu, is_telling=adu != WRITE)
    return echo


def in_pieces(echo: Echo, data: bytes) -> bytes:
    return b"".join(echo.without(bytes([byte])) for byte in data)


def whole(echo: Echo, data: bytes) -> bytes:
    return echo.without(data)


@pytest.fixture(params=[whole, in_pieces])
def take(request: pytest.FixtureRequest) -> Any:
    return request.param


def test_a_returned_read_shows_an_echo(take: Any) -> None:
    echo = sent(None, READ)
    assert echo.is_there is None
    assert take(echo, READ + ANSWER) == ANSWER
    assert echo.is_there is True
    echo.sent(WRITE, is_telling=False)
    assert take(echo, WRITE + WRITE) == WRITE


def test_other_bytes_in_place_of_a_read_show_that_there_is_no_echo(take: Any) -> None:
    echo = sent(None, READ)
    assert take(echo, ANSWER) == ANSWER
    assert echo.is_there is False
    echo.sent(READ, is_telling=True)
    assert take(echo, READ) == READ
    assert not echo.is_holding


def test_a_returned_write_shows_nothing_however_often_it_comes(take: Any) -> None:
    echo = Echo(None)
    for _ in range(1000):
        echo.sent(WRITE, is_telling=False)
        assert take(echo, WRITE) == WRITE
        assert echo.is_there is None


@pytest.mark.parametrize("on_the_way", [1, 2, 3])
def test_an_answer_between_writes_shows_the_echo(take: Any, on_the_way: int) -> None:
    """As at a server that has executed its own answers so far, before and after the search."""
    echo = sent(None, *[WRITE] * on_the_way, ANSWER)
    for _ in range(on_the_way):
        assert take(echo, WRITE) == WRITE
        assert echo.is_there is None
        echo.sent(WRITE, is_telling=False)
    assert take(echo, ANSWER + WRITE * on_the_way + READ) == READ
    assert echo.is_there is True


def test_a_write_that_is_not_returned_shows_nothing(take: Any) -> None:
    echo = sent(None, WRITE)
    assert take(echo, OTHER) == OTHER
    assert echo.is_there is None
    echo = sent(None, WRITE, READ)
    assert take(echo, READ) == b""
    assert echo.is_there is True
    echo = sent(None, WRITE, READ)
    assert take(echo, OTHER) == OTHER
    assert echo.is_there is False


def test_an_echo_ends_at_the_first_frame_that_is_not_returned(take: Any) -> None:
    echo = sent(None, READ)
    echo.without(READ)
    echo.sent(WRITE, is_telling=False)
    assert take(echo, OTHER) == OTHER
    assert echo.is_there is False
    echo.sent(WRITE, is_telling=False)
    assert take(echo, WRITE) == WRITE


def test_an_echo_set_by_option_never_ends(take: Any) -> None:
    echo = sent(True, WRITE)
    assert take(echo, WRITE + OTHER) == OTHER
    echo.sent(WRITE, is_telling=False)
    assert take(echo, OTHER) == OTHER
    assert echo.is_there is True
    echo.sent(READ, is_telling=True)
    assert take(echo, READ + ANSWER) == ANSWER


def test_an_option_without_echo_is_never_changed(take: Any) -> None:
    echo = sent(False, READ, WRITE)
    assert take(echo, READ + WRITE) == READ + WRITE
    assert echo.is_there is False
    assert not echo.is_holding


def test_nothing_is_delayed_if_nothing_was_sent() -> None:
    for setting in (None, True, False):
        assert Echo(setting).without(READ[:1]) == READ[:1]


def test_the_beginning_of_an_echo_is_delayed_until_silence() -> None:
    for setting, is_there in ((None, False), (True, True)):
        echo = sent(setting, READ)
        assert echo.without(READ[:-1]) == b""
        assert echo.is_holding
        assert echo.release() == READ[:-1]
        assert not echo.is_holding
        assert echo.is_there is is_there
        assert echo.without(READ[-1:]) == READ[-1:]
        assert echo.release() == b""


def test_writes_alone_delay_nothing() -> None:
    echo = sent(None, WRITE, WRITE)
    assert echo.without(WRITE[:4]) == WRITE[:4]
    assert echo.without(WRITE[4:]) == WRITE[4:]
    assert echo.is_there is None


def test_a_short_request_that_begins_like_the_last_answer_is_returned_after_silence() -> None:
    """Status 41h: the answer to function 7 is the request, and a zero byte."""
    status = rtu("01 07 41")
    assert status == rtu("01 07") + b"\0"
    echo = sent(True, status)
    assert echo.without(rtu("01 07")) == b""
    assert echo.release() == rtu("01 07")


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("setting", [None, True])
def test_stray_bytes_shorter_than_a_frame_may_come_before_an_echo(take: Any, setting, count):
    echo = sent(setting, READ)
    stray = b"\xff\0\xff"[:count]
    assert take(echo, stray + READ + ANSWER) == stray + ANSWER
    assert echo.is_there is True


def test_more_stray_bytes_before_a_request_show_that_there_is_no_echo(take: Any) -> None:
    echo = sent(None, READ)
    assert take(echo, b"\xff" * 4 + READ) == b"\xff" * 4 + READ
    assert echo.is_there is False


@pytest.mark.parametrize("request_", ["01 07", "01 11"])
def test_a_request_of_four_bytes_is_not_delayed(request_: str) -> None:
    assert sent(True, ANSWER).without(rtu(request_)) == rtu(request_)


def test_a_forgotten_request_has_no_echo() -> None:
    echo = sent(None, READ)
    echo.without(READ[:3])
    echo.forget()
    assert not echo.is_holding
    assert echo.without(READ) == READ
    assert echo.is_there is None


def test_a_new_connection_searches_for_an_echo_again() -> None:
    echo = sent(None, READ)
    echo.without(ANSWER)
    echo.reset()
    assert echo.is_there is None
    echo.sent(READ, is_telling=True)
    echo.without(READ)
    assert echo.is_there is True
    echo.reset()
    assert echo.is_there is None


@pytest.mark.parametrize("setting", [None, True])
def test_requests_that_are_never_returned_are_forgotten(setting: bool | None) -> None:
    """Such as broadcasts, to which nothing is ever received."""
    with small_memory():
        echo = Echo(setting)
        for value in range(10_000):
            echo.sent(rtu("00 06 0001") + value.to_bytes(2), is_telling=False)
