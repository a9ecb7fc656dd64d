"""
Values in registers, in every type and order, and references, the 1-based notation of manuals.
"""

from __future__ import annotations

import codecs
import math
from array import array
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import values
from libmodbus_py.protocol.values import (
    ORDERS,
    TYPES,
    BitsType,
    NumberType,
    Order,
    TextType,
    TimeType,
    TypeName,
    parse_reference,
    readings,
    string_type,
    value_type,
)
from libmodbus_py.protocol.words import REFERENCE_TABLES
from tests.support.cases import each_case
from tests.support.vectors import BYTE_ORDERS, REFERENCES, ByteOrder, Reference, rows


def encode(value: Any, type: str, **options: Any) -> list[int]:
    return value_type(type, **options).encode(value)


def encode_many(values: Any, type: str, **options: Any) -> list[int]:
    return value_type(type, **options).encode_many(values)


def decode(registers: Any, type: str, **options: Any) -> Any:
    return value_type(type, **options).decode(registers)


def decode_many(registers: Any, type: str, **options: Any) -> list[Any]:
    return value_type(type, **options).decode_many(registers)


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
NUMBERS = [
    f"{family}{bits}" for family in ("int", "uint", "float", "bcd", "bits") for bits in (16, 32, 64)
]
LIMITS = {
    "int16": (-32768, 32767),
    "int32": (-2147483648, 2147483647),
    "int64": (-9223372036854775808, 9223372036854775807),
    "uint16": (0, 65535),
    "uint32": (0, 4294967295),
    "uint64": (0, 18446744073709551615),
    "bcd16": (0, 9999),
    "bcd32": (0, 99999999),
    "bcd64": (0, 9999999999999999),
}
ASCII = st.characters(min_codepoint=1, max_codepoint=126)

each_order = each_case("order", ["ABCD", "CDAB", "BADC", "DCBA"])
each_number = each_case("name", NUMBERS)
cell = st.integers(0, 0xFFFF)


def words(text: str) -> list[int]:
    """Registers from hexadecimal digits, four each."""
    return [int(word, 16) for word in text.split()]


def strategy(name: str) -> st.SearchStrategy[Any]:
    """Values that a type holds exactly."""
    bits = int(name.lstrip("abcdefghijklmnopqrstuvwxyz:"))
    if name in LIMITS:
        return st.integers(*LIMITS[name])
    if name.startswith("float"):
        return st.floats(width=bits)  # type: ignore[arg-type]
    if name.startswith("bits"):
        return st.lists(st.booleans(), min_size=bits, max_size=bits)
    return st.text(ASCII, max_size=bits)


def same(one: Any, other: Any) -> bool:
    """Equal, with nan and the sign of zero."""
    return type(one) is type(other) and repr(one) == repr(other)


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
    def test_both_ways(self, name: str, value: Any, registers: str) -> None:
        assert encode(value, name) == words(registers)
        assert same(decode(words(registers), name), value)

    @each_case("value", ["7FC0 0000", "FFC0 0000", "7FFF FFFF", "7F80 0001"])
    def test_every_nan_is_nan(self, value: str) -> None:
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
    def test_any_number_is_a_float(self, value: Any) -> None:
        assert encode(value, "float32") == words("3F00 0000")
        assert encode(1, "float32") == words("3F80 0000")


class TestOrders:
    @each_order
    @each_number
    def test_bytes_lie_as_the_letters_say(self, name: str, order: str) -> None:
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
    def test_spellings(self, spelling: str, name: str, order: str) -> None:
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

    @each_case("order", ["", "ABC", "ABDC", "ABCDEF", "big", "A B C D"])
    def test_no_such_order(self, order: str) -> None:
        with pytest.raises(ValueError, match="order must be one of ABCD, CDAB, BADC, DCBA") as e:
            decode([1, 2], "uint32", order=order)
        assert repr(order) in str(e.value)

    @each_case("order", [None, 1, b"ABCD", ["ABCD"], True])
    def test_order_is_a_string(self, order: Any) -> None:
        with pytest.raises(TypeError, match="order must be one of ABCD, CDAB, BADC, DCBA"):
            encode(1, "uint32", order=order)


