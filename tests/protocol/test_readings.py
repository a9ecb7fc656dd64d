"""All values that some registers may mean, and references, the 1-based notation of manuals."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py.protocol.values import WIDE_ORDERS, parse_reference, readings
from libmodbus_py.protocol.words import REFERENCE_TABLES
from tests.support.cases import each_case
from tests.support.values import NUMBERS, cell, decode, words
from tests.support.vectors import REFERENCES, Reference, rows

# As the examples call the tables, and as this package does.
TABLES = {
    "coil": "coils",
    "discrete_input": "discrete_inputs",
    "input_register": "input_registers",
    "holding_register": "holding_registers",
    "file_record": "file",
}
DIGITS = {
    "0": "coils",
    "1": "discrete_inputs",
    "3": "input_registers",
    "4": "holding_registers",
    "6": "file",
}


class TestReadings:
    @settings(max_examples=40)
    @given(st.lists(cell, min_size=1, max_size=6))
    def test_readings_have_no_duplicates(self, registers: list[int]) -> None:
        orders: dict[tuple[str, str], str] = {}
        for name in [*NUMBERS, "int48", "uint48", f"string:{2 * len(registers)}"]:
            for order in ("ABCD", "CDAB", "BADC", "DCBA", *WIDE_ORDERS):
                try:
                    value = decode(registers, name, order=order)
                except ValueError:
                    continue
                if value == "" and any(registers):
                    continue
                orders.setdefault((name, repr(value)), order)
        results = readings(registers)
        assert {(name, repr(value)): order for name, order, value in results} == orders
        assert len(results) == len(orders)

    def test_two_registers_are_read_as_each_type_and_order(self) -> None:
        results = readings(words("0000 42C8"))
        assert ("float32", "CDAB", 100.0) in results
        assert ("uint32", "ABCD", 0x42C8) in results
        assert results[0] == ("int32", "ABCD", 0x42C8)
        assert results[0].type == "int32"
        assert results[0].order == "ABCD"
        assert results[0].value == 0x42C8
        assert not [reading for reading in results if reading.type == "bcd32"]

    @each_case("registers", ["FFFF FFFF", "7FC0 7FC0", "FFFF FFFF FFFF FFFF", "FFFF"])
    def test_nan_is_not_repeated(self, registers: str) -> None:
        results = readings(words(registers))
        assert [reading.order for reading in results if str(reading.value) == "nan"] == ["ABCD"]

    def test_signs_of_zero_are_distinct(self) -> None:
        texts = [str(value) for name, _, value in readings(words("8000 0000")) if name == "float32"]
        assert "-0.0" in texts

    @each_case("count", [5, 6, 8, 124, 125])
    def test_other_register_counts_can_only_be_text(self, count: int) -> None:
        name = f"string:{2 * count}"
        assert readings([0x4142] * count) == [
            (name, "ABCD", "AB" * count),
            (name, "BADC", "BA" * count),
        ]
        assert readings([0xFFFF] * count) == []
        assert readings([0] * count) == [(name, "ABCD", "")]

    @pytest.mark.parametrize("count", [0, 126, 1000])
    def test_the_number_of_registers_is_1_to_125(self, count: int) -> None:
        with pytest.raises(
            ValueError, match=rf"the number of registers must be in 1\.\.125, not {count}"
        ):
            readings([0] * count)


class TestParseReference:
    @each_case("vector", rows(REFERENCES))
    def test_reference_of_a_worked_example(self, vector: Reference) -> None:
        reference = parse_reference(vector.reference)
        assert reference == (TABLES[vector.table], vector.address)
        assert reference.table == TABLES[vector.table]
        assert reference.address == vector.address

    def test_worked_examples_of_references_cover_every_table(self) -> None:
        assert {vector.table for vector in REFERENCES} == set(TABLES)

    @each_case("digit", ["0", "1", "3", "4"])
    def test_first_and_last_item_of_a_table(self, digit: str) -> None:
        table = DIGITS[digit]
        assert parse_reference(f"{digit}0001") == (table, 0)
        assert parse_reference(f"{digit}9999") == (table, 9998)
        assert parse_reference(f"{digit}00001") == (table, 0)
        assert parse_reference(f"{digit}65536") == (table, 65535)

    def test_references_to_file_records_count_from_0(self) -> None:
        assert parse_reference("60000") == ("file", 0)
        assert parse_reference("600000") == ("file", 0)
        assert parse_reference("69999") == ("file", 9999)
        assert parse_reference("609999") == ("file", 9999)

    @each_case(
        "bad",
        [
            "",
            "4",
            "4012",
            "4001234",
            "40000",  # items count from 1
            "400000",
            "000000",
            "465537",
            "499999",
            "610000",
            "20001",
            "50001",
            "70001",
            "90001",
            "-40001",
            "+40001",
            " 40001",
            "40001 ",
            "40001\n",
            "4 0001",
            "4_0001",
            "4x0001",
            "0x001",
            "4000.1",
            "4000\u0661",  # a digit, but of another script
            "\uff140001",
        ],
    )
    def test_other_texts_are_refused_as_references_and_named(self, bad: str) -> None:
        with pytest.raises(ValueError, match="reference") as caught:
            parse_reference(bad)
        assert repr(bad) in str(caught.value)

    @each_case("bad", [40123, 123, 4.0, None, b"40123", True, ["40123"]])
    def test_a_reference_must_be_text(self, bad: Any) -> None:
        with pytest.raises(TypeError, match="must be a string"):
            parse_reference(bad)

    @settings(max_examples=75)
    @given(st.text("0123456789 +-_\u0661", max_size=7))
    def test_any_text_is_a_reference_or_a_value_error(self, text: str) -> None:
        try:
            table, address = parse_reference(text)
        except ValueError:
            return
        assert table == DIGITS[text[0]]
        assert int(text[1:]) - address == (0 if table == "file" else 1)

    def test_tables_are_those_of_mappings(self) -> None:
        assert REFERENCE_TABLES == DIGITS
