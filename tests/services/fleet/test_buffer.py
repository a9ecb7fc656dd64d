"""
Readings that wait for an output: whole polls, in their order, and the newest ones if there are
too many.
"""

from collections.abc import Sequence

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.readings import Buffer
from tests.services.fleet.fleets import in_simulated_time


def poll(time: float, count: int = 1, device: str = "meter") -> list[Reading]:
    return [Reading(time, device, f"p{at}", at, "", "good") for at in range(count)]


def told(readings: Sequence[Reading]) -> list[tuple[float, str]]:
    return [(each.time, each.name) for each in readings]


@in_simulated_time
async def test_of_what_is_put_back_the_newest_have_room() -> None:
    buffer = Buffer(3)
    buffer.put_readings(poll(1.0, 3))
    first = await buffer.take_readings(3)
    buffer.put_readings(poll(2.0, 3))
    buffer.put_back(first)
    assert (len(buffer), buffer.dropped) == (3, 3)
    assert told(await buffer.take_readings(2)) == told(poll(2.0, 2))
    buffer.put_back(first)
    assert buffer.dropped == 4
    assert told(await buffer.take_readings(9)) == [(1.0, "p1"), (1.0, "p2"), (2.0, "p2")]


@in_simulated_time
async def test_a_closed_buffer_takes_nothing_and_gives_what_it_has() -> None:
    buffer = Buffer()
    buffer.put_readings(poll(1.0, 2))
    assert not buffer.is_over
    buffer.close_buffer()
    assert not buffer.is_over
    buffer.put_readings(poll(2.0))
    assert (len(buffer), buffer.dropped) == (2, 0)
    assert told(await buffer.take_readings(9)) == told(poll(1.0, 2))
    assert buffer.is_over
    assert await buffer.take_readings(9) == []


def test_a_buffer_has_a_size_that_is_promised() -> None:
    buffer = Buffer()
    buffer.put_readings(poll(1.0) * 100_001)
    assert (len(buffer), buffer.dropped) == (100_000, 1)
    assert len(Buffer(1)) == len(Buffer(10_000_000)) == 0
    for most in (0, 10_000_001):
        with pytest.raises(ValueError, match=r"buffer must be in 1\.\.10000000"):
            Buffer(most)
