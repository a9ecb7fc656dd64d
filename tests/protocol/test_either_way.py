"""
Frames that may be requests or responses, found by both length rules and the CRC.
"""

from __future__ import annotations

from libmodbus_py.protocol.either_way import EitherWay, NoFrame, RtuEitherWay, may_be
from tests.support.cases import each_case
from tests.support.talk import rtu
from tests.support.vectors import EXCEPTIONS, REQUESTS, RESPONSES, FrameVector, rows

ASK, ANSWER = rtu("01 03 00 00 00 02"), rtu("01 03 04 00 07 00 09")


def found(*pieces: bytes, awaited: bool = False) -> list[EitherWay | NoFrame]:
    frames = RtuEitherWay()
    given: list[EitherWay | NoFrame] = []
    for piece in pieces:
        frames.feed(piece)
        while (each := frames.take(lambda unit, function: awaited)) is not None:
            given.append(each)
    frames.silence(is_long=True)
    while (each := frames.take(lambda unit, function: awaited)) is not None:
        given.append(each)
    return given


@each_case("vector", rows(REQUESTS))
def test_every_request_may_ask(vector: FrameVector) -> None:
    (frame,) = found(vector.rtu)
    assert isinstance(frame, EitherWay)
    assert (frame.frame, frame.may_ask) == (vector.frame, True)
    assert may_be(vector.pdu)[0]


@each_case("vector", rows([*RESPONSES, *EXCEPTIONS]))
def test_every_response_may_answer(vector: FrameVector) -> None:
    (frame,) = found(vector.rtu, awaited=True)
    assert isinstance(frame, EitherWay)
    assert (frame.frame, frame.may_answer) == (vector.frame, True)
    assert may_be(vector.pdu)[1]


def test_places_are_those_in_the_stream() -> None:
    ask, noise, answer = found(ASK, b"\xff\xff", ANSWER)
    assert (ask.start, ask.end) == (0, 8)
    assert (noise.start, noise.end) == (8, 10)
    assert isinstance(noise, NoFrame)
    assert (answer.start, answer.end) == (10, 19)


def test_an_awaited_answer_is_waited_for() -> None:
    """Its first bytes are, by chance, a whole request; only the rest shows what it is."""
    frames = RtuEitherWay()
    longer = rtu("01 03 08 00 07 00" + rtu("01 03 08 00 07 00")[-2:].hex() + "AA BB CC")
    frames.feed(longer[:9])
    assert frames.take(lambda unit, function: True) is None
    frames.feed(longer[9:])
    frame = frames.take(lambda unit, function: True)
    assert isinstance(frame, EitherWay)
    assert frame.frame.pdu == longer[1:-2]
    assert frame.may_answer
    assert not frame.may_ask
