"""
Which bytes on a line are requests and which responses: scripted bytes and times, no port.

Frames are those of the specification (tests/support/vectors.json) or carry check bytes that
talk.py computes.
"""

from __future__ import annotations

import random
import tracemalloc
from collections.abc import Iterable, Sequence
from typing import get_args

import pytest

from libmodbus_py import pdu
from libmodbus_py.listen import Separator, Transaction
from libmodbus_py.tools.listener.transaction import Heard, Kind
from tests.support.cases import each_case
from tests.support.talk import ascii_frame, rtu
from tests.support.vectors import EXCEPTIONS, REQUESTS, RESPONSES

ASK = rtu("01 03 00 00 00 02")
ANSWER = rtu("01 03 04 00 07 00 09")
WRITE = rtu("01 06 00 05 12 34")
OTHER_WRITE = rtu("01 06 00 06 12 34")
REFUSAL = rtu("01 83 02")

ECHOED = ["06 00 05 12 34", "05 00 05 FF 00", "16 00 04 00 F2 00 25", "08 00 00 A5 37"]

Piece = tuple[float, bytes]


def listen(pieces: Iterable[Piece], framing: str = "rtu") -> list[Transaction]:
    separator = Separator(framing)  # type: ignore[arg-type]
    done = [each for at, data in pieces for each in separator.feed(data, at)]
    return done + separator.end()


def kinds(pieces: Iterable[Piece], framing: str = "rtu") -> list[str]:
    return [each.kind for each in listen(pieces, framing)]


def named(pieces: Iterable[Piece], framing: str = "rtu") -> list[tuple[str, bytes]]:
    heard: list[Heard] = []
    separator = Separator(framing, heard.append)  # type: ignore[arg-type]
    for at, data in pieces:
        separator.feed(data, at)
    separator.end()
    return [(each.part, each.frame.pdu if each.frame else each.data) for each in heard]


class TestVectors:
    """The worked examples of the specification, one conversation after the other."""

    @each_case("framing", ["rtu", "ascii"])
    @each_case("step", [0, 1, 7], ids=["whole", "bytes", "sevens"])
    def test_every_question_finds_its_answer(self, framing: str, step: int) -> None:
        pairs = pairs_of(framing)
        assert len(pairs) > 15
        pieces: list[Piece] = []
        at = 0.0
        for question, answer in pairs:
            for data, pause in ((question, 0.01), (answer, 0.05)):
                size = step or len(data)
                pieces += [(at, data[n : n + size]) for n in range(0, len(data), size)]
                at += pause
        done = listen(pieces, framing)
        assert [each.kind for each in done if each.kind not in ("answered", "exception")] == []
        assert len(done) == len(pairs)

    @pytest.mark.parametrize("framing", ["rtu", "ascii"])
    def test_glued_in_one_piece(self, framing: str) -> None:
        pairs = pairs_of(framing)
        done = listen([(0.0, b"".join(q + a for q, a in pairs))], framing)
        assert {each.kind for each in done} <= {"answered", "exception"}
        assert len(done) == len(pairs)


def pairs_of(framing: str) -> list[tuple[bytes, bytes]]:
    """Question and answer of each worked example that has both."""
    asked = {vector.id: vector for vector in REQUESTS}
    pairs = [
        (asked[answer.request], answer)
        for answer in (*RESPONSES, *EXCEPTIONS)
        if answer.request in asked
    ]
    return [
        (getattr(question, framing), getattr(answer, framing))
        for question, answer in pairs
        if question.unit != 0
    ]