class TestValueType:
    @each_case(("size", "registers"), [(1, 1), (2, 1), (3, 2), (249, 125), (250, 125)])
    def test_registers_of_strings(self, size: int, registers: int) -> None:
        kind = value_type(f"string:{size}")
        assert (kind.name, kind.registers) == (f"string:{size}", registers)
        assert kind.is_text

    @each_case(
        "name",
        ["", "int8", "long", "bool", "string", "string:", "string:-1", "string:8x"],
    )
    def test_no_such_type(self, name: str) -> None:
        with pytest.raises(ValueError, match=r"type must be one of .*eui48, string:N") as e:
            value_type(name)
        assert repr(name) in str(e.value)

    @each_case("size", [0, 251, 999, 65536, 999_999_999])
    def test_no_such_string(self, size: int) -> None:
        with pytest.raises(ValueError, match=rf"N must be in 1\.\.250, not {size}"):
            value_type(f"string:{size}")

    @each_case("name", [None, 16, int, b"int16", ["int16"]])
    def test_type_is_a_string(self, name: Any) -> None:
        with pytest.raises(TypeError, match="type must be a string"):
            value_type(name)


class TestErrors:
    @each_case("name", LIMITS)
    def test_integers_have_limits(self, name: str) -> None:
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
    def test_floats_have_limits(self, name: str, span: str, values: list[Any]) -> None:
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
    def test_decimals_are_decimal(self, registers: str) -> None:
        with pytest.raises(ValueError, match=rf"^registers\[0:1\] hold no bcd16: {registers} has"):
            decode(words(registers), "bcd16")

    def test_bits_may_be_zeros_and_ones(self) -> None:
        assert encode([1, 0, 1] + [0] * 13, "bits16") == [5]
        assert encode((True,) * 16, "bits16") == [0xFFFF]
        assert decode([5], "bits16") == [True, False, True] + [False] * 13
        assert {type(bit) for bit in decode([5], "bits16")} == {bool}

    @each_case(
        ("value", "error", "named"),
        [
            ([True] * 15, ValueError, "value must hold 16 bits, lowest first, not 15"),
            ([True] * 17, ValueError, "value must hold 16 bits, lowest first, not 17"),
            ([], ValueError, "not 0"),
            ([0, 2] + [0] * 14, ValueError, r"value\[1\] must be in 0\.\.1, not 2"),
            ([0] * 15 + [-1], ValueError, r"value\[15\] must be in 0\.\.1, not -1"),
            ([0, 1.0] + [0] * 14, TypeError, r"value\[1\] must be an integer"),
            (["0"] * 16, TypeError, r"value\[0\] must be an integer"),
            ("0" * 16, TypeError, "value must be a list, not str"),
            (bytes(16), TypeError, "value must be a list, not bytes"),
            (dict.fromkeys(range(16)), TypeError, "value must be a list, not dict"),
            (5, TypeError, "value must be a list, not int"),
            (None, TypeError, "value must be a list, not NoneType"),
        ],
    )
    def test_bits_are_as_many_as_named(
        self, value: Any, error: type[Exception], named: str
    ) -> None:
        with pytest.raises(error, match=named):
            encode(value, "bits16")

    @each_number
    def test_registers_are_as_many_as_the_type_takes(self, name: str) -> None:
        takes = value_type(name).registers
        for count in {0, takes - 1, takes + 1, 2 * takes}:
            with pytest.raises(ValueError, match=f"must hold {takes} for {name}, not {count}$"):
                decode([0] * count, name)

    @each_case(
        ("registers", "error", "named"),
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
    def test_registers_are_registers(
        self, function: Callable[[Any], Any], registers: Any, error: type[Exception], named: str
    ) -> None:
        with pytest.raises(error, match=named):
            function(registers)

    @each_case("registers", [(1, 2), array("H", [1, 2]), range(1, 3), (at for at in (1, 2))])
    def test_registers_may_be_any_run_of_integers(self, registers: Any) -> None:
        assert decode(registers, "uint32") == 0x10002

    @settings(max_examples=80)
    @given(
        st.lists(cell | st.integers(), max_size=5),
        st.sampled_from([*NUMBERS, "string:3", "string:8"]),
        st.sampled_from(list(ORDERS)),
    )
    def test_registers_are_a_value_or_a_value_error(
        self, registers: list[int], name: str, order: str
    ) -> None:
        try:
            value = decode(registers, name, order=order)
        except ValueError:
            return
        if isinstance(value, float | str):
            return  # payloads of nan and padding are not kept
        assert encode(value, name, order=order) == registers


class TestText:
    @each_case(
        ("value", "name", "options", "registers"),
        [
            ("AB", "string:5", {}, "4142 0000 0000"),
            ("AB", "string:5", {"padding": " "}, "4142 2020 2000"),
            ("AB", "string:4", {"padding": "\xff", "encoding": "latin-1"}, "4142 FFFF"),
            ("\xe4", "string:2", {"encoding": "latin-1"}, "E400"),
            ("\xe4", "string:2", {"encoding": "utf-8"}, "C3A4"),
            ("\u20ac", "string:4", {"encoding": "utf-8"}, "E282 AC00"),
            ("A", "string:4", {"encoding": "utf-16-be"}, "0041 0000"),
            ("A", "string:4", {"encoding": "utf-16-le"}, "4100 0000"),
            ("\u0100", "string:4", {"encoding": "utf-16-be"}, "0100 0000"),
            ("A", "string:4", {"encoding": "utf-16-le", "padding": " "}, "4100 2000"),
            ("A", "string:4", {"encoding": "utf-16-le", "order": "BADC"}, "0041 0000"),
            ("\u6f22", "string:4", {"encoding": "shift-jis"}, "8ABF 0000"),
            ("AB\0C", "string:6", {}, "4142 0043 0000"),
            ("ABC", "string:3", {"order": "BADC"}, "4241 0043"),
            ("ABC", "string:3", {"order": "DCBA"}, "4241 0043"),
            ("ABC", "string:3", {"order": "CDAB"}, "4142 4300"),
            ("A" * 250, "string:250", {}, " ".join(["4141"] * 125)),
        ],
    )
    def test_encodings_and_padding(
        self, value: str, name: str, options: dict[str, str], registers: str
    ) -> None:
        assert encode(value, name, **options) == words(registers)
        assert decode(words(registers), name, **options) == value

    def test_mark_that_begins_utf_16_is_not_repeated_in_padding(self) -> None:
        registers = encode("A", "string:8", encoding="utf-16")
        assert registers[2:] == [0, 0]
        assert decode(registers, "string:8", encoding="utf-16") == "A"

    def test_odd_string_does_not_look_at_the_last_byte(self) -> None:
        assert decode(words("4142 43FF"), "string:3") == "ABC"
        assert decode(words("4241 FF43"), "string:3", order="BADC") == "ABC"

    def test_only_padding_at_the_end_is_cut(self) -> None:
        assert decode(words("2041 2042 2020"), "string:6", padding=" ") == " A B"
        assert decode(words("4100 4200"), "string:4") == "A\0B"
        assert decode(words("4120 0000"), "string:4") == "A "
        assert decode(words("0000 0000"), "string:4") == ""

    @each_case(
        ("value", "name", "options", "named"),
        [
            ("ABC", "string:2", {}, r"value must have 0\.\.2 bytes in ascii, not 'ABC' with 3"),
            ("A" * 251, "string:250", {}, "with 251"),
            ("\u20ac", "string:2", {"encoding": "utf-8"}, r"0\.\.2 bytes in utf-8, not .* with 3"),
            ("A\xe4", "string:2", {"encoding": "utf-8"}, "with 3"),
            ("AB", "string:3", {"encoding": "utf-16-le"}, r"0\.\.3 bytes in utf-16-le"),
            ("A", "string:3", {"encoding": "utf-16-le"}, "leaves 1 bytes of 3"),
            ("A", "string:4", {"encoding": "utf-8", "padding": "\xe4"}, "leaves 3 bytes of 4"),
            ("\xe4", "string:2", {}, "value must be ascii, not '\xe4'"),
            ("\u20ac", "string:2", {"encoding": "latin-1"}, "value must be latin-1, not"),
            ("\ud800", "string:4", {"encoding": "utf-8"}, "value must be utf-8, not"),
        ],
    )
    def test_text_that_does_not_fit_is_never_cut(
        self, value: str, name: str, options: dict[str, str], named: str
    ) -> None:
        with pytest.raises(ValueError, match=named):
            encode(value, name, **options)

    @each_case("value", [None, 1, b"AB", ["A"], True])
    def test_text_is_a_string(self, value: Any) -> None:
        with pytest.raises(TypeError, match=r"^value must be a string, not "):
            encode(value, "string:4")

    @each_case(
        ("registers", "name", "encoding", "named"),
        [
            ("80FF", "string:2", "ascii", r"registers\[0:1\] hold no string:2: 80 FF is no ascii"),
            ("41E2 8200", "string:3", "utf-8", "hold no string:3: 41 E2 82 is no utf-8"),
            ("4100 42FF", "string:3", "utf-16-le", "41 00 42 is no utf-16-le"),
            ("00D8 4100", "string:4", "utf-16-le", "00 D8 41 00 is no utf-16-le"),
        ],
    )
    def test_character_cut_in_the_middle_is_an_error(
        self, registers: str, name: str, encoding: str, named: str
    ) -> None:
        with pytest.raises(ValueError, match=named):
            decode(words(registers), name, encoding=encoding)

    def test_every_encoding_of_the_list_is_one_of_python(self) -> None:
        for encoding in values.ENCODINGS:
            assert codecs.lookup(encoding).encode("A")
            text = values.value_type("string:40", encoding=encoding)
            assert text.decode(text.encode("ABC 123")) == "ABC 123"

    @each_case(
        "encoding", ["Latin-1", "ISO-8859-15", "UTF8", "windows-1252", "Shift_JIS", "us-ascii"]
    )
    def test_encodings_go_by_all_their_names(self, encoding: str) -> None:
        text = values.value_type("string:4", encoding=encoding)
        assert text.encode("AB") == [0x4142, 0]

    @each_case(
        "encoding",
        ["punycode", "idna", "unicode_escape", "utf-7", "undefined", "latin-1\0", "l\xe4tin-1"],
    )
    def test_slow_and_odd_encodings_are_none(self, encoding: str) -> None:
        """These need time that grows with the square of the length of a text, or an import."""
        with pytest.raises(ValueError, match=r"^encoding must be ascii, latin-1, .*, not '"):
            values.value_type("string:4", encoding=encoding)

    @each_case(
        ("options", "error", "named"),
        [
            ({"encoding": "no-such"}, ValueError, "encoding must be .*, not 'no-such'"),
            ({"encoding": "rot13"}, ValueError, "encoding must be .*, not 'rot13'"),
            ({"encoding": "hex"}, ValueError, "encoding must be .*, not 'hex'"),
            ({"padding": ""}, ValueError, "padding must be one character, not ''"),
            ({"padding": "  "}, ValueError, "padding must be one character, not '  '"),
            ({"padding": "\xff"}, ValueError, "padding must be ascii"),
            ({"encoding": 8}, TypeError, "encoding must be a string, not int"),
            ({"encoding": None}, TypeError, "encoding must be a string, not NoneType"),
            ({"padding": b"\0"}, TypeError, "padding must be a string, not bytes"),
            ({"padding": 0}, TypeError, "padding must be a string, not int"),
            ({"fill": " "}, TypeError, "fill"),
        ],
    )
    def test_no_such_encoding_or_padding(
        self, options: dict[str, Any], error: type[Exception], named: str
    ) -> None:
        with pytest.raises(error, match=named):
            value_type("string:4", **options)

    @settings(max_examples=80)
    @given(
        st.text(max_size=20),
        st.integers(1, 40),
        st.sampled_from(["ascii", "latin-1", "utf-8", "utf-16", "utf-16-be", "utf-32-le", "cp932"]),
        st.sampled_from(["\0", " "]),
        st.sampled_from(list(ORDERS)),
    )
    def test_text_comes_back_whole_or_is_refused(
        self, value: str, size: int, encoding: str, padding: str, order: str
    ) -> None:
        options = {"encoding": encoding, "padding": padding, "order": order}
        try:
            registers = encode(value, f"string:{size}", **options)
        except ValueError:
            return
        assert len(registers) == (size + 1) // 2
        back = value.encode(encoding).decode(encoding).rstrip(padding)
        assert decode(registers, f"string:{size}", **options) == back


class TestMany:
    @each_order
    @each_case("name", [*NUMBERS, "string:5"])
    @settings(max_examples=10)
    @given(st.data())
    def test_values_lie_one_after_the_other(
        self, name: str, order: str, data: st.DataObject
    ) -> None:
        given_values = data.draw(st.lists(strategy(name), max_size=5))
        registers = encode_many(given_values, name, order=order)
        assert registers == [
            word for value in given_values for word in encode(value, name, order=order)
        ]
        assert same(decode_many(registers, name, order=order), given_values)

    def test_known_values(self) -> None:
        assert encode_many([1, -1], "int32", order="CDAB") == words("0001 0000 FFFF FFFF")
        assert decode_many(words("4142 4300 4400 0000"), "string:4") == ["ABC", "D"]
        assert encode_many((at for at in (1, 2)), "bcd16") == [1, 2]
        assert encode_many(["A", "BC"], "string:2", padding=" ") == words("4120 4243")

    def test_none_are_none(self) -> None:
        assert encode_many([], "float64") == []
        assert decode_many([], "float64") == []

    @each_case(
        ("given_values", "name", "error", "named"),
        [
            ([1, 2, 40000], "int16", ValueError, r"^values\[2\] must be in -32768\.\.32767"),
            ([1, "x"], "int16", TypeError, r"^values\[1\] must be an integer"),
            ([0, 1e39], "float32", ValueError, r"^values\[1\] must be in -3\.4"),
            ([0, None], "float32", TypeError, r"^values\[1\] must be a number"),
            (["A", "ABC"], "string:2", ValueError, r"^values\[1\] must have 0\.\.2 bytes"),
            (["A", 5], "string:2", TypeError, r"^values\[1\] must be a string"),
            ([[0] * 16, [2] * 16], "bits16", ValueError, r"^values\[1\]\[0\] must be in 0\.\.1"),
            ([[0] * 16, [0]], "bits16", ValueError, r"^values\[1\] must hold 16 bits"),
            ([True] * 16, "bits16", TypeError, r"^values\[0\] must be a list, not bool"),
            ("ABC", "string:2", TypeError, "^values must be a list, not str"),
            (b"ABC", "int16", TypeError, "^values must be a list, not bytes"),
            ({1: 2}, "int16", TypeError, "^values must be a list, not dict"),
            (5, "int16", TypeError, "^values must be a list, not int"),
        ],
    )
    def test_bad_value_is_named(
        self, given_values: Any, name: str, error: type[Exception], named: str
    ) -> None:
        with pytest.raises(error, match=named):
            encode_many(given_values, name)

    @pytest.mark.parametrize(("name", "takes"), [("int32", 2), ("float64", 4), ("string:5", 3)])
    def test_registers_end_with_a_value(self, name: str, takes: int) -> None:
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


class TestReadings:
    @settings(max_examples=40)
    @given(st.lists(cell, min_size=1, max_size=6))
    def test_every_distinct_value_stands_once(self, registers: list[int]) -> None:
        expected: dict[tuple[str, str], str] = {}
        for name in [*NUMBERS, f"string:{2 * len(registers)}"]:
            for order in ("ABCD", "CDAB", "BADC", "DCBA"):
                try:
                    value = decode(registers, name, order=order)
                except ValueError:
                    continue
                expected.setdefault((name, repr(value)), order)
        found = readings(registers)
        assert {(name, repr(value)): order for name, order, value in found} == expected
        assert len(found) == len(expected)

    def test_known_registers(self) -> None:
        found = readings(words("0000 42C8"))
        assert ("float32", "CDAB", 100.0) in found
        assert ("uint32", "ABCD", 0x42C8) in found
        assert found[0] == ("int32", "ABCD", 0x42C8)
        assert found[0].type == "int32"
        assert found[0].order == "ABCD"
        assert found[0].value == 0x42C8
        assert not [reading for reading in found if reading.type == "bcd32"]

    def test_16_bits_have_two_orders(self) -> None:
        assert [reading[1:] for reading in readings([0x1234]) if reading.type == "uint16"] == [
            ("ABCD", 0x1234),
            ("BADC", 0x3412),
        ]
        assert [reading[1:] for reading in readings([0x1212]) if reading.type == "bcd16"] == [
            ("ABCD", 1212)
        ]

    @each_case("registers", ["FFFF FFFF", "7FC0 7FC0", "FFFF FFFF FFFF FFFF", "FFFF"])
    def test_nan_is_not_repeated(self, registers: str) -> None:
        found = readings(words(registers))
        assert [reading.order for reading in found if str(reading.value) == "nan"] == ["ABCD"]

    def test_signs_of_zero_are_distinct(self) -> None:
        kept = [str(value) for name, _, value in readings(words("8000 0000")) if name == "float32"]
        assert "-0.0" in kept

    def test_4_registers_are_64_bits_or_text(self) -> None:
        types = {reading.type for reading in readings(words("3132 3334 3536 3738"))}
        assert types == {"int64", "uint64", "float64", "bcd64", "bits64", "string:8"}

    @each_case("count", [3, 5, 6, 8, 124, 125])
    def test_other_counts_can_only_be_text(self, count: int) -> None:
        name = f"string:{2 * count}"
        assert readings([0x4142] * count) == [
            (name, "ABCD", "AB" * count),
            (name, "BADC", "BA" * count),
        ]
        assert readings([0xFFFF] * count) == []
        assert readings([0] * count) == [(name, "ABCD", "")]

    @pytest.mark.parametrize("count", [0, 126, 1000])
    def test_registers_are_1_to_125(self, count: int) -> None:
        with pytest.raises(
            ValueError, match=rf"the number of registers must be in 1\.\.125, not {count}"
        ):
            readings([0] * count)


class TestParseReference:
    @each_case("vector", rows(REFERENCES))
    def test_reference_of_a_worked_example(self, vector: Reference) -> None:
        parsed = parse_reference(vector.reference)
        assert parsed == (TABLES[vector.table], vector.address)
        assert parsed.table == TABLES[vector.table]
        assert parsed.address == vector.address

    def test_worked_examples_cover_every_table(self) -> None:
        assert {vector.table for vector in REFERENCES} == set(TABLES)

    @each_case("digit", ["0", "1", "3", "4"])
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
    def test_anything_else_is_refused_and_named(self, bad: str) -> None:
        with pytest.raises(ValueError, match="reference") as caught:
            parse_reference(bad)
        assert repr(bad) in str(caught.value)

    @each_case("bad", [40123, 123, 4.0, None, b"40123", True, ["40123"]])
    def test_only_text_is_a_reference(self, bad: Any) -> None:
        with pytest.raises(TypeError, match="must be a string"):
            parse_reference(bad)

    @settings(max_examples=75)
    @given(st.text("0123456789 +-_\u0661", max_size=7))
    def test_text_is_a_reference_or_a_value_error(self, text: str) -> None:
        try:
            table, address = parse_reference(text)
        except ValueError:
            return
        assert table == DIGITS[text[0]]
        assert int(text[1:]) - address == (0 if table == "file" else 1)

    def test_tables_are_those_of_mappings(self) -> None:
        assert REFERENCE_TABLES == DIGITS


# --- names and limits --------------------------------------------------------------------


def test_names_for_type_checkers_are_all_there_are() -> None:
    others = {*get_args(NumberType), *get_args(BitsType), *get_args(TimeType)}
    texts = {*get_args(get_args(TextType)[0])}
    assert {name for name in texts if not value_type(name).is_text} == {"eui48"}
    assert others | {"eui48"} == set(TYPES)
    assert sum(len(get_args(each)) for each in get_args(TypeName)) < 60  # errors list all of them
    assert set(get_args(Order)) == set(ORDERS)


def test_sizes_that_type_checkers_do_not_know_have_a_function() -> None:
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
def test_what_is_no_number_has_no_limits(name: str) -> None:
    assert value_type(name).limits is None


# --- MAC addresses -------------------------------------------------------------------------


def test_a_mac_address_is_text_behind_two_bytes_of_padding() -> None:
    kind = value_type("eui48")
    assert kind.decode([0xABCD, 0x0DD7, 0x4CC6, 0x448E]) == "0D:D7:4C:C6:44:8E"
    for text in ("0D:D7:4C:C6:44:8E", "0d-d7-4c-c6-44-8e"):
        assert kind.encode(text) == [0, 0x0DD7, 0x4CC6, 0x448E]
    assert value_type("eui48", order="CDAB").encode("0D:D7:4C:C6:44:8E")[0] == 0x448E


@each_case(
    ("value", "error"),
    [
        ("0D:D7:4C:C6:44", ValueError),
        ("0D:D7:4C:C6:44:8G", ValueError),
        ("0DD74CC6448E", ValueError),
        ("0D:D7:4C:C6:44:8E\n", ValueError),
        (0x0DD74CC6448E, TypeError),
    ],
)
def test_what_is_no_mac_address_is_refused(value: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match=r"value must be (like 0D:D7:4C:C6:44:8E|a string)"):
        value_type("eui48").encode(value)
