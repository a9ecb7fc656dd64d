"""
Values that move by themselves.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from libmodbus_py import IllegalDataAddress, pdu, values
from libmodbus_py.tools.simulator.behaviour import Counter, RandomWalk
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import Clock, answer, inputs, numbers, unit


@each_case(
    ("behaviour", "expected"),
    [
        ("counter = {}", [0, 0, 1, 1, 2, 2]),
        ("counter = { interval = 0.5 }", [0, 1, 2, 3, 4, 5]),
        ("counter = { step = 3, interval = 0.5, wrap = 7 }", [0, 3, 6, 2, 5, 1]),
        ("counter = { start = 5, interval = 0.5, wrap = 7 }", [5, 6, 5, 6, 5, 6]),
        ("counter = { start = 65534, interval = 0.5 }", [65534, 65535, 65534, 65535, 65534, 65535]),
        ("counter = { start = 2, step = -1, interval = 0.5 }", [2, 1, 0, 2, 1, 0]),
        ("counter = { start = 9, step = -2, interval = 0.5, wrap = 4 }", [9, 7, 5, 8, 6, 9]),
        ('type = "int16"\ncounter = { start = -1, interval = 0.5 }', [0xFFFF, 0, 1, 2, 3, 4]),
        ("counter = { step = 0.5, interval = 0.5 }", [0, 0, 1, 2, 2, 2]),
        ("sine = { low = 100, high = 200, period = 2 }", [150, 200, 150, 100, 150, 200]),
    ],
)
def test_values_at_each_half_second(behaviour: str, expected: list[int]) -> None:
    clock = Clock()
    device = unit(f"[[unit.input_registers]]\naddress = 5\n{behaviour}", clock)
    found = []
    for _ in expected:
        found += inputs(device, 5)
        clock.now += 0.5
    assert found == expected


def test_only_what_is_read_is_computed_and_all_of_it() -> None:
    clock = Clock()
    device = unit(
        """
        [[unit.input_registers]]
        address = 10
        count = 4
        type = "uint32"
        counter = {}
        [[unit.input_registers]]
        address = 20
        value = 3
        [[unit.input_registers]]
        address = 18
        count = 2
        counter = {}
    """,
        clock,
    )
    clock.now += 5
    table = device.mapping.input_registers
    assert inputs(device, 13, 2) == [5, 0]
    assert table[10:18] == [0, 0, 0, 5, 0, 5, 0, 0]
    assert table[18:21] == [0, 0, 3]
    assert inputs(device, 17, 3) == [5, 5, 5]
    assert inputs(device, 10, 11) == [0, 5, 0, 5, 0, 5, 0, 5, 5, 5, 3]


@pytest.mark.parametrize("kind", ["float16", "float32", "float64"])
def test_floats_move_in_fractions(kind: str) -> None:
    clock = Clock()
    device = unit(
        f'[[unit.input_registers]]\naddress = 0\ntype = "{kind}"\ncounter = {{ step = 0.25 }}',
        clock,
    )
    clock.now += 3
    count = values.value_type(kind).registers
    assert values.value_type(kind).decode(inputs(device, 0, count)) == 0.75


def test_a_coil_blinks_and_a_bit_is_a_number() -> None:
    clock = Clock()
    device = unit(
        """
        [[unit.coils]]
        address = 0
        counter = { interval = 1 }
        [[unit.coils]]
        address = 1
        copy = { table = "input_registers", address = 0 }
        [[unit.input_registers]]
        address = 0
        counter = { interval = 3, wrap = 3 }
        [[unit.input_registers]]
        address = 1
        copy = { table = "coils", address = 0, scale = 50 }
    """,
        clock,
    )
    found = []
    for _ in range(8):
        found.append((*answer(device, pdu.ReadCoils(0, 2)), *inputs(device, 1)))
        clock.now += 1
    assert found == [
        (False, False, 0),
        (True, False, 50),
        (False, False, 0),
        (True, True, 50),
        (False, True, 0),
        (True, True, 50),
        (False, True, 0),
        (True, True, 50),
    ]


def test_what_moves_cannot_be_written() -> None:
    device = unit("[[unit.holding_registers]]\naddress = 0\ncounter = {}")
    with pytest.raises(IllegalDataAddress):
        answer(device, pdu.WriteRegister(0, 1))


LIMITS = {name: kind.limits for name, kind in values.TYPES.items() if kind.limits is not None}


@given(
    kind=st.sampled_from(sorted(LIMITS)),
    start=numbers,
    step=numbers,
    moment=st.floats(0, 1e9),
)
def test_counters_stay_in_their_type(kind: str, start: float, step: float, moment: float) -> None:
    clock = Clock()
    low, high = LIMITS[kind]
    assume(low <= start <= high and step != 0)
    text = f"""
        [[unit.input_registers]]
        address = 0
        type = "{kind}"
        counter = {{ start = {start!r}, step = {step!r} }}
    """
    device = unit(text, clock)
    first = values.value_type(kind).decode(inputs(device, 0, values.value_type(kind).registers))
    assert math.isclose(first, start, rel_tol=1e-3, abs_tol=0.5)
    clock.now += moment
    value = values.value_type(kind).decode(inputs(device, 0, values.value_type(kind).registers))
    assert low <= value <= high


def test_behaviours_check_themselves() -> None:
    assert Counter() == Counter(1, 1.0, 0, None)
    with pytest.raises(ValueError, match="step must not be 0"):
        Counter(step=0)
    with pytest.raises(ValueError, match="high must be above low"):
        RandomWalk(5, 5, 1)