class TestOneTransaction:
    def test_question_and_answer_with_their_times(self) -> None:
        (done,) = listen([(100.0, ASK), (100.25, ANSWER)])
        assert done.kind == "answered"
        assert done.time == 100.0
        assert done.unit == 1
        assert done.function == 3
        assert done.request == pdu.ReadHoldingRegisters(0, 2)
        assert done.response == [7, 9]
        assert done.duration == pytest.approx(0.25)
        assert done.error is None
        assert done.is_good

    def test_refusal(self) -> None:
        (done,) = listen([(0.0, ASK), (0.1, REFUSAL)])
        assert done.kind == "exception"
        assert getattr(done.error, "code", None) == 2

    def test_no_answer(self) -> None:
        (done,) = listen([(0.0, ASK)])
        assert (done.kind, done.duration, done.response) == ("unanswered", None, None)

    def test_no_answer_is_told_without_another_question(self) -> None:
        separator = Separator("rtu")
        assert separator.feed(ASK, 0.0) == []
        assert separator.tick(1.0) == []
        assert [each.kind for each in separator.tick(20.0)] == ["unanswered"]
        assert separator.tick(21.0) == []

    def test_an_answer_that_does_not_fit(self) -> None:
        (done,) = listen([(0.0, ASK), (0.1, rtu("01 03 02 00 07"))])
        assert done.kind == "invalid"
        assert done.request == pdu.ReadHoldingRegisters(0, 2)

    def test_an_answer_nobody_asked_for(self) -> None:
        (done,) = listen([(0.0, ANSWER)])
        assert (done.kind, done.unit, done.request) == ("unasked", 1, None)

    def test_a_broadcast(self) -> None:
        assert kinds([(0.0, rtu("00 06 00 05 12 34")), (0.1, ASK), (0.2, ANSWER)]) == [
            "broadcast",
            "answered",
        ]

    def test_listen_only_is_answered_by_silence(self) -> None:
        assert kinds([(0.0, rtu("01 08 00 04 00 00")), (0.2, ASK), (0.3, ANSWER)]) == [
            "broadcast",
            "answered",
        ]

    def test_a_question_that_no_server_takes(self) -> None:
        (done,) = listen([(0.0, rtu("01 03 00 00 00 00")), (0.1, rtu("01 83 03"))])
        assert done.request == pdu.RawRequest(3, bytes(4))
        assert done.kind == "exception"

    def test_a_function_without_a_class(self) -> None:
        (done,) = listen([(0.0, rtu("01 41 AA BB")), (0.1, rtu("01 41 CC"))])
        assert done.request == pdu.RawRequest(0x41, b"\xaa\xbb")
        assert done.response == b"\xcc"

    def test_every_kind_says_what_it_is(self) -> None:
        for kind in get_args(Kind):
            assert str(Transaction(0.0, kind))


class TestNoFunction:
    @each_case("code", ["00", "80"])
    @each_case("direction", [None, "client", "server"])
    @each_case("framing", ["rtu", "ascii"])
    def test_is_invalid(self, code: str, direction: str | None, framing: str) -> None:
        separator = Separator(framing)  # type: ignore[arg-type]
        frame = {"rtu": rtu, "ascii": ascii_frame}[framing](f"01 {code} 01")
        done = separator.feed(frame, 0.0, direction)  # type: ignore[arg-type]
        done += separator.end()
        assert [(each.kind, each.unit) for each in done] == [("invalid", 1)]
        assert f"{code}h" in str(done[0])

    @each_case("code", ["00", "80"])
    def test_in_place_of_a_response(self, code: str) -> None:
        done = listen([(0.0, ASK), (0.1, rtu(f"01 {code} 02")), (0.3, ASK), (0.4, ANSWER)])
        assert [each.kind for each in done] == ["invalid", "answered"]
        done = listen([(0.0, ASK), (0.1, rtu(f"01 {code} 02")), (0.2, ANSWER)])
        assert [each.kind for each in done] == ["invalid", "answered"]

    def test_in_pieces(self) -> None:
        frame = rtu("01 00 02 03")
        done = listen([(at / 1000, frame[at : at + 1]) for at in range(len(frame))])
        assert [each.kind for each in done] == ["invalid"]

    def test_noise_of_that_form_is_damage(self) -> None:
        done = listen([(0.0, bytes.fromhex("01 00 02 03 04 05")), (0.2, ASK), (0.3, ANSWER)])
        assert [each.kind for each in done] == ["damaged", "answered"]

    def test_a_client_that_sends_a_refusal(self) -> None:
        separator = Separator("ascii")
        done = separator.feed(ascii_frame("01 83 01"), 0.0, "client")
        assert [each.kind for each in done] == ["invalid"]


