"""
Which bytes on a line are requests and which responses: scripted bytes and times, no port.

Frames are those of the specification (tests/support/vectors.json) or carry check bytes that
talk.py computes.
"""

import random
import tracemalloc
from collections.abc import Iterable
from typing import get_args

import pytest

from libmodbus_py import pdu
from libmodbus_py.listen import Separator, Transaction
from libmodbus_py.tools.listener.transaction import Kind, TimedFrame
from tests.support.cases import each_case
from tests.support.driver import ascii_frame, rtu
from tests.support.framing import NO_REQUESTS
from tests.support.vectors import exchanges

ASK = rtu("01 03 00 00 00 02")
ANSWER = rtu("01 03 04 00 07 00 09")
WRITE = rtu("01 06 00 05 12 34")
OTHER_WRITE = rtu("01 06 00 06 12 34")
REFUSAL = rtu("01 83 02")

MAKE = {"rtu": rtu, "ascii": ascii_frame}

ECHOED = ["06 00 05 12 34", "05 00 05 FF 00", "16 00 04 00 F2 00 25", "08 00 00 A5 37"]

Piece = tuple[float, bytes]


def listen(pieces: Iterable[Piece], framing: str = "rtu") -> list[Transaction]:
    separator = Separator(framing)  # type: ignore[arg-type]
    transactions = [frame for at, data in pieces for frame in separator.feed(data, at)]
    return transactions + separator.end()


def kinds(pieces: Iterable[Piece], framing: str = "rtu") -> list[str]:
    return [entry.kind for entry in listen(pieces, framing)]


def parts_of(pieces: Iterable[Piece], framing: str = "rtu") -> list[tuple[str, bytes]]:
    frames: list[TimedFrame] = []
    separator = Separator(framing, frames.append)  # type: ignore[arg-type]
    for at, data in pieces:
        separator.feed(data, at)
    separator.end()
    return [(frame.part, frame.frame.pdu if frame.frame else frame.data) for frame in frames]


@each_case("framing", ["rtu", "ascii"])
@each_case("step", [0, 1, 7, -1], ids=["whole", "bytes", "sevens", "all in one piece"])
def test_every_example_of_the_specification_finds_its_answer(framing: str, step: int) -> None:
    pairs = [exchange for exchange in exchanges() if exchange[0].unit != 0]
    pieces: list[Piece] = []
    at = 0.0
    for vectors in pairs:
        for vector, pause in zip(vectors, (0.01, 0.05), strict=True):
            data = getattr(vector, framing)
            size = max(step, 0) or len(data)
            pieces += [(at, data[n : n + size]) for n in range(0, len(data), size)]
            at += pause
    if step < 0:
        pieces = [(0.0, b"".join(data for _, data in pieces))]
    transactions = listen(pieces, framing)
    assert {transaction.kind for transaction in transactions} == {"answered", "exception"}
    assert len(transactions) == len(pairs) > 15


def test_a_request_and_its_answer_have_their_times() -> None:
    (pair,) = listen([(100.0, ASK), (100.25, ANSWER)])
    assert (pair.kind, pair.time, pair.unit, pair.function) == ("answered", 100.0, 1, 3)
    assert (pair.request, pair.response) == (pdu.ReadHoldingRegisters(0, 2), [7, 9])
    assert pair.duration == pytest.approx(0.25)
    assert pair.error is None
    assert pair.is_good


def test_refusals_and_unanswered_and_wrongly_answered_requests_are_told_apart() -> None:
    (refused,) = listen([(0.0, ASK), (0.1, REFUSAL)])
    assert (refused.kind, getattr(refused.error, "code", None)) == ("exception", 2)
    (silent,) = listen([(0.0, ASK)])
    assert (silent.kind, silent.duration, silent.response) == ("unanswered", None, None)
    (wrong,) = listen([(0.0, ASK), (0.1, rtu("01 03 02 00 07"))])
    assert (wrong.kind, wrong.request) == ("invalid", pdu.ReadHoldingRegisters(0, 2))
    (alone,) = listen([(0.0, ANSWER)])
    assert (alone.kind, alone.unit, alone.request) == ("unasked", 1, None)


