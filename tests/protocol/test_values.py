"""Values in registers, in every type and order, one or many, and the names of types."""

import math
from decimal import Decimal
from fractions import Fraction
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py.protocol.values import (
    ORDERS,
    TYPES,
    WIDE_ORDERS,
    BitsType,
    NumberType,
    Order,
    TextType,
    TimeType,
    TypeName,
    string_type,
    value_type,
)
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.values import (
    NUMBERS,
    cell,
    decode,
    decode_many,
    each_number,
    each_order,
    encode,
    encode_many,
    same,
    strategy,
    words,
)
from tests.support.vectors import BYTE_ORDERS, ByteOrder, rows

# Where byte 0, 1, ... of the wire comes from, of a value's bytes, most significant first.
# Written out by hand, from the letters of each order.
PLACES = {
    ("ABCD", 1): [0, 1],
    ("CDAB", 1): [0, 1],
    ("BADC", 1): [1, 0],
    ("DCBA", 1): [1, 0],
    ("ABCD", 2): [0, 1, 2, 3],
    ("CDAB", 2): [2, 3, 0, 1],
    ("BADC", 2): [1, 0, 3, 2],
    ("DCBA", 2): [3, 2, 1, 0],
    ("ABCD", 4): [0, 1, 2, 3, 4, 5, 6, 7],
    ("CDAB", 4): [6, 7, 4, 5, 2, 3, 0, 1],
    ("BADC", 4): [1, 0, 3, 2, 5, 4, 7, 6],
    ("DCBA", 4): [7, 6, 5, 4, 3, 2, 1, 0],
}


class TestKnownEncodings:
    @each_case("vector", rows(BYTE_ORDERS))
    def test_byte_order_of_a_worked_example(self, vector: ByteOrder) -> None:
        assert decode(vector.registers, vector.type, order=vector.order) == vector.value
        assert encode(vector.value, vector.type, order=vector.order) == vector.registers

    # IEEE 754 interchange formats, by their fields: sign, exponent, fraction.
    @each_case(
        ("name", "value", "registers"),
        [
            ("float16", 1.0, "3C00"),
            ("float16", -2.0, "C000"),
            ("float16", 65504.0, "7BFF"),
            ("float16", 2.0**-24, "0001"),
            ("float16", 2.0**-14, "0400"),
            ("float16", math.inf, "7C00"),
            ("float32", 0.0, "0000 0000"),
            ("float32", -0.0, "8000 0000"),
            ("float32", 1.0, "3F80 0000"),
            ("float32", -2.0, "C000 0000"),
            ("float32", 0.15625, "3E20 0000"),
            ("float32", 85.125, "42AA 4000"),
            ("float32", 2.0**-149, "0000 0001"),
            ("float32", 2.0**-126, "0080 0000"),
            ("float32", (2 - 2**-23) * 2.0**127, "7F7F FFFF"),
            ("float32", math.inf, "7F80 0000"),
            ("float32", -math.inf, "FF80 0000"),
            ("float64", 1.0, "3FF0 0000 0000 0000"),
            ("float64", 85.125, "4055 4800 0000 0000"),
            ("float64", 5e-324, "0000 0000 0000 0001"),
            ("float64", 1.7976931348623157e308, "7FEF FFFF FFFF FFFF"),
            ("float64", -math.inf, "FFF0 0000 0000 0000"),
            ("int16", -1, "FFFF"),
            ("int16", -32768, "8000"),
            ("int32", -2, "FFFF FFFE"),
            ("int64", -0x8000000000000000, "8000 0000 0000 0000"),
            ("uint16", 65535, "FFFF"),
            ("uint32", 0x12345678, "1234 5678"),
            ("uint64", 0x0123456789ABCDEF, "0123 4567 89AB CDEF"),
            ("bcd16", 9, "0009"),
            ("bcd16", 1234, "1234"),
            ("bcd32", 12345678, "1234 5678"),
            ("bcd64", 99, "0000 0000 0000 0099"),
            ("bits16", [True] + [False] * 15, "0001"),
            ("bits16", [False] * 15 + [True], "8000"),
            ("bits32", [False] * 31 + [True], "8000 0000"),
            ("bits64", [False] * 17 + [True] + [False] * 46, "0000 0000 0002 0000"),
            ("string:4", "Ab1!", "4162 3121"),
            ("string:4", "Ab", "4162 0000"),
            ("string:5", "Ab1!?", "4162 3121 3F00"),
            ("string:1", "A", "4100"),
            ("string:2", "", "0000"),
        ],
    )
    def test_known_values_have_their_registers(self, name: str, value: Any, registers: str) -> None:
        assert encode(value, name) == words(registers)
        assert same(decode(words(registers), name), value)

    @each_case("value", ["7FC0 0000", "FFC0 0000", "7FFF FFFF", "7F80 0001"])
    def test_every_nan_of_a_type_decodes_to_nan(self, value: str) -> None:
        assert math.isnan(decode(words(value), "float32"))

    @pytest.mark.parametrize(
        ("name", "exponent", "fraction"),
        [("float16", 0x7C00, 10), ("float32", 0x7F800000, 23), ("float64", 0x7FF << 52, 52)],
    )
    def test_nan_is_written_as_nan(self, name: str, exponent: int, fraction: int) -> None:
        number = int("".join(f"{word:04x}" for word in encode(math.nan, name)), 16)
        assert number & exponent == exponent
        assert number & ((1 << fraction) - 1)

    def test_floats_are_rounded_to_nearest_even(self) -> None:
        assert decode(encode(0.1, "float32"), "float32") == 13421773 / 2**27
        assert encode(2**24 + 1, "float32") == encode(2**24, "float32")
        assert encode(2049, "float16") == encode(2048, "float16")
        assert encode(65519.9, "float16") == words("7BFF")

    @pytest.mark.parametrize("value", [Fraction(1, 2), Decimal("0.5"), 0.5])
    def test_any_number_can_be_encoded_as_a_float(self, value: Any) -> None:
        assert encode(value, "float32") == words("3F00 0000")
        assert encode(1, "float32") == words("3F80 0000")


