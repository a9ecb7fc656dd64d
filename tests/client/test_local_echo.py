"""
Lines that return each request (local echo), at a client: an echo is recognised, and never a value.
"""

from __future__ import annotations

import logging
from typing import Any

import pytest

from libmodbus_py import FrameError, IllegalDataAddress, InvalidResponse, ModbusError, pdu
from libmodbus_py.client.local_echo import LocalEcho
from libmodbus_py.client.statistics import Statistics
from tests.support.cases import each_case
from tests.support.clients import EVERYWHERE, World, read
from tests.support.peers import OnRequest, Write, answer
from tests.support.talk import ASCII, LINE, Talk, ascii_frame, kinds, rtu, value

# Reads whose request is a possible answer, by length: 3 bytes of coils, and 3 registers.
COILS = pdu.ReadCoils(0x0311, 24)
BOTH = pdu.ReadWriteRegisters(0x0A00, 5, 1, (7,))
WRITE = pdu.WriteRegister(1, 2)

SCHEMES = ["rtu+tcp", "rtu+udp", "ascii+tcp", "rtu", "ascii"]


def returning(scheme: str, *, stray: bytes = b"", answers: bool = True) -> OnRequest:
    """Return what comes, behind stray bytes, and then answer reads of one register."""

    def on_request(request: bytes, write: Write) -> None:
        write(stray + request)
        if answers:
            write(answer(request, scheme), after=0.01)

    return on_request