class TestRepeats:
    def test_repeats_are_counted(self) -> None:
        done = listen([(0.0, ASK), (1.0, ASK), (2.0, ASK), (2.1, ANSWER)])
        assert [(each.kind, each.repeats) for each in done] == [
            ("unanswered", 0),
            ("unanswered", 1),
            ("answered", 2),
        ]

    @each_case("question", ECHOED)
    def test_an_echo_is_the_answer_if_it_comes_soon(self, question: str) -> None:
        write = rtu("01" + question)
        assert kinds([(0.0, write), (0.005, write)]) == ["answered"]

    @each_case("question", ECHOED)
    def test_and_the_question_again_if_it_comes_late(self, question: str) -> None:
        write = rtu("01" + question)
        assert kinds([(0.0, write), (1.0, write), (1.005, write)]) == ["unanswered", "answered"]

    def test_the_limit_is_learnt_from_slow_units(self) -> None:
        slow: list[Piece] = []
        for number in range(10):  # this unit takes 0.4 s, and the client waits for 3
            slow += [(10.0 * number, ASK), (10.0 * number + 0.4, ANSWER)]
            slow += [(10.0 * number + 1, rtu("02 03 00 00 00 01"))]
            slow += [(10.0 * number + 4, rtu("02 03 00 00 00 01"))]
        slow += [(200.0, WRITE), (200.4, WRITE)]
        assert kinds(slow)[-1] == "answered"

    def test_the_limit_is_learnt_from_quick_ones(self) -> None:
        quick: list[Piece] = []
        for number in range(10):  # this unit takes 2 ms, and the client waits for 50
            quick += [(number, ASK), (number + 0.002, ANSWER)]
            quick += [(number + 0.5, rtu("02 03 00 00 00 01"))]
            quick += [(number + 0.55, rtu("02 03 00 00 00 01"))]
        quick += [(200.0, WRITE), (200.05, WRITE), (200.052, WRITE)]
        assert kinds(quick)[-2:] == ["unanswered", "answered"]

    def test_a_late_answer(self) -> None:
        done = listen([(0.0, ASK), (1.0, rtu("02 03 00 00 00 01")), (1.1, ANSWER)])
        assert [(each.kind, each.unit) for each in done] == [
            ("unanswered", 1),
            ("late", 1),
            ("unanswered", 2),
        ]
        assert done[1].response == [7, 9]
        assert done[1].duration == pytest.approx(1.1)

    def test_a_late_echo_while_another_unit_is_asked(self) -> None:
        other = rtu("02 03 00 00 00 01")
        pieces = [(0.0, WRITE), (1.0, other), (1.01, WRITE), (1.02, rtu("02 03 02 00 05"))]
        assert kinds(pieces) == ["unanswered", "late", "answered"]

    def test_a_doubled_answer(self) -> None:
        pieces = [(0.0, ASK), (1.0, ASK), (1.01, ANSWER), (1.02, ANSWER)]
        assert kinds(pieces) == ["unanswered", "answered", "unasked"]

    def test_a_doubled_echo(self) -> None:
        pieces = [(0.0, WRITE), (1.0, WRITE), (1.01, WRITE), (1.02, WRITE)]
        pieces += [(1.05, ASK), (1.06, ANSWER)]
        assert kinds(pieces) == ["unanswered", "answered", "unasked", "answered"]
        assert [part for part, _ in named(pieces)] == [
            *("request", "request", "response", "response", "request", "response"),
        ]

    def test_the_same_write_at_once_behind_a_repeated_one(self) -> None:
        """It is asked anew, for it is answered."""
        pieces = [(0.0, WRITE), (1.0, WRITE), (1.01, WRITE), (1.02, WRITE), (1.03, WRITE)]
        assert kinds(pieces) == ["unanswered", "answered", "answered"]

    def test_an_answer_to_a_question_that_was_damaged_for_us_alone(self) -> None:
        bad = b"\xff" + WRITE[1:]
        pieces = [(0.0, bad), (0.01, WRITE), (0.02, ASK), (0.03, ANSWER)]
        assert kinds(pieces) == ["damaged", "unasked", "answered"]

    def test_the_same_write_again_and_again(self) -> None:
        pieces = [piece for n in range(50) for piece in ((n, WRITE), (n + 0.01, WRITE))]
        assert kinds(pieces) == ["answered"] * 50

    def test_another_write_is_no_answer(self) -> None:
        assert kinds([(0.0, WRITE), (0.3, OTHER_WRITE), (0.31, OTHER_WRITE)]) == [
            "unanswered",
            "answered",
        ]


class TestBits:
    """An answer with three bytes of bits is as long as a question."""

    def test_three_bytes_of_coils(self) -> None:
        done = listen([(0.0, rtu("01 01 03 00 00 14")), (0.01, rtu("01 01 03 00 00 01"))])
        assert [each.kind for each in done] == ["answered"]
        assert len(done[0].response) == 20

    def test_the_question_again(self) -> None:
        ask = rtu("01 01 03 00 00 14")
        done = listen([(0.0, ask), (1.0, ask), (1.01, rtu("01 01 03 FF 00 01"))])
        assert [each.kind for each in done] == ["unanswered", "answered"]