class TestOrders:
    @each_order
    @each_number
    def test_bytes_have_the_order_of_the_letters(self, name: str, order: str) -> None:
        kind = value_type(name)
        raw = bytes.fromhex("1234567890123456")[: 2 * kind.registers]  # decimal digits, no nan
        value = decode([int.from_bytes(raw[at : at + 2]) for at in range(0, len(raw), 2)], name)
        wire = b"".join(word.to_bytes(2) for word in encode(value, name, order=order))
        assert wire == bytes(raw[at] for at in PLACES[order, kind.registers])

    @each_order
    @each_case("name", [*NUMBERS, "string:1", "string:7", "string:8"])
    @settings(max_examples=15)
    @given(st.data())
    def test_what_is_encoded_is_decoded(self, name: str, order: str, data: st.DataObject) -> None:
        value = data.draw(strategy(name))
        registers = encode(value, name, order=order)
        assert len(registers) == value_type(name).registers
        assert all(type(word) is int and 0 <= word <= 0xFFFF for word in registers)
        assert same(decode(registers, name, order=order), value)

    @each_order
    @each_case("name", [name for name in NUMBERS if "int" in name or "bits" in name])
    @settings(max_examples=15)
    @given(st.data())
    def test_what_is_decoded_is_encoded(self, name: str, order: str, data: st.DataObject) -> None:
        count = value_type(name).registers
        registers = data.draw(st.lists(cell, min_size=count, max_size=count))
        assert encode(decode(registers, name, order=order), name, order=order) == registers

    @each_case(
        ("spelling", "name", "order"),
        [
            ("AB", "uint16", "ABCD"),
            ("BA", "uint16", "BADC"),
            ("ba", "uint16", "BADC"),
            ("dcba", "uint16", "BADC"),
            ("CDAB", "uint16", "ABCD"),
            ("ABCDEFGH", "uint64", "ABCD"),
            ("GHEFCDAB", "float64", "CDAB"),
            ("badcfehg", "uint64", "BADC"),
            ("HGFEDCBA", "bits64", "DCBA"),
            ("Cdab", "uint32", "CDAB"),
            ("AB", "string:8", "ABCD"),
            ("BA", "string:8", "BADC"),
        ],
    )
    def test_all_spellings_of_an_order_are_equal(self, spelling: str, name: str, order: str):
        registers = [0x4142, 0x4344, 0x4546, 0x4748][: value_type(name).registers]
        assert decode(registers, name, order=spelling) == decode(registers, name, order=order)
        value = decode(registers, name)
        assert encode(value, name, order=spelling) == encode(value, name, order=order)

    @each_case(
        ("order", "name"),
        [
            ("AB", "uint32"),  # in which order would the registers be?
            ("BA", "float32"),
            ("BA", "uint64"),
            ("ABCDEFGH", "uint32"),
            ("HGFEDCBA", "uint16"),
            ("HGFEDCBA", "string:8"),
        ],
    )
    def test_spelling_of_another_width_is_refused(self, order: str, name: str) -> None:
        with pytest.raises(ValueError, match=f"order of {name} must be one of .*, not '{order}'"):
            value_type(name, order=order)

    @each_case("order", ["", "ABC", "ABDC", "ABCDEFG", "big", "A B C D"])
    def test_an_unknown_order_is_refused(self, order: str) -> None:
        with pytest.raises(ValueError, match="order must be one of ABCD, CDAB, BADC, DCBA") as e:
            decode([1, 2], "uint32", order=order)
        assert repr(order) in str(e.value)

    @each_case("order", [None, 1, b"ABCD", ["ABCD"], True])
    def test_an_order_must_be_a_string(self, order: Any) -> None:
        with pytest.raises(TypeError, match="order must be one of ABCD, CDAB, BADC, DCBA"):
            encode(1, "uint32", order=order)


