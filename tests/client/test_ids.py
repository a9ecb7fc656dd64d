"""Which answer is whose where frames carry transaction ids, told in bytes and times."""

import random

import pytest

from libmodbus_py import FrameError, ModbusConnectionError, ModbusTimeoutError, Traced, pdu
from tests.support.driver import Driver, kinds, tcp
from tests.support.replies import exchange


def test_a_request_has_the_header_of_the_specification() -> None:
    talk = Driver()
    talk.ask(0x6B, unit=0x11)
    assert talk.sent == [bytes.fromhex("0001 0000 0006 11 03 006B 0001")]


@pytest.mark.parametrize("seed", range(5))
def test_answers_may_come_in_any_pieces(seed: int) -> None:
    chance = random.Random(seed)
    talk = Driver()
    batch = talk.ask(*range(10), one_by_one=False)
    data = b"".join(tcp(each) for each in talk.sent)
    while data:
        size = chance.randrange(1, 20)
        talk.come(data[:size])
        data = data[size:]
    assert batch.outcomes == [[address] for address in range(10)]


@pytest.mark.parametrize("limit", [1, 3, 16, 99])
def test_a_batch_has_as_many_in_flight_as_the_client_may(limit: int) -> None:
    talk = Driver(max_in_flight=limit)
    batch, most = talk.ask(*range(40), one_by_one=limit == 1), min(limit, 40)
    assert len(talk.sent) == most
    talk.come(tcp(talk.sent[most // 2]))
    assert len(talk.sent) == min(most + 1, 40)
    while not batch.is_done:
        talk.come(tcp(talk.sent[-1]), *(tcp(each) for each in talk.sent[:-1]))
    assert batch.outcomes == [[address] for address in range(40)]
    others = [talk.ask(address) for address in range(40)]
    assert len(talk.sent) == 40 + most
    assert not any(each.is_done for each in others)


def test_callers_take_turns() -> None:
    talk = Driver(max_in_flight=2)
    talk.ask(*range(10), one_by_one=False)
    talk.ask(100)
    talk.ask(200)
    for at in range(4):
        talk.come(tcp(talk.sent[at]))
    assert [int.from_bytes(each[8:10], "big") for each in talk.sent] == [0, 1, 2, 100, 200, 3]


def test_an_id_that_nobody_had_answers_nobody_and_is_shown_at_the_end() -> None:
    talk = Driver(timeout=1)
    batch = talk.ask(1)
    stranger = tcp(talk.sent[0], number=999)
    talk.come(stranger)
    assert not batch.is_done
    talk.wait(1)
    assert kinds(batch) == [ModbusTimeoutError]
    assert "id 999, not 1" in str(batch.outcomes[0])
    assert batch.outcomes[0].received == stranger
    assert talk.statistics.late_answers == 1


@pytest.mark.parametrize("length", [0, 1, 255, 0xFFFF])
def test_a_length_that_cannot_be_fails_all_and_breaks_the_connection(length: int) -> None:
    talk = Driver()
    batches = [talk.ask(1), talk.ask(2)]
    talk.come(b"\0\1\0\0" + length.to_bytes(2, "big") + b"\1\3")
    assert [kinds(batch) for batch in batches] == [[FrameError]] * 2
    assert batches[0].outcomes[0] is not batches[1].outcomes[0]
    assert batches[1].outcomes[0].asked == "ReadHoldingRegisters(address=2, count=1)"
    waiting = talk.ask(3)
    assert len(talk.sent) == 2
    talk.replace_broken()
    talk.come(tcp(talk.sent[2]))
    assert waiting.outcomes == [[3]]


def test_what_nobody_asked_for_breaks_the_connection_after_64_kib() -> None:
    talk = Driver()
    frame = bytes.fromhex("7777 0000 00FE 01 03 FA") + bytes(251)
    for _ in range(0x10000 // 260):
        talk.come(frame)
        assert not talk.connection.is_flooded
    talk.come(frame * 2)
    assert talk.connection.is_flooded
    assert isinstance(talk.connection.broken, ModbusConnectionError)
    talk.replace_broken()
    assert not talk.connection.is_flooded
    talk.ask(1)
    assert len(talk.sent) == 1


def test_a_request_that_nobody_answers_takes_the_turnaround_before_the_next_one() -> None:
    talk = Driver(turnaround=0.1)
    silent = talk.ask(pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0"))
    other = talk.ask(5)
    talk.wait(0.09)
    assert not silent.is_done
    assert len(talk.sent) == 1
    talk.wait(0.01)
    assert silent.outcomes == [None]
    talk.come(tcp(talk.sent[1]))
    assert other.outcomes == [[5]]
    assert talk.statistics.timeouts == 0
    assert talk.is_at_rest


def test_what_comes_before_the_first_request_is_traced_too() -> None:
    seen: list[Traced] = []
    talk = Driver(trace=seen.append)
    frame = bytes.fromhex("0009 0000 0005 01 03 02 0007")
    talk.come(frame)
    assert [(each.direction, each.adu) for each in seen] == [("received", frame)]


def ids(talk: Driver) -> list[int]:
    return [int.from_bytes(adu[:2], "big") for adu in talk.sent]


def test_ids_count_up_and_begin_anew() -> None:
    talk = Driver()
    talk.matching._last = 0xFFFD
    for address in range(4):
        exchange(talk, address)
    assert ids(talk) == [0xFFFE, 0xFFFF, 0, 1]


def test_an_id_in_flight_or_owed_is_skipped() -> None:
    talk = Driver(timeout=1.0, retries=0)
    talk.ask(1, go_on=True)
    talk.wait(1.0)
    talk.ask(2)
    talk.matching._last = 0
    talk.ask(3)
    assert ids(talk) == [1, 2, 3]