def rtu_of(request: pdu.Request[Any], unit: int = 1) -> bytes:
    return rtu((bytes([unit]) + request.encode()).hex())


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("stray", [b"", b"\x00"])
def test_an_echo_is_told_once_and_harms_no_read(
    world: World, scheme: str, stray: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    peer = world.peer(scheme, returning(scheme, stray=stray))
    with world.connect(peer.url, timeout=1) as client:
        assert [read(client, address) for address in range(30)] == list(range(30))
        assert client.statistics.echoes == 1
        assert client.statistics.late_answers == 0
    told = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    assert len(told) == 1
    assert "local echo" in told[0]


@EVERYWHERE
def test_no_echo_is_the_value_of_a_read(world: World) -> None:
    """Nothing but the echo comes, of a request that is a possible answer by its length."""
    peer = world.peer("rtu", returning("rtu", answers=False))
    with world.connect(peer.url, timeout=0.1) as client:
        for request in (COILS, COILS, BOTH, COILS):
            with pytest.raises(ModbusError):
                client.execute(request)
        assert client.statistics.echoes == 1


@pytest.mark.parametrize("request_", [COILS, BOTH])
def test_the_answer_behind_such_an_echo_is_taken(request_: Any) -> None:
    talk = Talk(LINE, timeout=1)
    expected: list[Any]
    if request_ is COILS:
        good, expected = rtu("01 01 03 010000"), [True] + [False] * 23
    else:
        good, expected = rtu("01 17 0A 0001 0002 0003 0004 0005"), [1, 2, 3, 4, 5]
    for _ in range(3):
        batch = talk.ask(request_)
        talk.wait(0.01)
        talk.come(talk.sent[-1], good)
        talk.wait(0.1)
        assert batch.outcomes == [expected]
    assert talk.statistics.echoes == 1


@pytest.mark.parametrize("stray", [b"", b"\x00", b"\xff\x00"])
def test_the_echo_of_a_write_does_not_confirm_it(stray: bytes) -> None:
    """Once a read has shown the echo: the unit may be dead, or refuse the write."""
    talk = Talk(LINE, timeout=1)
    talk.ask(5)
    talk.come(stray + talk.sent[-1] + value(5))
    talk.wait(0.1)
    batch = talk.ask(WRITE)
    talk.wait(0.01)
    talk.come(stray + talk.sent[-1])
    talk.wait(0.01)
    talk.come(rtu("01 86 02"))
    talk.wait(0.1)
    assert str(kinds(batch)[0]).count("IllegalDataAddress")
    batch = talk.ask(WRITE)
    talk.come(stray + talk.sent[-1])
    talk.wait(1)
    assert isinstance(batch.outcomes[0], ModbusError)


def test_an_echo_in_pieces() -> None:
    talk = Talk(LINE, timeout=1)
    for number in range(5):
        batch = talk.ask(number)
        data = talk.sent[-1] + value(number)
        for at in range(len(data)):
            talk.come(data[at : at + 1])
            talk.wait(0.001)
        talk.wait(0.1)
        assert batch.outcomes == [[number]]


def test_an_echo_that_ends_is_noticed() -> None:
    talk = Talk(LINE, timeout=1)
    for number in range(5):
        batch = talk.ask(number)
        talk.come(talk.sent[-1] * (number < 2) + value(number))
        talk.wait(0.1)
        assert batch.outcomes == [[number]]
    batch = talk.ask(WRITE)
    talk.come(talk.sent[-1])
    talk.wait(0.1)
    assert batch.outcomes == [None]


ON_PORT = "rtu:///dev/nowhere?silence=0&echo=1"


def echoing(url: str = LINE) -> Talk:
    """Return a talk that knows of an echo."""
    talk = Talk(url, timeout=1)
    talk.ask(5)
    talk.come(talk.sent[-1] + value(5))
    talk.wait(0.1)
    assert talk.statistics.echoes == 1
    return talk


@each_case("stray", [b"", b"\x00", b"\xff\x00"])
@each_case("pause", [None, 0.01])
def test_a_write_is_confirmed_by_what_follows_its_echo(stray: bytes, pause: float | None) -> None:
    talk = echoing()
    for _ in range(2):
        batch = talk.ask(WRITE)
        echo = stray + talk.sent[-1]
        if pause is None:
            talk.come(echo + talk.sent[-1])
        else:
            talk.come(echo)
            talk.wait(pause)
            assert not batch.is_done
            talk.come(talk.sent[-1])
        assert batch.outcomes == [None]
        talk.wait(0.1)
    assert talk.is_at_rest


@each_case("url", [LINE, ON_PORT])
def test_a_write_that_is_confirmed_tells_nothing_of_an_echo(url: str) -> None:
    talk = Talk(url, timeout=1)
    for _ in range(2):
        batch = talk.ask(WRITE)
        talk.come(talk.sent[-1])
        assert batch.outcomes == [None]
        talk.wait(0.1)
    assert talk.statistics.echoes == 0


def test_a_new_connection_may_be_without_an_echo() -> None:
    talk = echoing("rtu+tcp://192.0.2.1")
    talk.lose()
    talk.open()
    batch = talk.ask(WRITE)
    talk.come(talk.sent[-1])
    assert batch.outcomes == [None]


def test_half_an_echo_is_not_taken_over_to_a_new_connection() -> None:
    talk = echoing("rtu+tcp://192.0.2.1")
    talk.ask(6)
    talk.come(talk.sent[-1][:5])
    talk.lose()
    talk.open()
    batch = talk.ask(7)
    talk.wait_for(3)  # until the answer that the unit owes would be over
    talk.come(value(7)[:4])
    talk.wait(0.5)
    talk.come(value(7)[4:])
    assert batch.outcomes == [[7]]


def test_the_beginning_of_an_echo_that_silence_follows_is_that_of_an_answer() -> None:
    """A frame of ASCII is over after a second without a character (serial line, 2.5.2.1)."""
    talk = Talk(ASCII, timeout=9)
    talk.ask(5)
    talk.come(talk.sent[-1] + ascii_frame("01 03 02 0005"))
    batch = talk.ask(6)
    talk.come(talk.sent[-1][:5])
    talk.wait(0.9)
    assert not batch.is_done
    talk.wait(0.2)
    assert kinds(batch) == [FrameError]


def test_an_echo_behind_much_noise_does_not_confirm_a_write() -> None:
    talk = echoing()
    batch = talk.ask(WRITE)
    talk.come(b"\xff" * 9 + talk.sent[-1])
    talk.wait(0.01)
    assert not batch.is_done
    talk.come(rtu("01 86 02"))
    assert kinds(batch) == [IllegalDataAddress]


def test_where_the_port_drops_the_echo_what_comes_is_an_answer() -> None:
    talk = Talk(ON_PORT, timeout=1)
    batch = talk.ask(COILS)
    talk.come(rtu_of(COILS))
    talk.wait(0.1)
    assert len(batch.outcomes[0]) == 24
    assert talk.statistics.echoes == 0


def test_of_some_functions_an_answer_shows_whether_an_echo_came() -> None:
    """By the application protocol, chapter 6: an answer that differs from its request."""
    differ = {1, 2, 3, 4, 7, 11, 12, 15, 16, 17, 20, 23, 24, 43}
    for function in range(1, 0x80):
        echo = LocalEcho("here", Statistics(), False)
        request = bytes([function, 0, 1, 0, 2])
        # What is equal to the request is mostly no answer to a read; to a write it is one.
        assert echo.may_be(request) is (function in differ - {15, 16}), function
        assert echo.accepts(request, bytes([function, 2, 0, 1]))
        assert echo.is_there is (False if function in differ else None), function


def test_an_echo_is_told_once_although_the_connection_is_a_new_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    talk = Talk("rtu+tcp://192.0.2.1", timeout=1)
    for number in range(3):
        batch = talk.ask(number)
        talk.come(talk.sent[-1] + value(number))
        talk.wait(0.1)
        assert batch.outcomes == [[number]]
        talk.lose()
        talk.open()
    assert talk.statistics.echoes == 1
    assert [each.levelno for each in caplog.records].count(logging.WARNING) == 1


def test_an_answer_that_came_alone_is_accepted_unless_it_may_be_an_echo() -> None:
    read, write = bytes.fromhex("03 006B 0001"), bytes.fromhex("06 0001 0003")
    echo = LocalEcho("here", Statistics(), False)
    assert not echo.accepts(COILS.encode(), COILS.encode())
    assert echo.accepts(write, write)
    assert echo.is_there is None  # a write that comes back may be both
    assert echo.accepts(read, bytes.fromhex("03 02 0007"))
    assert echo.is_there is False
    assert echo.accepts(COILS.encode(), COILS.encode())


def test_a_value_that_is_equal_to_its_request_is_taken_where_no_echo_is() -> None:
    talk = Talk(LINE, timeout=1)
    for request, come in ((1, None), (COILS, rtu_of(COILS))):
        batch = talk.ask(request)
        talk.come(come or value(1))
        talk.wait(0.1)
    assert len(batch.outcomes[0]) == 24


def test_a_first_answer_that_is_equal_to_its_request_is_none() -> None:
    talk = Talk(LINE, timeout=1)
    batch = talk.ask(COILS)
    talk.come(rtu_of(COILS))
    talk.wait(1)
    assert kinds(batch) == [InvalidResponse]
    assert "echo=True" in str(batch.outcomes[0])


def test_a_port_that_drops_the_echo_itself_tells_nothing(world: World) -> None:
    peer = world.peer("rtu", returning("rtu", stray=b""))
    with world.connect(f"{peer.url}&echo=1", timeout=1) as client:
        assert [read(client, address) for address in range(30)] == list(range(30))
        assert client.statistics.echoes == 0
