"""Points: what their cells mean, computed by hand or with exact fractions, and what they refuse."""

import math
import re
import struct
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Point, load_map
from tests.support.cases import each_case
from tests.support.golden import Refused

H = "holding_registers"


def point(**keys: Any) -> Point:
    return Point(**{"name": "it", "table": H, "address": 0, **keys})


# The arguments of a point, its cells, and their value.
READ = [
    ({}, [2305], 2305),
    ({"scale": 0.1}, [2305], 230.5),
    ({"scale": 0.01, "type": "int16"}, [0xFFFF], -0.01),
    ({"scale": 0.1, "offset": -40}, [655], 25.5),
    ({"scale": 0.001, "type": "uint32", "order": "CDAB"}, [0x5678, 0x1234], 305419.896),
    ({"scale": 10}, [7], 70),
    ({"scale": 1.0, "offset": 100.0}, [7], 107),
    ({"scale": -0.5}, [3], -1.5),
    ({"scale": 0.1, "count": 3}, [1, 2, 3], [0.1, 0.2, 0.3]),
    ({"type": "float32"}, [0x3E20, 0x0000], 0.15625),
    ({"type": "float32", "scale": 0.1}, [0x4510, 0x1000], 230.5),
    ({"type": "float32", "scale": 0.1}, [0x7F80, 0x0000], math.inf),
    ({"type": "float32", "scale": -0.1}, [0x7F80, 0x0000], -math.inf),
    ({"type": "bcd16", "scale": 0.01}, [0x1234], 12.34),
    ({"type": "uint64", "scale": 0.001}, [0, 0x1234, 0x5678, 0x9ABC], 20015998343.868),
    ({"type": "string:4"}, [0x4162, 0x6300], "Abc"),
    ({"type": "string:2", "count": 2}, [0x4142, 0x4344], ["AB", "CD"]),
    ({"type": "bits16"}, [5], [True, False, True] + [False] * 13),
    ({"table": "coils"}, [True], True),
    ({"table": "discrete_inputs", "count": 2}, [True, False], [True, False]),
]


@each_case(("keys", "cells", "value"), READ)
def test_cells_decode_to_values_and_back(keys: dict[str, Any], cells: list[Any], value: Any):
    point_ = point(**keys)
    assert repr(point_.decode(cells)) == repr(value)
    assert len(point_.cells) == len(cells)
    assert point_.encode(value) == cells


def test_nan_is_no_value() -> None:
    point_ = point(type="float32", scale=0.1)
    assert point_.decode([0x7FC0, 0]) is None
    assert point_.judge(point_.encode(math.nan)) == (None, "bad", "Missing")


# A value, and the nearest raw number: of two equally near, the even one.
ROUNDED = [
    (21.5, 0.1, 215),
    (21.57, 0.1, 216),
    (0.15, 0.1, 2),
    (0.25, 0.1, 2),
    (Decimal("0.35"), 0.1, 4),
    (Fraction(1, 3), 0.1, 3),
    (230.10000000000002, 0.1, 2301),
    (24, 10, 2),
    (25, 10, 2),
    (35, 10, 4),
]


@each_case(("value", "scale", "raw"), ROUNDED)
def test_the_nearest_raw_number_is_written(value: Any, scale: float, raw: int) -> None:
    assert point(scale=scale).encode(value) == [raw]


INTEGERS = {"int16": (16, True), "uint16": (16, False), "int32": (32, True), "uint64": (64, False)}


