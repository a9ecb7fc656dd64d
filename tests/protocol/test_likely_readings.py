"""
The rule by which interpretations are sorted, judged by values as manuals and displays show them.

The registers are packed here, by `struct`.
"""

import struct

from libmodbus_py.protocol.values import readings
from tests.support.cases import each_case

EXAMPLES = [
    # What a device displays, in the type and the order of its manual.
    ("f", "ABCD", 230.1),  # Eastron SDM120 and SDM630: voltage, current, power
    ("f", "CDAB", 230.1),
    ("f", "BADC", 230.1),
    ("f", "DCBA", 230.1),
    ("f", "ABCD", 229.87654),
    ("f", "CDAB", 49.98765),
    ("f", "ABCD", 50.0),
    ("f", "CDAB", 50.0),
    ("f", "BADC", 49.98),
    ("f", "DCBA", 0.987),  # a power factor
    ("f", "ABCD", -1234.5),  # power that is fed in
    ("f", "CDAB", 123456.79),  # energy
    ("f", "DCBA", -12.75),
    ("f", "ABCD", 0.25),
    ("d", "ABCDEFGH", 50.02),
    ("d", "GHEFCDAB", 123456.789),
    ("d", "HGFEDCBA", -3.5),
    ("h", "AB", 215),  # 21.5 degrees Celsius
    ("h", "AB", -105),
    ("H", "AB", 2301),  # 230.1 V
    ("H", "BA", 4998),
    ("H", "AB", 50000),
    ("i", "ABCD", 123456),
    ("i", "CDAB", 123456),
    ("i", "CDAB", -2500),
    ("i", "BADC", 7654321),
    ("I", "DCBA", 1000000),
    ("I", "CDAB", 4294900),
    ("q", "ABCDEFGH", 1234567890),
    ("Q", "GHEFCDAB", 98765432),
]

NAMES = {"f": "float32", "d": "float64", "h": "int16", "i": "int32", "q": "int64"}


def registers_of(form: str, order: str, value: float) -> list[int]:
    """The registers of a value whose bytes stand in an order, A the most significant."""
    data = struct.pack(f">{form}", value)
    placed = bytes(data["ABCDEFGH".index(letter)] for letter in order)
    return [*struct.unpack(f">{len(data) // 2}H", placed)]


def rank(form: str, order: str, value: float) -> int:
    """The place of the value, from 0 on; of signed and unsigned types that are equal, of either."""
    kind = NAMES[form.lower()]
    (packed,) = struct.unpack(f">{form}", struct.pack(f">{form}", value))
    found = [
        (each.type.removeprefix("u"), each.value)
        for each in readings(registers_of(form, order, value))
    ]
    return found.index((kind, packed))


def test_28_of_30_public_examples_are_among_the_first_three() -> None:
    ranks = {row: rank(*row) for row in EXAMPLES}
    assert len(ranks) == 30
    behind = {row: place for row, place in ranks.items() if place > 2}
    assert len(behind) <= 2, behind


@each_case(
    ("registers", "first"),
    [
        ([0x4142, 0x4344, 0x2031], ("string:6", "ABCD", "ABCD 1")),
        ([0xFFFF, 0xFFFB], ("int32", "ABCD", -5)),
        ([0x4366, 0x199A], ("float32", "ABCD", 230.10000610351562)),
    ],
)
def test_the_most_plausible_interpretation_is_the_first(
    registers: list[int], first: tuple[str, str, object]
) -> None:
    assert readings(registers)[0] == first


@each_case("registers", [[0x4142], [0x0102, 0x0304], [0x1234, 0x5678, 0x1111, 0x2222]])
def test_bits_are_the_last(registers: list[int]) -> None:
    are_bits = [each.type.startswith("bits") for each in readings(registers)]
    assert are_bits == sorted(are_bits)
    assert are_bits[-1]