def test_undecoded_requests_keep_their_bytes() -> None:
    (refused,) = listen([(0.0, rtu("01 03 00 00 00 00")), (0.1, rtu("01 83 03"))])
    assert (refused.request, refused.kind) == (pdu.RawRequest(3, bytes(4)), "exception")
    (unknown,) = listen([(0.0, rtu("01 41 AA BB")), (0.1, rtu("01 41 CC"))])
    assert unknown.request == pdu.RawRequest(0x41, b"\xaa\xbb")
    assert unknown.response == b"\xcc"


def test_each_kind_of_transaction_has_a_text() -> None:
    for kind in get_args(Kind):
        assert str(Transaction(0.0, kind))


@each_case("code", ["00", "80"])
@each_case("direction", [None, "client", "server"])
@each_case("framing", ["rtu", "ascii"])
def test_a_frame_without_a_function_is_invalid(code, direction, framing) -> None:
    separator = Separator(framing)  # type: ignore[arg-type]
    frame = MAKE[framing](f"01 {code} 01")
    transactions = separator.feed(frame, 0.0, direction)  # type: ignore[arg-type]
    transactions += separator.end()
    assert [(item.kind, item.unit) for item in transactions] == [("invalid", 1)]
    assert f"{code}h" in str(transactions[0])


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_a_valid_frame_without_a_request_is_no_damage(framing: str) -> None:
    """It is an exception to something that was not asked, or invalid, whatever ends it."""
    make = MAKE[framing]
    ask, answer = make("02 03 0000 0001"), make("02 03 02 0001")
    for body in ["00", "00 01 02 03", *NO_REQUESTS]:
        frames = [ask, answer, make(f"02 {body}"), ask, answer]
        outcome = kinds([(at / 10, frame) for at, frame in enumerate(frames)], framing)
        assert outcome[0] == outcome[-1] == "answered", body
        assert outcome[1:-1] in (["unasked"], ["invalid"]), body


def in_bytes(frame: bytes) -> list[Piece]:
    return [(at / 1000, frame[at : at + 1]) for at in range(len(frame))]


def damaged(frame: bytes) -> bytes:
    return frame[:-1] + bytes([frame[-1] ^ 1])


OTHER = rtu("02 03 00 00 00 01")
BITS, BITS_ANSWER = rtu("01 01 03 00 00 14"), rtu("01 01 03 FF 00 01")
NEXT = [(0.2, ASK), (0.3, ANSWER)]

LINES: list[tuple[list[Piece], str]] = [
    ([(0.0, rtu("00 06 00 05 12 34")), *NEXT], "broadcast, answered"),
    ([(0.0, rtu("01 08 00 04 00 00")), *NEXT], "broadcast, answered"),  # listen only
    # no function in place of a response, in pieces, and noise of that form
    ([(0.0, ASK), (0.1, rtu("01 00 02")), *NEXT], "invalid, answered"),
    ([(0.0, ASK), (0.1, rtu("01 80 02")), (0.2, ANSWER)], "invalid, answered"),
    (in_bytes(rtu("01 00 02 03")), "invalid"),
    ([(0.0, bytes.fromhex("01 00 02 03 04 05")), *NEXT], "damaged, answered"),
    # answers that are late, or come twice
    ([(0.0, ASK), (1.0, ASK), (1.01, ANSWER), (1.02, ANSWER)], "unanswered, answered, unasked"),
    ([(0.0, WRITE), (1.0, OTHER), (1.01, WRITE), (1.02, rtu("02 03 02 00 05"))],
     "unanswered, late, answered"),
    # the same write: at once behind a repeated one it is asked anew, because it is answered
    ([(0.0, WRITE), (1.0, WRITE), (1.01, WRITE), (1.02, WRITE), (1.03, WRITE)],
     "unanswered, answered, answered"),
    ([piece for n in range(5) for piece in ((n, WRITE), (n + 0.01, WRITE))],
     ", ".join(["answered"] * 5)),
    ([(0.0, WRITE), (0.3, OTHER_WRITE), (0.31, OTHER_WRITE)], "unanswered, answered"),
    # a question that was damaged for the listener alone
    ([(0.0, b"\xff" + WRITE[1:]), (0.01, WRITE), (0.02, ASK), (0.03, ANSWER)],
     "damaged, unasked, answered"),
    # an answer with three bytes of bits is as long as a question
    ([(0.0, BITS), (0.01, BITS_ANSWER)], "answered"),
    ([(0.0, BITS), (1.0, BITS), (1.01, BITS_ANSWER)], "unanswered, answered"),
    # damage: a question, an answer, and an answer before the same write, late or at once
    ([(0.0, bytes([ASK[0] ^ 2]) + ASK[1:]), *NEXT], "damaged, answered"),
    ([(0.0, ASK), (0.01, damaged(ANSWER))], "damaged"),
    ([(0.0, WRITE), (0.005, damaged(WRITE)), (0.4, WRITE), (0.405, WRITE)], "damaged, answered"),
    ([(0.0, WRITE), (0.005, damaged(WRITE)), (0.03, WRITE), (0.035, WRITE)], "damaged, answered"),
    # behind silence a frame counts, whatever a front that claims more still waits for
    *(([(0.0, bytes([1, code, 0xFA, 0])), (0.5, ASK), (0.505, ANSWER)], "damaged, answered")
      for code in (3, 0x10, 0x55, 0x2B, 8, 0x83)),
]  # fmt: skip


