"""
References, the 1-based notation of manuals.
"""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vectors import REFERENCES, Reference, rows

from libmodbus_py import values
from libmodbus_py.values import parse_reference

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


class TestParseReference:
    @pytest.mark.parametrize("vector", rows(REFERENCES))
    def test_reference_of_a_worked_example(self, vector: Reference) -> None:
        parsed = parse_reference(vector.reference)
        assert parsed == (TABLES[vector.table], vector.address)
        assert parsed.table == TABLES[vector.table]
        assert parsed.address == vector.address

    def test_worked_examples_cover_every_table(self) -> None:
        assert {vector.table for vector in REFERENCES} == set(TABLES)

    @pytest.mark.parametrize("digit", ["0", "1", "3", "4"])
    def test_first_and_last_item_of_a_table(self, digit: str) -> None:
        table = DIGITS[digit]
        assert parse_reference(f"{digit}0001") == (table, 0)
        assert parse_reference(f"{digit}9999") == (table, 9998)
        assert parse_reference(f"{digit}00001") == (table, 0)
        assert parse_reference(f"{digit}65536") == (table, 65535)

    def test_file_records_count_from_0(self) -> None:
        assert parse_reference("60000") == ("file", 0)
        assert parse_reference("600000") == ("file", 0)
        assert parse_reference("69999") == ("file", 9999)
        assert parse_reference("609999") == ("file", 9999)

    @pytest.mark.parametrize(
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
    def test_anything_else_is_refused_and_named(self, bad: str) -> None:
        with pytest.raises(ValueError, match="reference") as caught:
            parse_reference(bad)
        assert repr(bad) in str(caught.value)

    @pytest.mark.parametrize("bad", [40123, 123, 4.0, None, b"40123", True, ["40123"]])
    def test_only_text_is_a_reference(self, bad: Any) -> None:
        with pytest.raises(TypeError, match="must be a string"):
            parse_reference(bad)

    @settings(max_examples=150, deadline=None)
    @given(st.sampled_from("0134"), st.integers(1, 65536))
    def test_item_is_the_address_and_one(self, digit: str, item: int) -> None:
        assert parse_reference(f"{digit}{item:05}") == (DIGITS[digit], item - 1)
        if item <= 9999:
            assert parse_reference(f"{digit}{item:04}") == (DIGITS[digit], item - 1)

    @settings(max_examples=150, deadline=None)
    @given(st.text("0123456789 +-_\u0661", max_size=7))
    def test_text_is_a_reference_or_a_value_error(self, text: str) -> None:
        try:
            table, address = parse_reference(text)
        except ValueError:
            return
        assert table == DIGITS[text[0]]
        assert int(text[1:]) - address == (0 if table == "file" else 1)

    def test_tables_are_those_of_mappings(self) -> None:
        assert values.TABLES == DIGITS
