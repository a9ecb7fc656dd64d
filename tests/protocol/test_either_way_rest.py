"""
Streams in which requests and responses follow one another: where frames may begin, and what is
decided when the line falls silent.
"""

from __future__ import annotations

from libmodbus_py.protocol.either_way import EitherWay, NoFrame, RtuEitherWay
from tests.support.cases import each_case
from tests.support.talk import rtu

ASK, ANSWER = rtu("01 03 00 00 00 02"), rtu("01 03 04 00 07 00 09")

# Functions that nobody knows have any length: their CRC alone ends them.
UNKNOWN = rtu("01 41 11 22 33 44")


def taken(frames: RtuEitherWay) -> list[EitherWay | NoFrame]:
    given: list[EitherWay | NoFrame] = []
    while (each := frames.take(lambda unit, function: False)) is not None:
        given.append(each)
    return given


@each_case("frame", [ASK, ANSWER, rtu("01 03 02 00 07"), rtu("01 83 02")])
def test_a_damaged_front_does_not_hide_the_frame_behind_a_silence(frame: bytes) -> None:
    """It claims 250 bytes; the frame that begins where the silence ended counts."""
    frames = RtuEitherWay()
    damaged = bytes.fromhex("01 10 00 00 00 7B F6 00")
    frames.feed(damaged)
    assert taken(frames) == []
    frames.silence()
    frames.feed(frame)
    noise, *_ = given = taken(frames)
    frames.silence()  # a short response may be the beginning of a request until then
    found = [*given, *taken(frames)][1]
    assert isinstance(noise, NoFrame)
    assert (noise.start, noise.end, noise.data) == (0, len(damaged), damaged)
    assert isinstance(found, EitherWay)
    assert (found.start, found.end) == (len(damaged), len(damaged) + len(frame))


def test_a_damaged_front_is_given_up_in_silence_if_frames_follow_to_the_end() -> None:
    frames = RtuEitherWay()
    damaged = bytes.fromhex("01 10 00 00 00 7B F6 00")
    frames.feed(damaged + ASK + ANSWER)
    assert taken(frames) == []
    frames.silence()
    noise, ask, answer = taken(frames)
    assert isinstance(noise, NoFrame)
    assert noise.data == damaged
    assert isinstance(ask, EitherWay)
    assert isinstance(answer, EitherWay)
    assert answer.end == frames.end


def test_a_front_of_one_byte_is_found_too() -> None:
    frames = RtuEitherWay()
    frames.feed(b"\x01" + ASK)
    frames.silence()
    given = taken(frames)
    assert isinstance(given[-1], EitherWay)
    assert (given[-1].start, given[-1].end) == (1, 9)


def test_a_frame_of_any_length_ends_before_the_silence_where_its_crc_fits() -> None:
    frames = RtuEitherWay()
    frames.feed(UNKNOWN + ASK)
    # What follows may belong to it.
    assert taken(frames) == []
    frames.silence()
    unknown, ask = taken(frames)
    assert isinstance(unknown, EitherWay)
    assert unknown.frame.pdu == bytes.fromhex("41 11 22 33 44")
    assert isinstance(ask, EitherWay)
    assert ask.frame.pdu == ASK[1:-2]


def test_a_frame_of_any_length_ends_in_silence() -> None:
    frames = RtuEitherWay()
    frames.feed(UNKNOWN)
    frames.silence()
    (unknown,) = taken(frames)
    assert isinstance(unknown, EitherWay)
    assert (unknown.may_ask, unknown.may_answer) == (True, True)
    assert (unknown.start, unknown.end) == (0, len(UNKNOWN))


def test_what_is_left_is_given_up_only_when_nothing_will_complete_it() -> None:
    frames = RtuEitherWay()
    frames.feed(ASK[:5])
    frames.silence()
    assert taken(frames) == []
    frames.silence(is_long=True)
    given = taken(frames)
    assert all(isinstance(each, NoFrame) for each in given)
    assert (given[0].start, given[-1].end) == (0, 5)
    # Whatever comes then begins anew.
    frames.feed(ASK)
    (ask,) = taken(frames)
    assert isinstance(ask, EitherWay)
    assert (ask.start, ask.end) == (5, 13)


def test_bytes_that_come_after_a_silence_end_it() -> None:
    frames = RtuEitherWay()
    frames.feed(ASK[:5])
    frames.silence(is_long=True)
    frames.feed(ASK[5:])
    (ask,) = taken(frames)
    assert isinstance(ask, EitherWay)
    assert (ask.start, ask.end) == (0, 8)


def test_a_function_of_zero_is_skipped_when_silence_ended_no_frame_with_it() -> None:
    """There is no such function (application protocol, 4.1)."""
    frames = RtuEitherWay()
    frames.feed(b"\x01\x80" + ASK)
    assert taken(frames) == []
    frames.silence()
    *noise, ask = taken(frames)
    assert b"".join(each.data for each in noise if isinstance(each, NoFrame)) == b"\x01\x80"
    assert isinstance(ask, EitherWay)
    assert (ask.start, ask.end) == (2, 10)


def test_nothing_gives_nothing() -> None:
    frames = RtuEitherWay()
    assert taken(frames) == []
    frames.silence(is_long=True)
    assert taken(frames) == []
    assert (frames.offset, frames.end) == (0, 0)


def test_whether_an_answer_is_awaited_is_asked_by_unit_and_function() -> None:
    """A refusal has the function that was asked, and its highest bit."""
    asked = []

    def is_awaited(unit: int, function: int) -> bool:
        asked.append((unit, function))
        return True

    for data in (rtu("11 83 02"), rtu("F7 03 02 00 07")):
        frames = RtuEitherWay()
        frames.feed(data)
        frame = frames.take(is_awaited)
        assert isinstance(frame, EitherWay)
        assert frame.frame.pdu == data[1:-2]
    assert asked == [(0x11, 3), (0xF7, 3)]
