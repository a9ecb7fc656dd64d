"""
Tables, types and orders are taken as vendors and other tools write them, and are then known by
the names of this package.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Context, Device, Mapping, Point, Server
from libmodbus_py.maps.plan import Plan, Read
from libmodbus_py.protocol.values import value_type
from tests.support.cases import each_case


@each_case(
    ("word", "table"),
    [
        *((word, "holding_registers") for word in ("hr", "HR", "H", "holding", "4x", "4xxxx")),
        *((word, "holding_registers") for word in ("holding register", "Holding-Registers")),
        *((word, "input_registers") for word in ("ir", "input", "3x", "Input Registers")),
        *((word, "coils") for word in ("co", "coil", "0x", "COILS", "do")),
        *((word, "discrete_inputs") for word in ("di", "1x", "discrete", "input status")),
    ],
)
def test_tables(word: Any, table: str) -> None:
    assert Read(word, 7).table == table
    assert Point("p", word, 7).table == table
    assert Plan([(word, 7)]).requests == Plan([(table, 7)]).requests


@each_case(
    ("word", "name"),
    [
        *((word, "float32") for word in ("FLOAT", "float", "real", "IEEE754", "Float32")),
        *((word, "uint16") for word in ("WORD", "u16", "UINT", "unsigned int16")),
        *((word, "int32") for word in ("DINT", "s32", "INT32")),
        *((word, "string:8") for word in ("STRING(8)", "char 8", "ascii:8", "string:8")),
    ],
)
def test_types(word: Any, name: str) -> None:
    assert value_type(word).name == name
    assert Read("holding_registers", 0, 1, word).type == name
    assert Point("p", "holding_registers", 0, type=word).type == name


@each_case(
    ("word", "order"),
    [
        *((word, "ABCD") for word in ("big endian", "big-endian", "Big_Endian", "BE", "abcd")),
        *((word, "DCBA") for word in ("little endian", "le")),
        *((word, "CDAB") for word in ("word swap", "word-swapped")),
        ("byte swapped", "BADC"),
    ],
)
def test_orders(word: Any, order: str) -> None:
    assert value_type("float32", order=word).order == order
    assert Point("p", "holding_registers", 0, type="float32", order=word).order == order


@each_case(
    ("make", "message"),
    [
        (lambda: Read("holdin" + "g_register_s", 0), "did you mean holding_registers"),  # type: ignore[arg-type]
        (lambda: value_type("flot32"), "did you mean float32"),
        (lambda: value_type("bool"), "type must be one of"),
        (lambda: value_type("float32", order="middle endian"), "order must be one of"),
        (lambda: Plan([("coils", 0)], forbidden=[("coilz", range(3))]), "did you mean coils"),  # type: ignore[list-item]
    ],
)
def test_words_that_nobody_uses(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_clients_take_them() -> None:
    mapping = Mapping(holding_registers=8, input_registers=8)
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        client: Any = Context.from_url(running.urls[0])
        with client:
            client.write_values("hr", 2, [1.5], "FLOAT", order="word swapped")
            assert mapping.holding_registers[2:4] == [0, 0x3FC0]
            assert client.read_value("4x", 2, "real", order="word swap") == 1.5
            assert client.read_values("ir", 0, "u16", 2) == [0, 0]
            with pytest.raises(ValueError, match="table must be one of holding_registers"):
                client.read_value("co", 0, "u16")