class TestValueType:
    @each_case(("size", "registers"), [(1, 1), (2, 1), (3, 2), (249, 125), (250, 125)])
    def test_a_string_has_a_register_for_two_characters(self, size: int, registers: int) -> None:
        kind = value_type(f"string:{size}")
        assert (kind.name, kind.registers) == (f"string:{size}", registers)
        assert kind.is_text

    @each_case("name", ["", "int12", "long", "bool", "string", "string:", "string:-1", "string:8x"])
    def test_an_unknown_type_is_refused(self, name: str) -> None:
        with pytest.raises(ValueError, match=r"type must be one of .*eui48, string:N") as e:
            value_type(name)
        assert repr(name) in str(e.value)

    @each_case("size", [0, 251, 999, 65536, 999_999_999])
    def test_a_string_of_a_wrong_size_is_refused(self, size: int) -> None:
        with pytest.raises(ValueError, match=rf"N must be in 1\.\.250, not {size}"):
            value_type(f"string:{size}")

    @each_case("name", [None, 16, int, b"int16", ["int16"]])
    def test_a_type_must_be_a_string(self, name: Any) -> None:
        with pytest.raises(TypeError, match="type must be a string"):
            value_type(name)


class TestMany:
    @each_order
    @each_case("name", [*NUMBERS, "string:5"])
    @settings(max_examples=10)
    @given(st.data())
    def test_values_follow_one_another(self, name, order: str, data: st.DataObject) -> None:
        given_values = data.draw(st.lists(strategy(name), max_size=5))
        registers = encode_many(given_values, name, order=order)
        assert registers == [
            word for value in given_values for word in encode(value, name, order=order)
        ]
        assert same(decode_many(registers, name, order=order), given_values)

    def test_values_have_known_registers(self) -> None:
        assert encode_many([1, -1], "int32", order="CDAB") == words("0001 0000 FFFF FFFF")
        assert decode_many(words("4142 4300 4400 0000"), "string:4") == ["ABC", "D"]
        assert encode_many((at for at in (1, 2)), "bcd16") == [1, 2]
        assert encode_many(["A", "BC"], "string:2", padding=" ") == words("4120 4243")

    def test_no_values_have_no_registers(self) -> None:
        assert encode_many([], "float64") == []
        assert decode_many([], "float64") == []

    def test_a_bad_value_is_named(self, refused: Refused) -> None:
        refused("wrong_values.txt", lambda case: encode_many(*case))

    @pytest.mark.parametrize(("name", "takes"), [("int32", 2), ("float64", 4), ("string:5", 3)])
    def test_a_number_of_registers_between_two_values_is_refused(self, name: str, takes: int):
        for count in (1, takes - 1, takes + 1, 2 * takes + 1):
            with pytest.raises(
                ValueError,
                match=f"registers must hold a multiple of {takes} for {name}, not {count}",
            ):
                decode_many([0] * count, name)

    def test_bad_registers_are_named(self) -> None:
        with pytest.raises(ValueError, match=r"^registers\[2:4\] hold no bcd32: 0000000A has"):
            decode_many([0, 0, 0, 10, 0, 0], "bcd32")
        with pytest.raises(ValueError, match=r"^registers\[1:2\] hold no string:2: FF FF is no"):
            decode_many([0x4142, 0xFFFF], "string:2")


def test_type_checkers_know_the_names_of_all_types() -> None:
    others = {*get_args(NumberType), *get_args(BitsType), *get_args(TimeType)}
    texts = {*get_args(get_args(TextType)[0])}
    assert {name for name in texts if not value_type(name).is_text} == {"eui48"}
    assert others | {"eui48"} == set(TYPES)
    assert sum(len(get_args(item)) for item in get_args(TypeName)) < 70  # errors list all types
    assert get_args(Order) == (*ORDERS, *WIDE_ORDERS)


def test_strings_of_other_sizes_have_a_function_for_type_checkers() -> None:
    assert value_type(string_type(77)).name == "string:77"
    for size in (0, 251, "77"):
        with pytest.raises((TypeError, ValueError), match=r"size must be .*1\.\.250"):
            string_type(size)  # type: ignore[arg-type]


@each_case("name", get_args(NumberType))
def test_limits_are_the_numbers_that_just_fit(name: str) -> None:
    kind = TYPES[name]
    assert kind.limits is not None
    low, high = kind.limits
    for number in kind.limits:
        assert kind.decode(kind.encode(number)) == number
    for beyond in (low * 2 - 1, high * 2 + 1):
        if math.isfinite(beyond):
            with pytest.raises(ValueError, match="must be in"):
                kind.encode(beyond)


@each_case("name", [*get_args(BitsType), "string:1"])
def test_types_that_are_no_numbers_have_no_limits(name: str) -> None:
    assert value_type(name).limits is None
