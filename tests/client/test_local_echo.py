"""
Lines that return each request (local echo), at a client: an echo is recognised, and never a value.
"""

from __future__ import annotations

import logging
from typing import Any

import pytest

from libmodbus_py import InvalidResponse, ModbusError, pdu
from tests.support.clients import EVERYWHERE, World, read
from tests.support.peers import OnRequest, Write, answer
from tests.support.talk import LINE, Talk, kinds, rtu, value

# Reads whose request is a possible answer, by length: 3 bytes of coils, and 3 registers.
COILS = pdu.ReadCoils(0x0311, 24)
BOTH = pdu.ReadWriteRegisters(0x0A00, 5, 1, (7,))

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
    write = pdu.WriteRegister(1, 2)
    talk = Talk(LINE, timeout=1)
    talk.ask(5)
    talk.come(stray + talk.sent[-1] + value(5))
    talk.wait(0.1)
    batch = talk.ask(write)
    talk.wait(0.01)
    talk.come(stray + talk.sent[-1])
    talk.wait(0.01)
    talk.come(rtu("01 86 02"))
    talk.wait(0.1)
    assert str(kinds(batch)[0]).count("IllegalDataAddress")
    batch = talk.ask(write)
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
    batch = talk.ask(pdu.WriteRegister(1, 2))
    talk.come(talk.sent[-1])
    talk.wait(0.1)
    assert batch.outcomes == [None]


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
