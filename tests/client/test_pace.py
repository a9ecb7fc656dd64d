"""
How many requests go out at once, which ids they have, and what is counted.
"""

from __future__ import annotations

from dataclasses import fields

import pytest

from libmodbus_py import pdu
from libmodbus_py.client.statistics import TIME_BOUNDS, Statistics
from tests.support.talk import LINE, TCP, Talk, kinds, rtu, tcp, value


def ids(talk: Talk) -> list[int]:
    return [int.from_bytes(adu[:2], "big") for adu in talk.sent]


def test_ids_count_up_and_begin_anew() -> None:
    talk = Talk()
    talk.matching._last = 0xFFFD
    for address in range(4):
        talk.ask(address)
        talk.come(tcp(talk.sent[-1]))
    assert ids(talk) == [0xFFFE, 0xFFFF, 0, 1]


def test_an_id_in_flight_or_owed_is_skipped() -> None:
    talk = Talk(timeout=1.0, retries=0)
    talk.ask(1, go_on=True)
    talk.wait(1.0)
    talk.ask(2)
    talk.matching._last = 0
    talk.ask(3)
    assert ids(talk) == [1, 2, 3]


@pytest.mark.parametrize(
    ("limit", "at_once"), [(1, 8), (2, 1), (3, 2), (4, 2), (7, 4), (8, 4), (16, 8), (99, 8)]
)
def test_half_of_a_batch_goes_first(limit: int, at_once: int) -> None:
    """The rest goes when the first are answered, so that neither side rests."""
    talk = Talk()
    talk.conversation.add(talk.batch(*range(40), limit=limit), talk.now)
    assert len(talk.conversation.start(talk.now)) == min(at_once, limit)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 40])
def test_of_many_callers_half_go_first(count: int) -> None:
    talk = Talk()
    for address in range(count):
        talk.conversation.add(talk.batch(address), talk.now)
    assert len(talk.conversation.start(talk.now)) == min(count, 8)
    # Then the other half; more are not in flight.
    rest = talk.conversation.start(talk.now)
    assert len(rest) == min(8, max(0, count - 8))
    assert talk.conversation.start(talk.now) == []


def test_with_spacing_one_goes_at_a_time() -> None:
    talk = Talk(f"{TCP}?request_spacing=0.5", timeout=9.0)
    talk.ask(*range(4), limit=4)
    talk.wait(2.0)
    assert talk.times == pytest.approx([0.0, 0.5, 1.0, 1.5])


def test_a_broadcast_waits_for_what_any_unit_owes() -> None:
    """Unit 1 owes an answer, unit 5 does not: the broadcast waits, unit 5 is asked at once."""
    talk = Talk(LINE, timeout=1.0, retries=0)
    talk.ask(1, unit=1, go_on=True)
    talk.wait(1.0)
    talk.ask(1, unit=5)
    assert len(talk.sent) == 2
    talk.come(value(1, unit=5))
    talk.ask(pdu.WriteRegister(1, 1), unit=0, is_broadcast=True)
    assert len(talk.sent) == 2
    talk.wait(1.0)
    assert len(talk.sent) == 3


@pytest.mark.parametrize("unit", [1, 2, 247])
def test_each_unit_waits_for_what_it_owes_itself(unit: int) -> None:
    talk = Talk(LINE, timeout=1.0, retries=0)
    talk.ask(1, unit=unit, go_on=True)
    talk.wait(1.0)
    talk.ask(1, unit=unit)
    assert len(talk.sent) == 1
    talk.wait(0.9)
    assert len(talk.sent) == 1
    talk.wait(0.2)
    assert len(talk.sent) == 2


@pytest.mark.parametrize("left", ["01 03 FA 00", "01", "01 83", "01 03 02 00 07 00"])
def test_half_a_frame_that_was_left_is_not_put_before_the_next_answer(left: str) -> None:
    talk = Talk(LINE, timeout=1.0, retries=0)
    talk.ask(1, go_on=True)
    talk.come(bytes.fromhex(left))
    talk.wait(1.0)
    batch = talk.ask(2)
    talk.wait(1.5)
    assert len(talk.sent) == 2
    talk.come(value(2))
    assert batch.outcomes == [[2]]


def test_several_answers_at_once_prove_one_life() -> None:
    talk = Talk()
    batch = talk.ask(*range(8), limit=8)
    talk.come(b"".join(map(tcp, talk.sent)))
    talk.come(b"".join(map(tcp, talk.sent[4:])))
    assert kinds(batch) == [[address] for address in range(8)]


# --- statistics -----------------------------------------------------------------------------


def test_nothing_is_counted_at_first() -> None:
    statistics = Statistics()
    assert statistics.last_success is None
    assert statistics.answer_times == [0] * (len(TIME_BOUNDS) + 1)
    rest = {each.name for each in fields(Statistics)} - {"last_success", "answer_times"}
    assert not any(getattr(statistics, name) for name in rest)


def test_bounds_of_times_are_those_of_the_documentation() -> None:
    """Dashboards have them: 100 us to 10 s, each about twice the one before."""
    milliseconds = [0.1, 0.25, 0.5, 1, 2.5, 5, 10, 25, 50, 100, 250, 500, 1000, 2500, 5000, 10_000]
    assert [bound * 1000 for bound in TIME_BOUNDS] == pytest.approx(milliseconds)


@pytest.mark.parametrize(
    ("seconds", "place"), [(0.0001, 0), (0.00011, 1), (0.1, 9), (10.0, 15), (10.1, 16)]
)
def test_an_answer_is_counted_up_to_its_bound(seconds: float, place: int) -> None:
    statistics = Statistics()
    statistics.note_answer(3, "ok", seconds, 0.0)
    statistics.note_answer(3, "exception", seconds, 0.0)
    assert [at for at, count in enumerate(statistics.answer_times) if count] == [place]
    assert statistics.answer_times[place] == statistics.responses == 2
    assert statistics.answer_seconds == 2 * seconds
    assert statistics.results == {(3, "ok"): 1, (3, "exception"): 1}


def test_what_is_sent_is_what_the_specification_says() -> None:
    talk = Talk(LINE)
    talk.ask(0x6B, unit=17)
    assert talk.sent == [rtu("11 03 00 6B 00 01")]
