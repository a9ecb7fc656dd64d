"""Values of every type, and the calls that lay them into registers and back."""

from typing import Any

from hypothesis import strategies as st

from libmodbus_py.protocol.values import value_type
from tests.support.cases import each_case


def encode(value: Any, type: str, **options: Any) -> list[int]:
    return value_type(type, **options).encode(value)


def encode_many(values: Any, type: str, **options: Any) -> list[int]:
    return value_type(type, **options).encode_many(values)


def decode(registers: Any, type: str, **options: Any) -> Any:
    return value_type(type, **options).decode(registers)


def decode_many(registers: Any, type: str, **options: Any) -> list[Any]:
    return value_type(type, **options).decode_many(registers)


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
