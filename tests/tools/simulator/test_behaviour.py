"""Values that move by themselves."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from libmodbus_py import ServerDeviceFailure, pdu, values
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import Clock, answer, holding, inputs, numbers, unit


@each_case(
    ("behaviour", "values"),
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
        # What moves is scaled.
        ("scale = 0.1\nsine = { low = 22, high = 24, period = 2 }", [230, 240, 230, 220, 230, 240]),
        ("scale = 0.5\ncounter = { start = 1.5, step = 0.5, interval = 1 }", [3, 3, 4, 4, 5, 5]),
        ("scale = 0.1\ncounter = { start = 6553.5, step = 0.1, interval = 0.5 }", [65535] * 6),
    ],
)
def test_values_move_each_half_second(behaviour: str, values: list[int]) -> None:
    clock = Clock()
    device = unit(f"[[unit.input_registers]]\naddress = 5\n{behaviour}", clock)
    cells = []
    for _ in values:
        cells += inputs(device, 5)
        clock.now += 0.5
    assert cells == values


def test_only_and_all_requested_values_are_computed() -> None:
    clock = Clock()
    device = unit(
        """
        input_registers = [
            { address = 10, count = 4, type = "uint32", counter = {} },
            { address = 20, value = 3 },
            { address = 18, count = 2, counter = {} },
        ]
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


def test_a_coil_blinks_and_a_bit_is_a_number_that_moves() -> None:
    clock = Clock()
    device = unit(
        """
        coils = [
            { address = 0, counter = { interval = 1 } },
            { address = 1, copy = { table = "input_registers", address = 0 } },
        ]
        input_registers = [
            { address = 0, counter = { interval = 3, wrap = 3 } },
            { address = 1, copy = { table = "coils", address = 0, scale = 50 } },
        ]
    """,
        clock,
    )
    texts = []
    for _ in range(8):
        texts.append((*answer(device, pdu.ReadCoils(0, 2)), *inputs(device, 1)))
        clock.now += 1
    pattern = ["000", "101", "000", "111", "010", "111", "010", "111"]
    assert texts == [(a == "1", b == "1", 50 * (c == "1")) for a, b, c in pattern]


LIMITS = {name: kind.limits for name, kind in values.TYPES.items() if kind.limits is not None}


@given(kind=st.sampled_from(sorted(LIMITS)), start=numbers, step=numbers, moment=st.floats(0, 1e9))
def test_counters_wrap_in_their_range(kind: str, start: float, step: float, moment: float) -> None:
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
    type_ = values.value_type(kind)
    read = lambda: type_.decode(inputs(device, 0, type_.registers))  # noqa: E731
    assert math.isclose(read(), start, rel_tol=1e-3, abs_tol=0.5)
    clock.now += moment
    value = read()
    assert low <= value <= high


def test_consecutive_copies_continue_the_step_of_the_first() -> None:
    """In the rhythm of the first; a longer value behind it is not hit in its middle."""
    device = unit("""
        holding_registers = [{ address = 0, count = 6, copy = { table = "input_registers", address = 10 } }]
        input_registers = [
            { address = 10, type = "uint32", values = [1, 70000] },
            { address = 14, values = [3, 99, 4, 99] },
            { address = 18, type = "uint32", values = [5, 6] },
        ]
    """)  # noqa: E501
    assert holding(device, 0, 6) == [1, 65535, 3, 4, 5, 6]
    assert holding(device, 3, 2) == [4, 5]


COPIES = """
    [[unit.holding_registers]]
    address = 0
    type = "{source}"
    count = 2
    value = {value}
    [[unit.input_registers]]
    address = 7
    type = "{target}"
    count = 2
    copy = {{ table = "holding_registers", address = 0, scale = {scale} }}
"""


@each_case(
    ("source", "value", "target", "scale", "copy"),
    [
        ("uint16", 555, "uint16", 1, 555),
        ("float32", 21.56, "int16", 10, 216),
        ("float32", 21.5, "float64", -2, -43.0),
        ("int16", -5, "uint16", 1, 0),
        ("uint32", 70000, "uint16", 1, 65535),
        ("uint16", 70, "bcd16", 1000, 9999),
        ("float64", 1e300, "float32", 1, values.value_type("float32").decode([0x7F7F, 0xFFFF])),
        ("float64", 1e300, "float16", -1, -65504.0),
        ("float64", "nan", "int16", 1, 0),
        ("float64", "inf", "int16", -1, -32768),
        ("uint64", (1 << 64) - 1, "uint64", 1, (1 << 64) - 1),
        ("string:4", '"abc"', "string:4", 1, "abc"),
        ("bits16", [1] + [0] * 15, "bits16", 1, [True] + [False] * 15),
    ],
)
def test_copies_are_scaled(source: str, value: object, target: str, scale: float, copy: object):
    device = unit(COPIES.format(source=source, value=value, target=target, scale=scale))
    count = 2 * values.value_type(target).registers
    assert values.value_type(target).decode_many(inputs(device, 7, count)) == [copy, copy]


def test_a_copy_changes_when_clients_write_its_source() -> None:
    device = unit(COPIES.format(source="uint16", value=0, target="uint16", scale=2))
    answer(device, pdu.WriteRegisters(0, (5, 6)))
    assert inputs(device, 7, 2) == [10, 12]
    assert inputs(device, 8) == [12]


def test_copies_of_scaled_values_are_scaled() -> None:
    device = unit("""
        input_registers = [
            { address = 0, scale = 0.1, value = 230 },
            { address = 3, scale = 0.01, copy = { table = "input_registers", address = 0, scale = 0.5 } },
        ]
    """)  # noqa: E501
    assert inputs(device, 3) == [11500]


def test_a_copy_of_an_invalid_value_is_exception_4() -> None:
    device = unit(COPIES.format(source="bcd16", value=1, target="uint16", scale=1))
    answer(device, pdu.WriteRegister(0, 0xABCD))
    with pytest.raises(ServerDeviceFailure):
        inputs(device, 7)
    assert inputs(device, 8) == [1]


def test_a_random_walk_with_a_seed_does_not_depend_on_the_times_of_reads() -> None:
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
def test_no_move_of_a_random_walk_is_longer_than_its_step(step: float, start: int, seed: int):
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


@given(low=numbers, span=st.floats(1, 1e5), moments=st.lists(st.floats(0, 100), max_size=20))
def test_waves_and_walks_stay_between_their_limits(low: float, span: float, moments: list[float]):
    clock = Clock()
    high = low + span
    limits = f"low = {low!r}, high = {high!r}"
    device = unit(
        f"""
        input_registers = [
            {{ address = 0, type = "float64", sine = {{ {limits}, period = 7 }} }},
            {{ address = 4, type = "float64", random_walk = {{ {limits}, step = {high - low!r} }} }}
        ]
    """,
        clock,
    )
    for moment in moments:
        clock.now += moment
        for value in values.value_type("float64").decode_many(inputs(device, 0, 8)):
            assert low - span * 1e-9 <= value <= high + span * 1e-9
