"""Names that are nearly right, and what values are likely to mean."""

import struct

import pytest

from libmodbus_py.protocol.mistakes import close_option, close_to, named_arguments, unknown_option
from libmodbus_py.protocol.values import readings
from tests.support.cases import each_case

KNOWN = ["unit", "timeout", "retries"]


@each_case(
    ("name", "end"),
    [
        ("slave", "; did you mean unit?"),
        ("SLAVE_ID", "; did you mean unit?"),
        ("retry_count", "; did you mean retries?"),
        ("timeuot", "; did you mean timeout?"),
        (
            "url baud",
            "; baudrate is part of the URL of a serial port: rtu:///dev/ttyUSB0?baudrate=...",
        ),
        (
            "url parity",
            "; parity is part of the URL of a serial port: rtu:///dev/ttyUSB0?parity=...",
        ),
        ("parity", ""),
        ("endian", ""),
        ("xyz", ""),
    ],
)
def test_an_option_is_named_by_what_other_packages_call_it(name: str, end: str) -> None:
    *others, name = name.split()
    names = [*KNOWN, *others]
    assert close_option(name, names) == end
    error = unknown_option(name, names)
    assert str(error) == f"'{name}' must be one of {', '.join(names)}{end}"


def test_up_to_three_names_are_close() -> None:
    names = [f"point_{each}" for each in "abcd"]
    hint = close_to("point_x", names, "points.")
    assert hint.startswith("; did you mean points.point_")
    assert hint.count("points.") == 3
    assert close_to(7, names) == close_to("far", names) == ""


@named_arguments
class Valve:
    def __init__(self, unit: int, *, timeout: float = 1.0) -> None:
        self.unit = unit - 0
        self.timeout = timeout


@named_arguments
class Tank:
    def __init__(self, unit: int, **options: object) -> None:
        self.options = options


def test_an_argument_that_a_class_does_not_take_is_refused_with_a_close_name() -> None:
    assert (Valve(3).unit, Valve(3, timeout=2).timeout) == (3, 2)
    with pytest.raises(TypeError, match="'slave' must be one of unit, timeout; did you mean unit"):
        Valve(slave=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"^'time_out' must be .* did you mean timeout"):
        Valve(3, time_out=2)  # type: ignore[call-arg]


def test_other_mistakes_are_errors_of_python() -> None:
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'unit'"):
        Valve()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unsupported operand"):
        Valve("3")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="there is no 'slave'; did you mean unit"):
        Tank(slave=3)  # type: ignore[call-arg]
    assert Tank(3, slave=4).options == {"slave": 4}


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
    (number,) = struct.unpack(f">{form}", struct.pack(f">{form}", value))
    candidates = [
        (each.type.removeprefix("u"), each.value)
        for each in readings(registers_of(form, order, value))
    ]
    return candidates.index((kind, number))


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
def test_the_most_plausible_interpretation_is_the_first(registers, first) -> None:
    assert readings(registers)[0] == first


@each_case("registers", [[0x4142], [0x0102, 0x0304], [0x1234, 0x5678, 0x1111, 0x2222]])
def test_bits_are_the_last(registers: list[int]) -> None:
    are_bits = [each.type.startswith("bits") for each in readings(registers)]
    assert are_bits == sorted(are_bits)
    assert are_bits[-1]
