"""
Values that walk at random: the same with a seed, within their limits, and quick.
"""

from __future__ import annotations

import math
import resource
import time
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import pdu, values
from tests.tools.simulator.simulated_units import Clock, answer, inputs, numbers, unit


def test_a_random_walk_with_a_seed_is_the_same_after_every_start() -> None:
    text = """
        [[unit.input_registers]]
        address = 0
        count = 3
        random_walk = { low = 0, high = 1000, step = 50, interval = 0.1, seed = 1 }
    """
    walks = []
    for _ in range(2):
        clock = Clock()
        device = unit(text, clock)
        walk = []
        for _ in range(50):
            walk.append(inputs(device, 0, 3))
            assert inputs(device, 0, 3) == walk[-1]
            clock.now += 0.1
        walks.append(walk)
    assert walks[0] == walks[1]
    assert walks[0][0] == [500, 500, 500]
    columns = list(zip(*walks[0], strict=True))
    assert len(set(columns)) == 3
    assert all(len(set(column)) > 20 for column in columns)


def test_a_random_walk_with_a_seed_is_the_same_whenever_it_is_read() -> None:
    text = """
        [[unit.input_registers]]
        address = 0
        random_walk = { low = 0, high = 1000, step = 50, interval = 0.001, seed = 1 }
    """
    clocks = [Clock(), Clock()]
    often, seldom = (unit(text, clock) for clock in clocks)
    for _ in range(3):
        for _ in range(500):
            clocks[0].now += 0.025
            inputs(often, 0)
        clocks[1].now = clocks[0].now
        assert inputs(often, 0) == inputs(seldom, 0)


@given(step=st.floats(0.01, 500), start=st.integers(0, 10**12), seed=st.integers(0, 1 << 63))
def test_no_move_of_a_random_walk_is_longer_than_its_step(
    step: float, start: int, seed: int
) -> None:
    clock = Clock()
    behaviour = f"random_walk = {{ low = -250, high = 250, step = {step!r}, seed = {seed} }}"
    device = unit(f'[[unit.input_registers]]\naddress = 0\ntype = "float64"\n{behaviour}', clock)
    clock.now += start + 0.5
    before = None
    for _ in range(20):
        (value,) = values.value_type("float64").decode_many(inputs(device, 0, 4))
        assert before is None or abs(value - before) <= step * 1.000001
        before = value
        clock.now += 1


def test_random_walks_get_about() -> None:
    """To both sides of where they begin, each its own way, further in a longer time."""
    clock = Clock()
    text = "random_walk = { low = 0, high = 60000, step = 10, seed = 3 }"
    device = unit(f"[[unit.input_registers]]\naddress = 0\ncount = 100\n{text}", clock)
    spread = {}
    for moves in (16, 256, 4096, 65536):
        clock.now = 1000.0 + moves
        ways = [value - 30000 for value in inputs(device, 0, 100)]
        assert min(ways) < 0 < max(ways)
        assert len(set(ways)) > 20
        spread[moves] = math.sqrt(sum(way * way for way in ways) / 100)
    # Four times as far in 16 times as many moves; a third of that or three times is chance.
    for before, after in pairwise(spread.values()):
        assert 4 / 3 < after / before < 12


def test_2000_random_walks_at_once_do_not_stop_the_server() -> None:
    """Not after an hour in which nobody looked, nor at each later read."""
    clock = Clock()
    walk = "random_walk = { low = 0, high = 1, step = 1, interval = 0.001 }"
    device = unit(f"[[unit.coils]]\naddress = 0\ncount = 65536\n{walk}", clock)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    for at in range(0, 65536 - 2000, 2000):
        clock.now += 3600
        assert len(answer(device, pdu.ReadCoils(at, 2000))) == 2000
    # 32 reads; a move for each millisecond would take one second for each read.
    assert time.process_time() - start < 8
    # A random generator for each would take 2.5 KB.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_a_random_walk_after_a_year_is_quick() -> None:
    clock = Clock()
    device = unit(
        """
        [[unit.input_registers]]
        address = 0
        count = 100
        random_walk = { low = 0, high = 9, step = 1, interval = 0.001 }
    """,
        clock,
    )
    inputs(device, 0, 100)
    clock.now += 365 * 86400
    start = time.process_time()
    assert all(0 <= value <= 9 for value in inputs(device, 0, 100))
    assert time.process_time() - start < 5


def test_a_random_walk_turns_round_at_its_limits() -> None:
    clock = Clock()
    text = "random_walk = { low = 100, high = 110, step = 10 }"
    device = unit(f'[[unit.input_registers]]\naddress = 0\ntype = "float64"\n{text}', clock)
    for _ in range(300):
        clock.now += 1
        assert 100 < values.value_type("float64").decode(inputs(device, 0, 4)) < 110


@given(low=numbers, span=st.floats(1, 1e5), moments=st.lists(st.floats(0, 100), max_size=20))
def test_waves_and_walks_stay_between_their_limits(
    low: float, span: float, moments: list[float]
) -> None:
    clock = Clock()
    high = low + span
    limits = f"low = {low!r}, high = {high!r}"
    device = unit(
        f"""
        [[unit.input_registers]]
        address = 0
        type = "float64"
        sine = {{ {limits}, period = 7 }}
        [[unit.input_registers]]
        address = 4
        type = "float64"
        random_walk = {{ {limits}, step = {high - low!r} }}
    """,
        clock,
    )
    for moment in moments:
        clock.now += moment
        for value in values.value_type("float64").decode_many(inputs(device, 0, 8)):
            assert low - span * 1e-9 <= value <= high + span * 1e-9