@each_case(("pieces", "text"), LINES)
def test_frames_on_a_line_become_transactions(pieces: list[Piece], text: str) -> None:
    assert ", ".join(kinds(pieces)) == text


@each_case("question", ECHOED)
def test_an_equal_frame_is_the_answer_if_it_comes_soon_and_else_a_repetition(question: str) -> None:
    write = rtu("01" + question)
    assert kinds([(0.0, write), (0.005, write)]) == ["answered"]
    assert kinds([(0.0, write), (1.0, write), (1.005, write)]) == ["unanswered", "answered"]


@each_case(
    ("answers", "timeout", "last", "text"),
    [
        (0.4, 3.0, [200.0, 200.4], ["answered"]),
        (0.002, 0.05, [200.0, 200.05, 200.052], ["unanswered", "answered"]),
    ],
)
def test_the_time_limit_for_answers_is_adapted(answers, timeout, last, text) -> None:
    """The unit takes so long to answer, and the client waits so long for an answer."""
    pieces: list[Piece] = []
    for number in range(10):
        at = 10.0 * number
        pieces += [(at, ASK), (at + answers, ANSWER), (at + 1, OTHER), (at + 1 + timeout, OTHER)]
    assert kinds([*pieces, *((at, WRITE) for at in last)])[-len(text) :] == text


def test_repeats_are_counted_and_late_answers_named() -> None:
    transactions = listen([(0.0, ASK), (1.0, ASK), (2.0, ASK), (2.1, ANSWER)])
    assert [(transaction.kind, transaction.repeats) for transaction in transactions] == [
        *(("unanswered", 0), ("unanswered", 1), ("answered", 2))
    ]
    _, late, _ = listen([(0.0, ASK), (1.0, OTHER), (1.1, ANSWER)])
    assert (late.kind, late.unit, late.response) == ("late", 1, [7, 9])
    assert late.duration == pytest.approx(1.1)


def test_a_second_copy_of_an_echo_is_unasked() -> None:
    pieces = [(0.0, WRITE), (1.0, WRITE), (1.01, WRITE), (1.02, WRITE), (1.05, ASK), (1.06, ANSWER)]
    assert kinds(pieces) == ["unanswered", "answered", "unasked", "answered"]
    parts = [part for part, _ in parts_of(pieces)]
    assert parts == ["request", "request", "response", "response", "request", "response"]


def test_damage_in_place_of_a_response_and_beside_it() -> None:
    bad = damaged(ANSWER)
    (transaction,) = listen([(0.0, ASK), (0.01, bad)])
    assert transaction.request == pdu.ReadHoldingRegisters(0, 2)
    assert transaction.error is not None
    assert transaction.error.received == bad
    pieces = [(0.0, b"\xff" + ASK), (0.01, b"\x00\xfe" + ANSWER + b"\xfd\xfc"), (1.0, ASK)]
    outcome = kinds([*pieces, (1.01, ANSWER)])
    assert [entry for entry in outcome if entry != "damaged"] == ["answered", "answered"]
    ask, answer = ascii_frame("01 03 00 00 00 02"), ascii_frame("01 03 04 00 07 00 09")
    outcome = kinds([(0.0, b"noise"), (1.0, ask), (1.1, answer)], "ascii")
    assert outcome == ["damaged", "answered"]


