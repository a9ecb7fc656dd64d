"""Text in registers: encodings, padding, sizes, and MAC addresses."""

import codecs
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import values
from libmodbus_py.protocol.values import ORDERS, value_type
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.values import decode, encode, words


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
            ("ABC", "string:3", {"order": "BADC"}, "4241 0043"),
            ("ABC", "string:3", {"order": "DCBA"}, "4241 0043"),
            ("ABC", "string:3", {"order": "CDAB"}, "4142 4300"),
            ("A" * 250, "string:250", {}, " ".join(["4141"] * 125)),
        ],
    )
    def test_texts_keep_their_encoding_and_padding(self, value, name, options, registers) -> None:
        assert encode(value, name, **options) == words(registers)
        assert decode(words(registers), name, **options) == value

    def test_mark_that_begins_utf_16_is_not_repeated_in_padding(self) -> None:
        registers = encode("A", "string:8", encoding="utf-16")
        assert registers[2:] == [0, 0]
        assert decode(registers, "string:8", encoding="utf-16") == "A"

    def test_strings_of_odd_length_ignore_the_last_byte(self) -> None:
        assert decode(words("4142 43FF"), "string:3") == "ABC"
        assert decode(words("4241 FF43"), "string:3", order="BADC") == "ABC"

    def test_only_padding_at_the_end_is_cut(self) -> None:
        assert decode(words("2041 2042 2020"), "string:6", padding=" ") == " A B"
        assert decode(words("4120 0000"), "string:4") == "A "
        assert decode(words("0000 0000"), "string:4") == ""

    @each_case(
        ("registers", "options", "value"),
        [
            ("4100 4200", {}, "A"),
            ("564E 00FF 0700", {}, "VN"),
            ("0041 4243", {}, ""),
            ("4120 0042", {"padding": " "}, "A"),
            ("4142 E400", {"encoding": "utf-8", "order": "BADC"}, "BA"),
            ("0100 0041 0000 D800", {"encoding": "utf-16-be"}, "\u0100A"),
            ("4100 0001 0000 00D8", {"encoding": "utf-16-le"}, "A\u0100"),
            ("0000 0041 0000 0000 FFFF FFFF", {"encoding": "utf-32-be"}, "A"),
        ],
    )
    def test_text_ends_at_its_first_nul(self, registers, options, value) -> None:
        cells = words(registers)
        assert decode(cells, f"string:{2 * len(cells)}", **options) == value

    @each_case("value", ["A\0B", "\0", "A\0"])
    def test_text_with_a_nul_is_refused(self, value: str) -> None:
        with pytest.raises(ValueError, match=r"^value must be without NUL, which ends it: 'A?"):
            encode(value, "string:8")

    def test_text_that_does_not_fit_is_never_cut(self, refused: Refused) -> None:
        refused("too_long_texts.txt", lambda case: encode(case[0], case[1], **case[2]))

    @each_case("value", [None, 1, b"AB", ["A"], True])
    def test_a_text_must_be_a_string(self, value: Any) -> None:
        with pytest.raises(TypeError, match=r"^value must be a string, not "):
            encode(value, "string:4")

    @each_case(
        ("registers", "name", "encoding", "message"),
        [
            ("80FF", "string:2", "ascii", r"registers\[0:1\] hold no string:2: 80 FF is no ascii"),
            ("41E2 8200", "string:3", "utf-8", "hold no string:3: 41 E2 82 is no utf-8"),
            ("4100 42FF", "string:3", "utf-16-le", "41 00 42 is no utf-16-le"),
            ("00D8 4100", "string:4", "utf-16-le", "00 D8 41 00 is no utf-16-le"),
        ],
    )
    def test_character_cut_in_the_middle_is_an_error(self, registers, name, encoding, message):
        with pytest.raises(ValueError, match=message):
            decode(words(registers), name, encoding=encoding)

    def test_every_encoding_of_the_list_is_one_of_python(self) -> None:
        for encoding in values.ENCODINGS:
            assert codecs.lookup(encoding).encode("A")
            text = values.value_type("string:40", encoding=encoding)
            assert text.decode(text.encode("ABC 123")) == "ABC 123"

    @each_case(
        "encoding", ["Latin-1", "ISO-8859-15", "UTF8", "windows-1252", "Shift_JIS", "us-ascii"]
    )
    def test_encodings_are_accepted_by_all_their_names(self, encoding: str) -> None:
        text = values.value_type("string:4", encoding=encoding)
        assert text.encode("AB") == [0x4142, 0]

    @each_case(
        "encoding",
        ["punycode", "idna", "unicode_escape", "utf-7", "undefined", "latin-1\0", "l\xe4tin-1"],
    )
    def test_slow_and_odd_encodings_are_refused(self, encoding: str) -> None:
        """These need time that grows with the square of the length of a text, or an import."""
        with pytest.raises(ValueError, match=r"^encoding must be ascii, latin-1, .*, not '"):
            values.value_type("string:4", encoding=encoding)

    def test_an_unknown_encoding_or_padding_is_refused(self, refused: Refused) -> None:
        refused("wrong_encodings.txt", lambda options: value_type("string:4", **options))

    @settings(max_examples=80)
    @given(
        st.text(max_size=20),
        st.integers(1, 40),
        st.sampled_from(["ascii", "latin-1", "utf-8", "utf-16", "utf-16-be", "utf-32-le", "cp932"]),
        st.sampled_from(["\0", " "]),
        st.sampled_from(list(ORDERS)),
    )
    def test_text_decodes_to_what_was_encoded_or_is_refused(
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


def test_a_mac_address_follows_two_bytes_of_padding() -> None:
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
def test_an_invalid_mac_address_is_refused(value: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match=r"value must be (like 0D:D7:4C:C6:44:8E|a string)"):
        value_type("eui48").encode(value)
