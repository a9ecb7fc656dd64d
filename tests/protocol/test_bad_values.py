"""Values and registers that a type does not take, and how errors name them."""

from array import array
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py.protocol.values import ORDERS, readings, value_type
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.values import (
    LIMITS,
    NUMBERS,
    cell,
    decode,
    decode_many,
    each_number,
    encode,
    words,
)


class TestErrors:
    @each_case("name", LIMITS)
    def test_integers_have_a_range(self, name: str) -> None:
        low, high = LIMITS[name]
        for value in (low, high):
            assert decode(encode(value, name), name) == value
        for value in (low - 1, high + 1, 1 << 70, -1 << 70):
            with pytest.raises(
                ValueError, match=rf"^value must be in {low}\.\.{high}, not {value}$"
            ):
                encode(value, name)
        for bad in (1.0, "1", None, True, [1], 1j):
            with pytest.raises(
                TypeError, match=rf"^value must be an integer in {low}\.\.{high}, not"
            ):
                encode(bad, name)

    @pytest.mark.parametrize(
        ("name", "span", "values"),
        [
            ("float16", r"-65504\.\.65504", [65520, -65520.0, 1e300, 10**400]),
            ("float32", r"-3\.4028235e\+38\.\.3\.4028235e\+38", [3.4028236e38, -1e39, 10**400]),
            ("float64", r"-1\.7976931e\+308\.\.1\.7976931e\+308", [10**400, -(10**400)]),
        ],
    )
    def test_floats_have_a_range(self, name: str, span: str, values: list[Any]) -> None:
        for value in values:
            with pytest.raises(
                ValueError, match=rf"^value must be in {span}, infinite or nan, not"
            ) as e:
                encode(value, name)
            assert len(str(e.value)) < 150
        for bad in ("1", None, True, [1.0], 1j, b"1"):
            with pytest.raises(TypeError, match=r"^value must be a number, not "):
                encode(bad, name)

    @each_case("registers", ["000A", "A000", "0F00", "FFFF"])
    def test_bcd_digits_must_be_decimal(self, registers: str) -> None:
        with pytest.raises(ValueError, match=rf"^registers\[0:1\] hold no bcd16: {registers} has"):
            decode(words(registers), "bcd16")

    def test_bits_may_be_given_as_zeros_and_ones(self) -> None:
        assert encode([1, 0, 1] + [0] * 13, "bits16") == [5]
        assert encode((True,) * 16, "bits16") == [0xFFFF]
        assert decode([5], "bits16") == [True, False, True] + [False] * 13
        assert {type(bit) for bit in decode([5], "bits16")} == {bool}

    def test_the_number_of_bits_must_match_the_names(self, refused: Refused) -> None:
        refused("wrong_bits.txt", lambda bits: encode(bits, "bits16"))

    @each_number
    def test_the_number_of_registers_must_match_the_type(self, name: str) -> None:
        takes = value_type(name).registers
        for count in {0, takes - 1, takes + 1, 2 * takes}:
            with pytest.raises(ValueError, match=f"must hold {takes} for {name}, not {count}$"):
                decode([0] * count, name)

    @each_case(
        ("registers", "error", "message"),
        [
            ([0, -1], ValueError, r"registers\[1\] must be in 0\.\.65535, not -1"),
            ([65536, 0], ValueError, r"registers\[0\] must be in 0\.\.65535, not 65536"),
            ([0, 1.0], TypeError, r"registers\[1\] must be an integer in 0\.\.65535, not float"),
            ([0, True], TypeError, r"registers\[1\] must be an integer"),
            ([None, 0], TypeError, r"registers\[0\] must be an integer"),
            (b"\x00\x01", TypeError, "registers must be a list, not bytes"),
            ("01", TypeError, "registers must be a list, not str"),
            ({1, 2}, TypeError, "registers must be a list, not set"),
            (5, TypeError, "registers must be a list, not int"),
            (None, TypeError, "registers must be a list, not NoneType"),
        ],
    )
    @each_case(
        "function",
        [
            lambda registers: decode(registers, "uint32"),
            lambda registers: decode_many(registers, "uint32"),
            readings,
        ],
        ids=["decode", "decode_many", "readings"],
    )
    def test_wrong_registers_are_refused(self, function, registers, error, message) -> None:
        with pytest.raises(error, match=message):
            function(registers)

    @each_case("registers", [(1, 2), array("H", [1, 2]), range(1, 3), (at for at in (1, 2))])
    def test_registers_may_be_any_sequence_of_integers(self, registers: Any) -> None:
        assert decode(registers, "uint32") == 0x10002

    @settings(max_examples=80)
    @given(
        st.lists(cell | st.integers(), max_size=5),
        st.sampled_from([*NUMBERS, "string:3", "string:8"]),
        st.sampled_from(list(ORDERS)),
    )
    def test_any_registers_are_a_value_or_a_value_error(
        self, registers: list[int], name: str, order: str
    ) -> None:
        try:
            value = decode(registers, name, order=order)
        except ValueError:
            return
        if isinstance(value, float | str):
            return  # payloads of nan and padding are not kept
        assert encode(value, name, order=order) == registers
