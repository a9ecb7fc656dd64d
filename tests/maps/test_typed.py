"""Values as people type them: exact, whatever floats make of them."""

import math
from typing import Any

import pytest

from libmodbus_py import Point
from libmodbus_py.maps.writing import typed_register, typed_value
from tests.support.cases import each_case
from tests.support.golden import Refused

H = "holding_registers"


def point(**keys: Any) -> Point:
    return Point(**{"name": "it", "table": H, "address": 0, **keys})


# The arguments of a point, the typed text, and its cells, computed by hand.
TYPED: list[tuple[dict[str, Any], str, list[Any]]] = [
    ({"table": "coils"}, " on ", [True]),
    ({}, "0x1F", [31]),
    ({"type": "int16"}, " -2", [0xFFFE]),
    ({"type": "string:4"}, " ab ", [0x2061, 0x6220]),
    ({"type": "bits16"}, "1000000000000001", [0x8001]),
    ({"scale": 0.1}, "21.57", [216]),
    ({"scale": 0.1}, " 21.5 ", [215]),
    ({"scale": 10}, "70", [7]),
    ({"scale": 10}, "7e1", [7]),
    ({"type": "uint64", "scale": 1, "offset": 1}, "9007199254740993", [0x20, 0, 0, 0]),
    ({"type": "uint64", "scale": 0.1}, "900719925474099.3", [0x20, 0, 0, 1]),
    ({"type": "uint64", "scale": 0.1}, "1844674407370955161.5", [0xFFFF] * 4),
    ({"type": "float32", "scale": 0.1}, "230.5", [0x4510, 0x1000]),
    ({"type": "float32", "scale": 0.1}, "inf", [0x7F80, 0]),
    ({"scale": 0.1}, "1e-999999999", [0]),
    ({"scale": 0.1, "maximum": 0.3}, "0.29999999999999999", [3]),
    ({"states": {0: "off", 1: "on"}}, "on", [1]),
    ({"states": {0: "off", 1: "on"}}, " 0x10 ", [16]),
    ({"bits": {0: "door", "4..7": "mode"}}, "door=on, mode=5", [0x51]),
    ({"bits": {0: "door", "4..7": "mode"}}, ' {"door": true, "mode": 5}', [0x51]),
    ({"bit": 3}, "on", [8]),
    ({"bit": "4..7"}, "0xF", [0xF0]),
    ({"bit": "4..7", "type": "bits16"}, "15", [0xF0]),
    ({"bit": "4..7", "scale": 0.5}, "2.5", [0x50]),
    ({"byte": "low", "type": "int16"}, "-1", [0xFF]),
    ({"type": "unix32"}, "1970-01-01T01:00:00+01:00", [0, 0]),
]


@each_case(("keys", "text", "cells"), TYPED)
def test_a_typed_text_encodes_to_its_registers(keys, text, cells) -> None:
    point_ = point(**keys)
    assert point_.encode(typed_value(point_, text)) == cells


DOOR = {"bits": {0: "door", "4..7": "mode"}}


def test_a_text_that_is_no_value_is_refused(refused: Refused) -> None:
    def encode(case: tuple[dict[str, Any], str]) -> None:
        point_ = point(**case[0])
        point_.encode(typed_value(point_, case[1]))

    refused("refused_texts.txt", encode)


def test_a_number_that_a_float_holds_is_accepted() -> None:
    point_ = point(scale=0.1)
    assert repr(typed_value(point_, "100.1")) == "100.1"
    assert repr(typed_value(point_, "-7")) == "-7"
    assert math.isinf(typed_value(point_, "-inf"))


@each_case(
    ("text", "register"), [("-1", 0xFFFF), ("-32768", 0x8000), ("65535", 0xFFFF), ("0x7f", 127)]
)
def test_a_register_is_typed_with_or_without_a_sign(text: str, register: int) -> None:
    assert typed_register(text) == register


@each_case("text", ["-32769", "65536"])
def test_more_than_16_bits_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=rf"value must be in -32768\.\.65535, not {text}"):
        typed_register(text)
