"""Which answer is whose where frames carry transaction ids, told in bytes and times."""

import random

import pytest

from libmodbus_py import FrameError, ModbusConnectionError, ModbusTimeoutError, TracedFrame, pdu
from libmodbus_py.client.ids import first_id
from tests.support.driver import Driver, kinds, tcp
from tests.support.replies import exchange


def test_a_request_has_the_header_of_the_specification() -> None:
    driver = Driver()
    driver.ask(0x6B, unit=0x11)
    assert driver.sent == [bytes.fromhex("0001 0000 0006 11 03 006B 0001")]


def test_transaction_ids_of_clients_begin_at_random() -> None:
    """Some gateways send each answer to all their clients, or a late one to the newest."""
    assert len({first_id() for _ in range(20)}) > 15


@pytest.mark.parametrize("seed", range(5))
def test_answers_may_come_in_any_pieces(seed: int) -> None:
    chance = random.Random(seed)
    driver = Driver()
    batch = driver.ask(*range(10), one_by_one=False)
    data = b"".join(tcp(frame) for frame in driver.sent)
    while data:
        size = chance.randrange(1, 20)
        driver.come(data[:size])
        data = data[size:]
    assert batch.outcomes == [[address] for address in range(10)]


@pytest.mark.parametrize("limit", [1, 3, 16, 99])
def test_a_batch_has_as_many_in_flight_as_the_client_may(limit: int) -> None:
    driver = Driver(max_in_flight=limit)
    batch, most = driver.ask(*range(40), one_by_one=limit == 1), min(limit, 40)
    assert len(driver.sent) == most
    driver.come(tcp(driver.sent[most // 2]))
    assert len(driver.sent) == min(most + 1, 40)
    while not batch.is_done:
        driver.come(tcp(driver.sent[-1]), *(tcp(frame) for frame in driver.sent[:-1]))
    assert batch.outcomes == [[address] for address in range(40)]
    others = [driver.ask(address) for address in range(40)]
    assert len(driver.sent) == 40 + most
    assert not any(other.is_done for other in others)


def test_callers_take_turns() -> None:
    driver = Driver(max_in_flight=2)
    driver.ask(*range(10), one_by_one=False)
    driver.ask(100)
    driver.ask(200)
    for at in range(4):
        driver.come(tcp(driver.sent[at]))
    assert [int.from_bytes(frame[8:10], "big") for frame in driver.sent] == [0, 1, 2, 100, 200, 3]


def test_an_answer_with_an_unknown_id_is_dropped_and_shown_at_the_end() -> None:
    driver = Driver(timeout=1)
    batch = driver.ask(1)
    stranger = tcp(driver.sent[0], number=999)
    driver.come(stranger)
    assert not batch.is_done
    driver.wait(1)
    assert kinds(batch) == [ModbusTimeoutError]
    assert "id 999, not 1" in str(batch.outcomes[0])
    assert batch.outcomes[0].received == stranger
    assert driver.statistics.late_answers == 1


@pytest.mark.parametrize("length", [0, 1, 255, 0xFFFF])
def test_an_invalid_length_fails_all_requests_and_ends_the_connection(length: int) -> None:
    driver = Driver()
    batches = [driver.ask(1), driver.ask(2)]
    driver.come(b"\0\1\0\0" + length.to_bytes(2, "big") + b"\1\3")
    assert [kinds(batch) for batch in batches] == [[FrameError]] * 2
    assert batches[0].outcomes[0] is not batches[1].outcomes[0]
    assert batches[1].outcomes[0].asked == "ReadHoldingRegisters(address=2, count=1)"
    waiting = driver.ask(3)
    assert len(driver.sent) == 2
    driver.replace_broken()
    driver.come(tcp(driver.sent[2]))
    assert waiting.outcomes == [[3]]


def test_unrequested_answers_of_64_kib_break_the_connection() -> None:
    driver = Driver()
    frame = bytes.fromhex("7777 0000 00FE 01 03 FA") + bytes(251)
    for _ in range(0x10000 // 260):
        driver.come(frame)
        assert not driver.connection.is_flooded
    driver.come(frame * 2)
    assert driver.connection.is_flooded
    assert isinstance(driver.connection.broken, ModbusConnectionError)
    driver.replace_broken()
    assert not driver.connection.is_flooded
    driver.ask(1)
    assert len(driver.sent) == 1


def test_the_turnaround_delay_follows_a_request_without_an_answer() -> None:
    driver = Driver(turnaround=0.1)
    silent = driver.ask(pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0"))
    other = driver.ask(5)
    driver.wait(0.09)
    assert not silent.is_done
    assert len(driver.sent) == 1
    driver.wait(0.01)
    assert silent.outcomes == [None]
    driver.come(tcp(driver.sent[1]))
    assert other.outcomes == [[5]]
    assert driver.statistics.timeouts == 0
    assert driver.is_at_rest


def test_frames_before_the_first_request_are_traced() -> None:
    frames: list[TracedFrame] = []
    driver = Driver(trace=frames.append)
    frame = bytes.fromhex("0009 0000 0005 01 03 02 0007")
    driver.come(frame)
    assert [(frame.direction, frame.adu) for frame in frames] == [("received", frame)]


def ids(driver: Driver) -> list[int]:
    return [int.from_bytes(adu[:2], "big") for adu in driver.sent]


def test_ids_count_up_and_begin_anew() -> None:
    driver = Driver()
    driver.matching._last = 0xFFFD
    for address in range(4):
        exchange(driver, address)
    assert ids(driver) == [0xFFFE, 0xFFFF, 0, 1]


def test_an_id_in_flight_or_owed_is_skipped() -> None:
    driver = Driver(timeout=1.0, retries=0)
    driver.ask(1, go_on=True)
    driver.wait(1.0)
    driver.ask(2)
    driver.matching._last = 0
    driver.ask(3)
    assert ids(driver) == [1, 2, 3]
