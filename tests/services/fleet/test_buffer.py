"""
Readings that wait for an output: whole polls, in their order, and the newest ones if there are
too many.
"""

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.readings import Buffer


def poll(time: float, count: int = 1, device: str = "meter") -> list[Reading]:
    return [Reading(time, device, f"p{at}", at, "", "good") for at in range(count)]


def test_a_buffer_keeps_up_to_the_given_number_of_readings() -> None:
    buffer = Buffer()
    buffer.put_readings(poll(1.0) * 100_001)
    assert (len(buffer), buffer.dropped) == (100_000, 1)
    assert len(Buffer(1)) == len(Buffer(10_000_000)) == 0
    for most in (0, 10_000_001):
        with pytest.raises(ValueError, match=r"buffer must be in 1\.\.10000000"):
            Buffer(most)
