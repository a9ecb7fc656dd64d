"""
Tables, types and orders are taken as vendors and other tools write them, and are then known by
the names of this package.
"""

from typing import Any, get_args

import pytest

from libmodbus_py import Client, Device, Mapping, Point, Server, pdu
from libmodbus_py.maps.items import Read
from libmodbus_py.maps.plan import Plan
from libmodbus_py.protocol.tables import TABLE_SIZE, TABLES, RegisterTable, Table
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
def test_words_for_tables_are_understood(word: Any, table: str) -> None:
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
def test_words_for_types_are_understood(word: Any, name: str) -> None:
    assert value_type(word).name == name
    assert Read("holding_registers", 0, 1, word).type == name
    assert Point("p", "holding_registers", 0, type=word).type == name


@each_case(
    ("word", "order"),
    [
        ("abcd", "ABCD"),
        *((word, "CDAB") for word in ("word swap", "word-swapped", "Word_Swapped")),
        ("byte swapped", "BADC"),
    ],
)
def test_words_for_orders_are_understood(word: Any, order: str) -> None:
    assert value_type("float32", order=word).order == order
    assert Point("p", "holding_registers", 0, type="float32", order=word).order == order


@each_case(
    ("make", "message"),
    [
        (lambda: Read("holdin" + "g_register_s", 0), "did you mean holding_registers"),  # type: ignore[arg-type]
        (lambda: value_type("flot32"), "did you mean float32"),
        (lambda: value_type("bool"), "type must be one of"),
        (lambda: value_type("float32", order="middle endian"), "order must be one of"),
        (lambda: value_type("float32", order="little endian"), "DCBA to some, and CDAB"),
        (lambda: value_type("float32", order="little"), "DCBA to some, and CDAB"),
        (lambda: value_type("float32", order="Big_Endian"), "ABCD to some, and CDAB"),
        (lambda: Point("p", "holding_registers", 0, type="int32", order="le"), "DCBA to some"),
        (lambda: Plan([("coils", 0)], forbidden=[("coilz", range(3))]), "did you mean coils"),  # type: ignore[list-item]
    ],
)
def test_unknown_words_are_refused(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_clients_take_words_for_tables_types_and_orders() -> None:
    mapping = Mapping(holding_registers=8, input_registers=8)
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        client: Any = Client(running.urls[0])
        with client:
            client.write_values("hr", 2, [1.5], "FLOAT", order="word swapped")
            assert mapping.holding_registers[2:4] == [0, 0x3FC0]
            assert client.read_value("4x", 2, "real", order="word swap") == 1.5
            assert client.read_values("ir", 0, "u16", 2) == [0, 0]
            with pytest.raises(ValueError, match="table must be one of holding_registers"):
                client.read_value("co", 0, "u16")


def test_names_of_tables_are_those_of_mappings_and_type_checkers() -> None:
    bits, registers = get_args(Table)[:2], get_args(RegisterTable)
    assert {*bits, *registers} == set(TABLES) == set(get_args(Table))
    assert [name for name, rules in TABLES.items() if rules.is_bits] == list(bits)
    for name in TABLES:
        assert len(getattr(Mapping(**{name: 3}), name)) == 3


@each_case("name", TABLES)
def test_reads_take_only_readable_tables(name: str) -> None:
    rules = TABLES[name]
    request = rules.read(TABLE_SIZE - rules.most_read, rules.most_read)
    assert len(request.encode()) == 5
    result = [index % 2 for index in range(rules.most_read)]
    assert request.decode_response(request.encode_response(result)) == result
    for address, count in ((0, rules.most_read + 1), (TABLE_SIZE, 1), (TABLE_SIZE - 1, 2)):
        with pytest.raises(ValueError, match="must"):
            rules.read(address, count)


@pytest.mark.parametrize(
    ("name", "write"), [("coils", pdu.WriteCoils), ("holding_registers", pdu.WriteRegisters)]
)
def test_only_writable_tables_work(name: str, write: type[pdu.WriteCoils | pdu.WriteRegisters]):
    most = TABLES[name].most_written
    assert len(write(0, (1,) * most).encode()) <= pdu.MAX_PDU
    with pytest.raises(ValueError, match="values must hold"):
        write(0, (1,) * (most + 1))


def test_inputs_cannot_be_written() -> None:
    assert [name for name, rules in TABLES.items() if not rules.most_written] == [
        "discrete_inputs",
        "input_registers",
    ]