def test_pauses_inside_a_frame_do_not_end_it() -> None:
    """A long answer came in pieces of 32 bytes, with gaps."""
    data = rtu("01 03 A0" + "00 07" * 80)
    pieces = [(0.0, rtu("01 03 00 00 00 50"))]
    pieces += [(0.1 + at / 32 * 0.03, data[at : at + 32]) for at in range(0, len(data), 32)]
    (transaction,) = listen(pieces)
    assert (transaction.kind, transaction.response) == ("answered", [7] * 80)


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_noise_is_reported_before_it_ends_with_bounded_memory(framing: str) -> None:
    noise = random.Random(3)
    separator = Separator(framing)  # type: ignore[arg-type]
    counts = []
    tracemalloc.start()
    for number in range(200):
        transactions = separator.feed(noise.randbytes(4096), number * 0.001)
        counts.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert counts[-1] < counts[20] + 100_000
    assert any(transaction.kind == "damaged" for transaction in transactions)


@each_case("framing", ["rtu", "ascii"])
@each_case("seed", range(30))
def test_a_line_is_decoded_again_after_damage(framing: str, seed: int) -> None:
    """Whatever comes before, nothing is raised."""
    choose = random.Random(seed)
    separator = Separator(framing)  # type: ignore[arg-type]
    make = MAKE[framing]
    ask, answer = make("01 03 00 00 00 02"), make("01 03 04 00 07 00 09")
    at = 0.0
    for _ in range(40):
        piece = choose.choice([ask, answer, choose.randbytes(choose.randint(0, 60))])
        separator.feed(piece[choose.randrange(3) :], at)
        at += choose.choice([0.0, 0.001, 0.03, 1.5])
    at += 2
    separator.tick(at)
    separator.feed(ask, at)
    transactions = separator.feed(answer, at + 0.01)
    assert [transaction.kind for transaction in transactions][-1] == "answered"


FRONT = bytes([1, 3, 0xFA, 0, 0])


@each_case(
    ("pieces", "results"),
    [
        ([(ASK, None)], {1.0: [], 20.0: [("unanswered", b"")], 21.0: []}),
        ([(ASK[:4], None)], {0.1: [], 2.0: [("damaged", ASK[:4])]}),
        # Nothing but silence behind two good frames shows that the front is none.
        ([(FRONT + ASK + ANSWER, None)], {0.1: [("damaged", FRONT), ("answered", b"")]}),
        ([(ASK, "client"), (ANSWER[:3], "server")], {0.5: [], 9.0: [("damaged", ANSWER[:3])]}),
    ],
)
def test_a_finished_transaction_is_returned_without_another_byte(pieces, results) -> None:
    separator = Separator("rtu")
    for data, direction in pieces:
        assert separator.feed(data, 0.0, direction) == []
    for at, outcomes in results.items():
        transactions = separator.tick(at)
        outcome = [(item.kind, item.error.received if item.error else b"") for item in transactions]
        assert outcome == outcomes, at
    is_known = pieces[0][1] is not None
    assert separator.feed(ASK, 30.0, "client" if is_known else None) == []
    (transaction,) = separator.feed(ANSWER, 30.1, "server" if is_known else None)
    assert transaction.kind == "answered"


def test_a_known_direction_decides_between_request_and_response() -> None:
    separator = Separator("rtu")
    assert separator.feed(WRITE, 0.0, "client") == []
    assert separator.feed(WRITE, 1.0, "client")[0].kind == "unanswered"
    (transaction,) = separator.feed(WRITE, 1.9, "server")
    assert (transaction.kind, transaction.repeats) == ("answered", 1)
    separator.feed(OTHER, 2.0, "client")
    (transaction,) = separator.feed(rtu("02 03 02 00 05"), 2.1, "server")  # shorter than a request
    assert transaction.kind == "answered"


def test_a_framing_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match='framing must be "rtu" or "ascii"'):
        Separator("tcp")  # type: ignore[arg-type]


def test_bytes_in_pieces_of_any_size_give_the_same_transactions() -> None:
    """However the bytes are cut, and whenever they are seen, they mean the same."""
    writes = rtu("02 10 00 01 00 01 02 00 05") + rtu("02 10 00 01 00 01")
    data = ASK + ANSWER + WRITE + WRITE + writes
    whole = parts_of([(0.0, data)])
    assert [part for part, _ in whole] == ["request", "response"] * 3
    for size in range(1, 20):
        pieces = [(0.0, data[at : at + size]) for at in range(0, len(data), size)]
        assert parts_of(pieces) == whole
