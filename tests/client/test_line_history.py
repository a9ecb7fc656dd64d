"""The history of a line outlives its client; and lines without a history."""

import gc
import os
import random
import threading
from pathlib import Path

import pytest

from libmodbus_py import InvalidResponse, ModbusError, pdu
from libmodbus_py.client.history import REMEMBERED, History, history_of
from libmodbus_py.ports.endpoint import parse
from tests.support.cases import each_case
from tests.support.driver import LINE, Driver, kinds, value
from tests.support.replies import exchange, time_out


def closed(driver: Driver) -> Driver:
    driver.connection.closed(driver.now)
    return driver


def asked_twice(url: str = LINE) -> Driver:
    """Return a client that was closed while unit 1 owes an answer; its answers take 10 ms."""
    driver = Driver(url, timeout=1)
    exchange(driver, 1, after=0.01)
    time_out(driver, 2)
    return closed(driver)


def test_a_late_answer_is_no_value_of_the_next_client() -> None:
    former = asked_twice()
    driver = Driver(LINE, after=former, is_new=True, timeout=1)
    batch = driver.ask(3)
    driver.wait_for(1)
    assert driver.times == pytest.approx([former.now + 0.02])
    driver.wait(0.01)
    driver.come(value(2))
    driver.wait(0.01)
    driver.come(value(3))
    assert kinds(batch) == [InvalidResponse]


def test_a_request_in_flight_when_its_client_is_closed_leaves_doubt() -> None:
    former = Driver(LINE, timeout=1)
    exchange(former, 1, after=0.01)
    former.ask(2)
    driver = Driver(LINE, after=closed(former), timeout=1)
    driver.ask(3)
    assert driver.sent == []


def test_the_first_answer_after_opening_a_known_line_is_held_for_twice_the_slowest() -> None:
    former = Driver(LINE, timeout=1)
    exchange(former, 1, after=0.01)
    driver = Driver(LINE, after=closed(former), is_new=True, timeout=1)
    batch = driver.ask(2)
    driver.wait(0.01)
    driver.come(value(2))
    driver.wait(0.019)
    assert not batch.is_done
    driver.wait(0.002)
    assert batch.outcomes == [[2]]
    exchange(driver, 3, after=0.01)


@each_case("url", [LINE, "rtu+tcp://192.0.2.1"])
def test_new_clients_for_each_poll_take_no_value_of_another_request(url: str) -> None:
    """Of 2 000 answers each 40th is late by 1 to 50 ms, and comes to the next client, too."""
    chance, former, count, late = random.Random(1), None, 0, []
    for _ in range(400):
        former = driver = Driver(url, after=former, is_new=True, timeout=0.1)
        for address in range(1, 6):
            end = len(driver.sent) + 1
            batch = driver.ask(address)
            while not batch.is_done:
                if len(driver.sent) == end:
                    end, count = end + 1, count + 1
                    after = 0.1 + chance.uniform(0.001, 0.05) if count % 40 == 17 else 0.008
                    late.append((driver.times[-1] + after, value(7 * address)))
                    late.sort()
                if late and late[0][0] <= driver.matching.alarm:
                    driver.wait_until(max(late[0][0], driver.now))
                    driver.come(late.pop(0)[1])
                else:
                    driver.wait_until(driver.matching.alarm)
            assert isinstance(batch.outcomes[0], ModbusError) or batch.outcomes == [[7 * address]]
        closed(driver)
    assert count > 1900


def test_the_first_answer_is_held_until_the_line_has_been_open_for_60_ms() -> None:
    driver = Driver(LINE, is_new=True, timeout=1)
    batch = driver.ask(1)
    driver.wait(0.005)
    driver.come(value(1))
    driver.wait(0.054)
    assert not batch.is_done
    driver.wait(0.002)
    assert batch.outcomes == [[1]]
    exchange(driver, 2, after=0.005)


