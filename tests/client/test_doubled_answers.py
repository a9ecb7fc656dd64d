"""Answers that come twice on lines without transaction ids: no later value is the one before."""

import random
from typing import Any

import pytest

from libmodbus_py import InvalidResponse, pdu
from libmodbus_py.client.history import REMEMBERED, Pair
from tests.support.clients import World, read
from tests.support.driver import Driver, kinds, rtu, small_memory, value
from tests.support.peers import Write, answer
from tests.support.replies import exchange, time_out

LINE = "rtu:///dev/nowhere?silence=0"


def failures(client: Any, count: int) -> int:
    """Read registers, and return how many reads failed: no read may give a wrong value."""
    count_ = 0
    for address in range(1, count):
        try:
            assert read(client, address) == address
        except InvalidResponse:
            count_ += 1
    return count_


@pytest.mark.parametrize("scheme", ["rtu+tcp", "rtu+udp", "ascii+tcp", "rtu", "ascii"])
def test_no_value_is_that_of_another_request(world: World, scheme: str) -> None:
    chance, doubled = random.Random(1), 0

    def some_twice(request: bytes, write: Write) -> None:
        nonlocal doubled
        adu, after = answer(request, scheme), chance.uniform(0.004, 0.006)
        write(adu, after=after)
        if chance.random() < 0.01:
            doubled += 1
            write(adu, after=after + chance.uniform(0, 0.02))

    with world.client_of(scheme, some_twice, timeout=1) as context:
        count = failures(context, 1500)
    assert doubled > 5
    assert count <= doubled


@pytest.mark.parametrize("scheme", ["rtu+tcp", "ascii+tcp", "rtu"])
def test_a_copy_right_behind_each_answer_is_never_the_next_value(world: World, scheme: str) -> None:
    """The copy is equal, or comes while the next answer is held; then that request fails."""

    def twice(request: bytes, write: Write) -> None:
        write(answer(request, scheme), after=0.01)
        write(answer(request, scheme), after=0.011)

    with world.client_of(scheme, twice, timeout=1) as client:
        assert failures(client, 20) < 10


def asked(driver: Driver, address: int, *answers: tuple[float, bytes]) -> object:
    """Return the outcome of a read with these answers, each after so many seconds."""
    driver.wait(0.05)
    batch, start = driver.ask(address), driver.now
    for delay, data in answers:
        driver.wait_until(start + delay)
        driver.come(data)
    driver.wait_until(start + 0.2)
    return batch.outcomes[0]


def warm() -> Driver:
    """Return a driver whose unit answers after 10 ms."""
    driver = Driver(LINE, timeout=1)
    for number in range(1, 20):
        assert asked(driver, number, (0.01, value(number))) == [number]
    return driver


def test_equal_values_of_several_registers_are_accepted_after_the_first_time() -> None:
    """Each value is held the first time only."""
    driver = warm()
    for addresses in ((50, 51, 52), (50, 51, 52)):
        for address in addresses:
            assert asked(driver, address, (0.01, value(0))) == [0]
    exchange(driver, 50, 0, after=0.01)


def test_an_answer_held_after_an_echo_is_not_taken_for_damage() -> None:
    """The echo of a write is not a frame of an answer, but it begins as its answer does."""
    write = pdu.WriteRegisters(1, [1, 2])
    driver = Driver(LINE, timeout=1)
    for after in (0.01, 0.001):
        batch, start = driver.ask(write), driver.now
        driver.wait_until(start + after)
        driver.come(driver.sent[-1] + rtu("01 10 0001 0002"))
        driver.wait_until(start + 0.1)
        assert batch.outcomes == [None]


def test_answers_of_a_unit_that_became_faster_are_held_once() -> None:
    driver = warm()
    for number in (20, 21, 22):
        batch = driver.ask(number)
        driver.wait(0.005)
        driver.come(value(number))
        assert batch.is_done is (number > 20)
        driver.wait(0.05)
        assert batch.outcomes == [[number]]


def test_answers_of_varying_times_are_accepted_at_once() -> None:
    """As on a network, where the time of one says little of the next."""
    driver, chance, count = Driver(LINE, timeout=1), random.Random(1), 0
    for number in range(1, 2000):
        batch = driver.ask(number)
        driver.wait(0.002 + chance.expovariate(200))
        driver.come(value(number))
        count += not batch.is_done
        driver.wait(0.1)
        assert batch.outcomes == [[number]]
    assert count < 5


def test_polls_of_values_that_flip_take_no_longer_than_others() -> None:
    chance, seconds = random.Random(1), {}
    for name, most in (("different", None), ("constant", 0), ("flip", 1), ("few", 15)):
        driver = Driver(LINE, timeout=1)
        for number in range(3000):
            batch = driver.ask(number % 10)
            driver.wait(chance.uniform(0.004, 0.006))
            driver.come(value(number if most is None else chance.randint(0, most)))
            while not batch.is_done:
                driver.wait(0.001)
        seconds[name] = driver.now
    assert max(seconds.values()) < 1.02 * min(seconds.values())


@pytest.mark.parametrize("pause", [0.02, 0.5])
def test_values_are_right_again_after_a_pause(pause: float) -> None:
    """Longer than a response takes, which is 10 ms."""
    driver = warm()
    time_out(driver, 100)
    present = driver.ask(101)
    driver.wait(0.9)  # the line must be silent
    driver.wait(0.01)
    driver.come(value(100))
    assert not present.is_done
    driver.wait(0.01)
    driver.come(value(101))
    assert kinds(present) == [InvalidResponse]
    for address in range(102, 110):
        driver.wait(pause)
        count = len(driver.sent) + 1
        batch = driver.ask(address)
        driver.wait_for(count)  # the unit must be silent
        driver.wait(0.01)
        driver.come(value(address))
        driver.wait(0.1)
        assert batch.outcomes == [[address]]


def test_values_that_always_change_take_no_memory() -> None:
    """Values, requests and lengths."""
    pair = Pair(0.0)
    pair.is_repeating = True

    def note(count: int) -> None:
        pair.note_time(count % 254, 0.1, is_sure=True)
        for request in (0, count):
            pair.note_answer(b"\x03" + request.to_bytes(4, "big"), count.to_bytes(4, "big"))

    for count in range(2 * REMEMBERED):
        note(count)
    with small_memory():
        for count in range(2 * REMEMBERED, 5 * REMEMBERED):
            note(count)
    assert pair.slowest == 0.1