class TestDamage:
    def test_a_damaged_answer(self) -> None:
        bad = ANSWER[:-1] + bytes([ANSWER[-1] ^ 1])
        (done,) = listen([(0.0, ASK), (0.01, bad)])
        assert done.kind == "damaged"
        assert done.request == pdu.ReadHoldingRegisters(0, 2)
        assert done.error is not None
        assert done.error.received == bad

    def test_a_damaged_question(self) -> None:
        bad = bytes([ASK[0] ^ 2]) + ASK[1:]
        done = listen([(0.0, bad), (1.0, ASK), (1.1, ANSWER)])
        assert [each.kind for each in done] == ["damaged", "answered"]
        assert done[0].unit is None

    def test_noise_before_and_behind(self) -> None:
        pieces = [(0.0, b"\xff" + ASK), (0.01, b"\x00\xfe" + ANSWER + b"\xfd\xfc"), (1.0, ASK)]
        pieces += [(1.01, ANSWER)]
        done = listen(pieces)
        assert [each.kind for each in done if each.kind != "damaged"] == ["answered", "answered"]

    @each_case("code", [3, 0x10, 0x55, 0x2B, 8, 0x83])
    def test_a_front_that_claims_more_holds_up_nothing(self, code: int) -> None:
        """Behind silence a frame counts, whatever the front still waits for."""
        front = bytes([1, code, 0xFA, 0x00])
        separator = Separator("rtu")
        done = separator.feed(front, 0.0)
        done += separator.feed(ASK, 0.5)
        done += separator.feed(ANSWER, 0.505)
        assert [each.kind for each in done] == ["damaged", "answered"]

    def test_a_front_that_is_followed_at_once(self) -> None:
        """Nothing but silence behind two good frames shows that the front is none."""
        separator = Separator("rtu")
        done = separator.feed(bytes([1, 3, 0xFA, 0, 0]) + ASK + ANSWER, 0.0)
        done += separator.tick(0.1)
        assert [each.kind for each in done] == ["damaged", "answered"]

    def test_what_stays_unfinished_is_told(self) -> None:
        separator = Separator("rtu")
        assert separator.feed(ASK[:4], 0.0) == []
        assert separator.tick(0.1) == []
        (done,) = separator.tick(2.0)
        assert (done.kind, done.error and done.error.received) == ("damaged", ASK[:4])

    def test_a_pause_inside_a_frame(self) -> None:
        """A long answer came in pieces of 32 bytes, with gaps."""
        body = "01 03 A0" + "00 07" * 80
        data = rtu(body)
        pieces = [(0.0, rtu("01 03 00 00 00 50"))]
        pieces += [(0.1 + at / 32 * 0.03, data[at : at + 32]) for at in range(0, len(data), 32)]
        (done,) = listen(pieces)
        assert (done.kind, done.response) == ("answered", [7] * 80)

    def test_damage_then_the_same_write_again(self) -> None:
        """The received frame was the response, so the echo behind it is another request."""
        bad = WRITE[:-1] + bytes([WRITE[-1] ^ 1])
        pieces = [(0.0, WRITE), (0.005, bad), (0.4, WRITE), (0.405, WRITE)]
        assert kinds(pieces) == ["damaged", "answered"]

    def test_damage_then_the_same_write_again_at_once(self) -> None:
        """Some clients ask again as soon as they see a wrong CRC."""
        bad = WRITE[:-1] + bytes([WRITE[-1] ^ 1])
        pieces = [(0.0, WRITE), (0.005, bad), (0.03, WRITE), (0.035, WRITE)]
        assert kinds(pieces) == ["damaged", "answered"]

    def test_ascii_noise_is_told(self) -> None:
        ask, answer = ascii_frame("01 03 00 00 00 02"), ascii_frame("01 03 04 00 07 00 09")
        done = listen([(0.0, b"noise"), (1.0, ask), (1.1, answer)], "ascii")
        assert [each.kind for each in done] == ["damaged", "answered"]

    @pytest.mark.parametrize("framing", ["rtu", "ascii"])
    def test_memory_is_bounded_under_noise(self, framing: str) -> None:
        noise = random.Random(3)
        separator = Separator(framing)  # type: ignore[arg-type]
        counts = []
        tracemalloc.start()
        for number in range(200):
            separator.feed(noise.randbytes(4096), number * 0.001)
            counts.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        assert counts[-1] < counts[20] + 100_000

    @pytest.mark.parametrize("framing", ["rtu", "ascii"])
    def test_a_flood_is_told_before_it_ends(self, framing: str) -> None:
        separator = Separator(framing)  # type: ignore[arg-type]
        noise = random.Random(3)
        done = [
            each for n in range(10) for each in separator.feed(noise.randbytes(4096), n * 0.001)
        ]
        assert any(each.kind == "damaged" for each in done)


