"""
The number of requests in flight, without a conversation: what makes it grow and fall, and which
requests are asked again alone.
"""

from __future__ import annotations

from libmodbus_py import InvalidResponse, ModbusTimeoutError, ServerDeviceBusy, pdu
from libmodbus_py.client.batch import Batch, Pending, Reply
from libmodbus_py.client.capacity import Capacity, is_refused
from libmodbus_py.client.timeouts import Timeouts
from tests.support.cases import each_case
from tests.support.talk import Talk, tcp

LATE = ModbusTimeoutError("late")
ANSWER = b"\x03\x02\x00\x07"


def capacity() -> Capacity:
    """Return that of a client that begins."""
    return Talk(max_in_flight=None).conversation.capacity


def started(capacity: Capacity, *functions: int, sent: float = 0.0) -> list[Pending]:
    """Start requests of these functions, one beside the other."""
    found = []
    for at, function in enumerate(functions):
        batch = Batch(1, [pdu.ReadCoils(0, 1)], Timeouts(1, 0, 0), pdus=[bytes([function])])
        found.append(Pending(batch, 0, b"", sent))
        capacity.note_start(found[-1], at)
    return found


def lost(capacity: Capacity) -> int:
    """Lose two requests until one is to be asked alone; return how many were not."""
    for count in range(9999):
        if capacity.takes(LATE, started(capacity, 3, 3)[0]):
            return count
    raise AssertionError("no loss is tried alone")


def test_it_begins_with_one_and_doubles_while_all_places_are_used() -> None:
    made = capacity()
    assert (made.now, made.is_growing, made.learns_from_one) == (1, True, True)
    found = []
    for _ in range(4):
        replies: list[tuple[Pending, Reply]] = [
            (each, ANSWER) for each in started(made, *[3] * made.now)
        ]
        made.note_replies(replies, made.now, 0.1)
        found.append(made.now)
    assert found == [2, 4, 8, 16]
    assert not made.is_growing
    assert not made.learns_from_one


def test_it_doubles_once_as_many_were_answered_as_were_in_flight() -> None:
    made = capacity()
    made.note_replies([(started(made, 3)[0], ANSWER)], 1, 0.1)
    assert made.now == 2
    first, second = started(made, 3, 3)
    made.note_replies([(first, ANSWER)], 2, 0.1)
    assert made.now == 2
    made.note_replies([(second, ANSWER)], 1, 0.1)
    assert made.now == 4


def test_it_does_not_grow_where_a_request_beside_others_was_lost() -> None:
    for in_flight, expected in ((2, 2), (1, 4)):
        made = capacity()
        made.note_replies([(started(made, 3)[0], ANSWER)], 1, 0.1)
        first, second = started(made, 3, 3)
        made.note_replies([(first, LATE), (second, ANSWER)], in_flight, 0.1)
        assert made.now == expected


@each_case(("answers", "expected"), [(1, 8), (1000, 8), (1001, 16)])
def test_one_loss_in_1000_answers_is_no_sign(answers: int, expected: int) -> None:
    talk = Talk(max_in_flight=None)
    made, statistics = talk.conversation.capacity, talk.statistics
    for _ in range(4):
        made.note_replies([(each, ANSWER) for each in started(made, *[3] * made.now)], 1, 0.1)
    for count in (5000, answers):
        assert made.now == 16
        statistics.responses += count
        first = started(made, *[3] * 16)[0]
        assert made.takes(LATE, first)
        assert made.next_trial() is not None
        is_taken, _ = made.conclude(ANSWER)
        assert is_taken
    assert made.now == expected
    assert statistics.falls == (expected < 16)
    assert not made.is_growing


def test_it_stays_while_places_are_free() -> None:
    made = capacity()
    made.note_replies([(started(made, 3)[0], ANSWER)], 1, 0.1)
    for _ in range(9):
        made.note_replies([(started(made, 3)[0], ANSWER)], 1, 0.1)
    assert made.now == 2


def test_one_that_was_given_is_fixed() -> None:
    made = Talk(max_in_flight=4).conversation.capacity
    assert (made.now, made.is_open, made.is_growing, made.learns_from_one) == (
        *(4, False),
        *(False, False),
    )


