"""
Scaled points: bounds hold for what is written, after rounding, and thirds are exact.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Point, load_map
from tests.support.cases import each_case


def point(**keys: Any) -> Point:
    return Point("x", "holding_registers", 0, **keys)


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
def test_what_would_be_written_outside_the_bounds_is_refused(
    keys: dict[str, Any], value: float
) -> None:
    with pytest.raises(ValueError, match=r"x: value must be .*, not "):
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
def test_the_bounds_themselves_are_taken(keys: dict[str, Any], value: float, raw: int) -> None:
    assert point(**keys).encode(value) == [raw]


def test_bounds_of_floats_are_those_of_what_is_given() -> None:
    held = point(type="float32", scale=10, maximum=0.1)
    assert held.decode(held.encode(0.1)) == pytest.approx(0.1)


@each_case("divisor", [3, 6, 7, 9, 11, 12, 36, 60, 99, 360, 3600, 86_400, 999_983])
def test_whole_quotients_are_whole(divisor: int) -> None:
    held = point(scale=1 / divisor, type="uint32")
    for number in (1, 2, 3, 7, 1000):
        cells = divmod(number * divisor, 65536)
        assert held.decode(list(cells)) == number
        assert held.encode(number) == list(cells)


def test_a_divisor_in_a_file_is_exact(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("name,table,address,divisor\nx,holding_registers,0,3\n")
    held = load_map(path)["x"]
    assert [held.decode([raw]) for raw in (3, 6, 9, 300)] == [1, 2, 3, 100]
    path.write_text("name,table,address,scale\nx,holding_registers,0,1/3\n")
    assert load_map(path)["x"].decode([3]) == 1


@each_case("scale", [0.1, 0.01, 0.001, 0.5, 0.125, 1e-30, 2.5, 0.333, 1e30, 0.0078125])
def test_decimals_are_taken_as_they_are_written(scale: float) -> None:
    from fractions import Fraction

    assert Fraction(str(point(scale=scale).decode([1]))) == Fraction(str(scale))


# --- too large -----------------------------------------------------------------------------------


@pytest.mark.parametrize("raw", [1e300, -1e300])
@pytest.mark.parametrize(
    ("keys", "source"), [({"scale": 1e30}, None), ({"scale_from": "exponent"}, 30)]
)
def test_too_large_a_value_is_infinite(raw, keys, source):
    point = Point("energy", "holding_registers", 0, type="float64", **keys)
    cells = struct.unpack(">4H", struct.pack(">d", raw))
    assert point.decode(cells, source=source) == raw * 1e300