@given(
    st.sampled_from(sorted(INTEGERS)),
    st.decimals(min_value="0.00001", max_value=1000, places=5),
    st.decimals(min_value=-1000, max_value=1000, places=3),
    st.data(),
)
def test_scaled_integers_are_exact_in_both_directions(
    name: str, scale: Decimal, offset: Decimal, data: st.DataObject
) -> None:
    bits, signed = INTEGERS[name]
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    # A float has no more digits than this.
    raw = data.draw(st.integers(max(low, -(10**9)), min(high, 10**9)))
    point_ = point(type=name, scale=float(scale), offset=float(offset))
    cells = list(struct.unpack(f">{bits // 16}H", raw.to_bytes(bits // 8, "big", signed=signed)))
    value = point_.decode(cells)
    exact = raw * Fraction(scale) + Fraction(offset)
    assert value == (exact.numerator / exact.denominator)
    assert point_.encode(value) == cells


@given(
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.sampled_from([0.1, 10, -3.5, 1e-6]),
)
def test_scaled_floats_decode_to_what_was_encoded(raw: float, scale: float) -> None:
    point_ = point(type="float32", scale=scale)
    cells = list(struct.unpack(">2H", struct.pack(">f", raw)))
    back = point_.encode(point_.decode(cells))
    assert struct.unpack(">f", struct.pack(">2H", *back))[0] == pytest.approx(raw, rel=1e-6)


def test_a_point_has_defaults_for_its_table() -> None:
    assert (point().type, point().access) == ("uint16", "read_write")
    assert point(table="input_registers").access == "read"
    assert point(table="coils").type is None
    assert point() == point(type="uint16", access="read_write")
    assert hash(point(scale=0.1)) == hash(point(scale=0.1))
    assert not point(access="write").is_readable
    assert not point(access="read").is_writable


def test_an_invalid_point_is_refused(refused: Refused) -> None:
    refused("wrong_points.txt", lambda keys: point(**keys))


def test_a_value_outside_the_range_of_a_point_is_refused(refused: Refused) -> None:
    refused("unfit_values.txt", lambda case: point(**case[0]).encode(case[1]))


@pytest.mark.parametrize(
    ("keys", "cells", "message"),
    [
        ({}, [1, 2], "it: cells must have 1 items, not 2"),
        ({}, [65536], "it: registers[0] must be in 0..65535, not 65536"),
    ],
)
def test_invalid_addresses_are_refused(keys: dict[str, Any], cells: list[int], message: str):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        point(**keys).decode(cells)


def test_a_unit_of_a_point_has_the_name_units() -> None:
    with pytest.raises(TypeError, match=r"^'unit' must be one of .*; did you mean units"):
        Point("power", "input_registers", 0, unit="W")  # type: ignore[call-arg]


@each_case(
    ("keys", "value"),
    [
        ({"scale": 0.1, "minimum": 0.25}, 0.25),  # 2, which is 0.2
        ({"scale": 0.1, "maximum": 0.36}, 0.36),  # 4
        ({"scale": 10, "minimum": 14}, 14),  # 1, which is 10
        ({"scale": 10, "maximum": 16}, 16),
        ({"scale": -0.5, "type": "int16", "minimum": -0.3}, -0.3),
        ({"scale": 0.1, "minimum": 1, "maximum": 3}, 3.04),  # outside as it was given
    ],
)
def test_values_outside_the_bounds_are_not_written(keys, value) -> None:
    with pytest.raises(ValueError, match=r"it: value must be .*, not "):
        point(**keys).encode(value)


@each_case(
    ("keys", "value", "raw"),
    [
        ({"scale": 0.1, "minimum": 0.3, "maximum": 0.3}, 0.3, 3),
        ({"scale": 0.1, "minimum": 10, "maximum": 30}, 30, 300),
        ({"scale": 0.1, "minimum": 10, "maximum": 30}, 29.99, 300),
        ({"scale": 1 / 3, "minimum": 0, "maximum": 1}, 1, 3),
    ],
)
def test_the_bounds_themselves_are_accepted(keys: dict[str, Any], value: float, raw: int) -> None:
    assert point(**keys).encode(value) == [raw]


def test_bounds_of_floats_accept_the_value_that_was_written_as_the_bound() -> None:
    point_ = point(type="float32", scale=10, maximum=0.1)
    assert point_.decode(point_.encode(0.1)) == pytest.approx(0.1)


@each_case("divisor", [3, 6, 7, 9, 11, 12, 36, 60, 99, 360, 3600, 86_400, 999_983])
def test_integers_divided_by_a_divisor_are_integers_if_the_quotient_is(divisor: int) -> None:
    point_ = point(scale=1 / divisor, type="uint32")
    for number in (1, 2, 3, 7, 1000):
        cells = divmod(number * divisor, 65536)
        assert point_.decode(list(cells)) == number
        assert point_.encode(number) == list(cells)


def test_a_divisor_in_a_file_is_exact(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("name,table,address,divisor\nx,holding_registers,0,3\n")
    point_ = load_map(path)["x"]
    assert [point_.decode([raw]) for raw in (3, 6, 9, 300)] == [1, 2, 3, 100]
    path.write_text("name,table,address,scale\nx,holding_registers,0,1/3\n")
    assert load_map(path)["x"].decode([3]) == 1


@each_case("scale", [0.1, 0.01, 0.001, 0.5, 0.125, 1e-30, 2.5, 0.333, 1e30, 0.0078125])
def test_decimals_are_read_as_they_are_written(scale: float) -> None:
    assert Fraction(str(point(scale=scale).decode([1]))) == Fraction(str(scale))


@each_case("raw", [1e300, -1e300])
@each_case(("keys", "source"), [({"scale": 1e30}, None), ({"scale_from": "exponent"}, 30)])
def test_a_value_that_is_too_large_becomes_infinite(raw: float, keys: dict[str, Any], source: Any):
    cells = struct.unpack(">4H", struct.pack(">d", raw))
    assert point(type="float64", **keys).decode(cells, source=source) == raw * 1e300