class TestNoise:
    """Whatever comes, nothing is raised; and a line that is in order again is understood."""

    @each_case("framing", ["rtu", "ascii"])
    @each_case("seed", range(30))
    def test_recovers(self, framing: str, seed: int) -> None:
        choose = random.Random(seed)
        separator = Separator(framing)  # type: ignore[arg-type]
        make = rtu if framing == "rtu" else ascii_frame
        ask, answer = make("01 03 00 00 00 02"), make("01 03 04 00 07 00 09")
        at = 0.0
        for _ in range(40):
            piece = choose.choice([ask, answer, choose.randbytes(choose.randint(0, 60))])
            separator.feed(piece[choose.randrange(3) :], at)
            at += choose.choice([0.0, 0.001, 0.03, 1.5])
        at += 2
        separator.tick(at)
        separator.feed(ask, at)
        done = separator.feed(answer, at + 0.01)
        assert [each.kind for each in done][-1] == "answered"


class TestKnownDirections:
    def test_both_ways(self) -> None:
        separator = Separator("rtu")
        assert separator.feed(WRITE, 0.0, "client") == []
        assert separator.feed(WRITE, 1.0, "client")[0].kind == "unanswered"
        (done,) = separator.feed(WRITE, 1.9, "server")
        assert (done.kind, done.repeats) == ("answered", 1)

    def test_what_stays_unfinished_is_told(self) -> None:
        separator = Separator("rtu")
        separator.feed(ASK, 0.0, "client")
        separator.feed(ANSWER[:3], 0.1, "server")
        assert separator.tick(0.5) == []
        assert [each.kind for each in separator.tick(9.0)] == ["damaged"]
        separator.feed(ASK, 10.0, "client")
        assert [each.kind for each in separator.feed(ANSWER, 10.1, "server")] == ["answered"]


class TestAscii:
    def test_another_delimiter_is_followed(self) -> None:
        change = ascii_frame("01 08 00 03 23 00")
        ask = ascii_frame("01 03 00 00 00 02", b"\r#")
        answer = ascii_frame("01 03 04 00 07 00 09", b"\r#")
        pieces = [(0.0, change), (0.01, change), (1.0, ask), (1.01, answer)]
        assert kinds(pieces, "ascii") == ["answered", "answered"]

    def test_no_framing(self) -> None:
        with pytest.raises(ValueError, match='framing must be "rtu" or "ascii"'):
            Separator("tcp")  # type: ignore[arg-type]


def test_frames_by_chance_inside_frames_without_a_length() -> None:
    """A prefix of this frame has a fitting CRC; what follows it is not a frame."""
    body = find_chance()
    data = rtu(body)
    assert named([(0.0, data + data), (1.0, b"")]) == [
        ("request", data[1:-2]),
        ("response", data[1:-2]),
    ]


def find_chance() -> str:
    """Diagnostics with six bytes, the last of which make the CRC of what precedes them fit."""
    start = "01 08 00 00 97 67"
    prefix = rtu(start)
    return start + prefix[-2:].hex() + "11 22"


def test_scripts_of_any_size_give_the_same() -> None:
    """However the bytes are cut, and whenever they are seen, they mean the same."""
    writes = rtu("02 10 00 01 00 01 02 00 05") + rtu("02 10 00 01 00 01")
    data = ASK + ANSWER + WRITE + WRITE + writes
    whole = named([(0.0, data)])
    assert [part for part, _ in whole] == ["request", "response"] * 3
    for size in range(1, 20):
        pieces = [(0.0, data[at : at + size]) for at in range(0, len(data), size)]
        assert named(pieces) == whole


def test_more_bytes_than_one_piece_are_cut_anywhere() -> None:
    choose = random.Random(11)
    pairs: Sequence[tuple[bytes, bytes]] = pairs_of("rtu")
    data = b"".join(question + answer for question, answer in pairs * 20)
    pieces: list[Piece] = []
    while data:
        size = choose.randint(1, 300)
        pieces.append((0.0, data[:size]))
        data = data[size:]
    assert len(listen(pieces)) == 20 * len(pairs)