def test_a_read_is_asked_again_whatever_was_written_since() -> None:
    reads = {1, 2, 3, 4, 7, 11, 12, 17, 20, 24, 43}
    for function in range(1, 0x80):
        made = capacity()
        older, _ = started(made, function, 6)
        assert made.takes(LATE, older) is (function in reads), function


def test_the_last_write_is_asked_again() -> None:
    made = capacity()
    (_, write, _) = started(made, 6, 6, 3)
    assert made.takes(LATE, write)


@each_case(
    ("error", "expected"), [(LATE, True), (ServerDeviceBusy(), True), (InvalidResponse(), False)]
)
def test_what_was_lost_or_refused_is_asked_again(error: Exception, expected: bool) -> None:
    made = capacity()
    first, last = started(made, 3, 3)
    assert made.takes(error, first) is expected  # type: ignore[arg-type]
    assert made.takes(error, last) is expected  # type: ignore[arg-type]
    made = capacity()
    assert not made.takes(error, started(made, 3)[0])  # type: ignore[arg-type]


@each_case(
    ("reply", "expected"),
    [
        (LATE, True),
        (InvalidResponse(), False),
        (b"\x83\x06", True),
        (b"\x83\x02", False),
        (b"\x83", False),
        (b"\x03\x06" + bytes(6), False),
    ],
)
def test_silence_and_busy_say_that_a_request_was_not_taken(reply: Reply, expected: bool) -> None:
    assert is_refused(reply) is expected


def test_after_each_trial_without_an_answer_fewer_losses_are_tried() -> None:
    """After n in a row 2**n - 1 are not; one that is answered begins anew."""
    made = capacity()
    found = []
    for _ in range(4):
        found.append(lost(made))
        assert made.next_trial() is not None
        made.conclude(b"\x83\x06")
    assert found == [0, 1, 3, 7]
    assert lost(made) == 15
    assert made.next_trial() is not None
    made.conclude(ANSWER)
    for expected in (0, 1):
        assert lost(made) == expected
        assert made.next_trial() is not None
        made.conclude(LATE)
        made.silent.clear()


def test_a_unit_that_is_silent_alone_is_tried_again_once_it_answered() -> None:
    made = capacity()
    first, last = started(made, 3, 3)
    assert made.takes(LATE, first)
    assert made.next_trial() is not None
    assert made.conclude(LATE) == (False, [])
    assert made.silent == {(1, 0), (1, 3)}
    assert made.learns_from_one
    assert not made.takes(LATE, last)
    made.note_answers([(last, LATE)])
    assert made.silent
    made.note_answers([(last, ANSWER)])
    assert made.silent == set()


def test_another_connection_knows_nothing_of_the_last() -> None:
    made = capacity()
    made.note_replies([(started(made, 3, sent=0.0)[0], ANSWER)], 1, 0.2)
    assert made.time_for_trial(1.0) == 0.8  # four times the slowest answer
    assert made.time_for_trial(0.5) == 0.5
    first, _ = started(made, 3, 3)
    assert made.takes(LATE, first)
    assert made.next_trial() is not None
    made.conclude(LATE)
    made.reset()
    assert (made.now, made.silent, made.is_on_trial, made.lost) == (1, set(), False, [])
    assert made.time_for_trial(1.0) == 0.25
    assert lost(made) == 0


def test_who_leaves_takes_his_requests_along() -> None:
    made = capacity()
    first, second, third = started(made, 3, 3, 3)
    for each in (first, second, third):
        assert made.takes(LATE, each)
    asked = made.next_trial()
    assert asked is not None
    assert asked[0] is first
    made.drop(second.batch)
    assert [each for each, _ in made.lost] == [third]
    assert made.is_on_trial
    made.drop(first.batch)
    assert not made.is_on_trial
    made.drop(third.batch)
    assert made.next_trial() is None


def test_an_id_that_nobody_asked_with_is_told_as_that_of_another() -> None:
    talk = Talk(timeout=1)
    batch = talk.ask(5)
    talk.come(tcp(talk.sent[-1], number=0x0909))
    talk.wait(1)
    (error,) = batch.outcomes
    assert "id 2313, not 1" in str(error)
    assert error.answers_another
