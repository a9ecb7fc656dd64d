"""
How many requests go out at once, which ids they have, and what is counted.
"""

from __future__ import annotations

from dataclasses import fields

import pytest

from libmodbus_py import ModbusTimeoutError, pdu
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


@pytest.mark.parametrize("limit", [1, 2, 7, 16, 99])
def test_a_batch_has_as_many_in_flight_as_it_may(limit: int) -> None:
    talk = Talk()
    talk.connection.submit(talk.batch(*range(40), limit=limit), talk.now)
    assert len(talk.connection.start(talk.now)) == min(limit, 16)
    assert talk.connection.start(talk.now) == []


def test_many_callers_have_as_many_in_flight_as_there_may_be() -> None:
    talk = Talk()
    for address in range(40):
        talk.connection.submit(talk.batch(address), talk.now)
    assert len(talk.connection.start(talk.now)) == 16
    assert talk.connection.start(talk.now) == []


def test_with_spacing_one_goes_at_a_time() -> None:
    talk = Talk(f"{TCP}?request_spacing=0.5", timeout=9.0)
    talk.ask(*range(4), limit=4)
    talk.wait(2.0)
    assert talk.times == pytest.approx([0.0, 0.5, 1.0, 1.5])


def test_a_broadcast_waits_for_the_calls_before_it_and_for_no_doubt() -> None:
    """Unit 1 owes an answer: a broadcast goes at once, but not before a request to unit 1."""
    talk = Talk(LINE, timeout=1.0, retries=0, turnaround=0.1)
    talk.ask(1, unit=1, go_on=True)
    talk.wait(1.0)
    talk.ask(pdu.WriteRegister(1, 1), unit=0, is_broadcast=True)
    assert [adu[0] for adu in talk.sent] == [1, 0]
    talk.ask(2, unit=1)
    talk.ask(pdu.WriteRegister(1, 2), unit=0, is_broadcast=True)
    talk.ask(1, unit=5)
    talk.wait(0.9)
    assert len(talk.sent) == 2
    talk.wait(0.1)
    talk.wait(1.0)
    assert [adu[0] for adu in talk.sent] == [1, 0, 1, 0]
    talk.wait(0.1)
    assert [adu[0] for adu in talk.sent] == [1, 0, 1, 0, 5]


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
    talk.wait(1)  # what unit 1 owes is another request, so this answer is not believed
    assert kinds(batch) == [ModbusTimeoutError]
    batch = talk.ask(2)
    talk.wait(1)
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