def test_an_answer_that_takes_longer_than_20_ms_is_held_for_twice_its_time() -> None:
    driver = Driver(LINE, is_new=True, timeout=1)
    batch = driver.ask(1)
    driver.wait(0.1)
    driver.come(value(1))
    driver.wait(0.19)
    assert not batch.is_done
    driver.wait(0.02)
    assert batch.outcomes == [[1]]


def test_after_one_silent_timeout_a_new_line_has_no_answer_under_way() -> None:
    driver = Driver(LINE, is_new=True, timeout=1)
    driver.wait(1)
    exchange(driver, 1, after=0.005)


@each_case("late", [0.001, 0.004, 0.006, 0.02, 0.05])
@each_case("is_polled", [True, False])
def test_an_answer_to_another_program_is_not_a_value(late: float, is_polled: bool) -> None:
    """The unit answers each request after 5 ms, and one of another program in between."""
    driver = Driver(LINE, is_new=True, timeout=1)
    start, failures = driver.now, 0
    for address in range(1, 30):
        count = len(driver.sent) + 1
        batch = driver.ask(address)
        driver.wait_for(count)
        due = driver.times[-1] + 0.005
        for at, frame in sorted([(start + late, value(99)), (due, value(address))]):
            if at >= driver.now:
                driver.wait_until(at)
                driver.come(frame)
        driver.wait(0.1 if is_polled else 0)
        while not batch.is_done:
            driver.wait(0.001)
        failures += batch.outcomes != [[address]]
        assert kinds(batch) in ([[address]], [InvalidResponse])
    assert failures <= 1


def test_a_line_is_known_by_its_device_or_converter(tmp_path: Path) -> None:
    link = tmp_path / "line"
    link.symlink_to("/dev/null")
    for one, other in (
        (f"rtu://{link}", "rtu:///dev/null?baudrate=9600"),
        ("rtu:///dev/ttyX", "ascii:///dev/../dev/ttyX"),
        ("rtu+tcp://Host:502", "ascii+tcp://host?unit=7"),
    ):
        assert history_of(parse(one)) is history_of(parse(other))
    for one, other in (
        ("rtu+tcp://host", "rtu+tcp://host:503"),
        ("rtu+tcp://host", "rtu+udp://host"),
        ("rtu:///dev/ttyX", "rtu:///dev/ttyY"),
    ):
        assert history_of(parse(one)) is not history_of(parse(other))


def test_the_oldest_histories_are_dropped_beyond_the_limit() -> None:
    first = history_of(parse("rtu+tcp://host:1"))
    for port in range(1, REMEMBERED + 1):
        history_of(parse(f"rtu+tcp://host:{port}"))
    assert history_of(parse("rtu+tcp://host:1")) is first
    history_of(parse("rtu+tcp://host:9999"))
    assert history_of(parse("rtu+tcp://host:1")) is not first


def test_threads_that_open_a_line_at_once_share_its_history() -> None:
    endpoint, histories = parse("rtu+tcp://host"), []
    gate = threading.Barrier(8)

    def open_it() -> None:
        gate.wait()
        history = history_of(endpoint)
        for function in range(1, 100):
            history.pair(1, function, 0.0)
            history.pairs_of(1)
        histories.append(history)

    threads = [threading.Thread(target=open_it) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(histories) == 8
    assert {id(history) for history in histories} == {id(histories[0])}
    assert len(histories[0].pairs_of(1)) == 99


def test_the_history_keeps_no_request_in_memory() -> None:
    driver = Driver(LINE, timeout=1)
    driver.ask(pdu.ReadHoldingRegisters(1, 1))
    driver.wait(1)
    history: History = driver.matching._history
    assert history.pair(1, 3, 0.0).is_doubted
    del driver
    gc.collect()
    assert history.pair(1, 3, 0.0).owed is None


def test_a_forked_child_has_its_own_histories_of_lines() -> None:
    history = history_of(parse("rtu+tcp://host"))
    child = os.fork()
    if not child:
        history_of(parse("rtu+tcp://host")).pair(1, 3, 0.0).doubt(0.0, 1.0)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert history.units == {}
