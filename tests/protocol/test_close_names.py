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
def test_an_option_is_suggested_for_the_name_in_another_package(name: str, end: str) -> None:
    *others, name = name.split()
    names = [*KNOWN, *others]
    assert close_option(name, names) == end
    error = unknown_option(name, names)
    assert str(error) == f"'{name}' must be one of {', '.join(names)}{end}"


def test_up_to_three_names_are_suggested() -> None:
    names = [f"point_{entry}" for entry in "abcd"]
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


def test_an_unknown_argument_is_refused_with_a_similar_name() -> None:
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


CHIPKIN = "chipkin.com: How Real and 32-bit Data is Encoded in Modbus RTU Messages, 123456.00"
EXAMPLES = [
    # What a device displays, with its scale, in the type and the order of its public manual.
    ("Eastron SDM630 Modbus V2 User Manual, 30001: volts", "f", "ABCD", 230.2),
    ("Eastron SDM72D-M User Manual V1.5, 30007: current", "f", "ABCD", 4.731),
    ("Eastron SDM630, 30343 in mbmd sdm.go: kWh", "f", "ABCD", 1234.567),
    ("Janitza UMG 96 Modbus address list, 19000: volts", "f", "ABCD", 229.87654),
    ("Janitza UMG 96 Modbus address list, 19026: watts fed in", "f", "ABCD", -1234.5),
    ("Schneider iEM3155, DOCA0005EN 3110 in Tasmota xnrg_16: Hz", "f", "ABCD", 49.98),
    ("Siemens PAC2200 in mbmd pac2200.go, 1: volts", "f", "ABCD", 231.43),
    ("Fronius SunSpec float model 113, 40092: watts", "f", "ABCD", 4321.5),
    (CHIPKIN, "f", "CDAB", 123456.0),
    (CHIPKIN, "f", "BADC", 123456.0),
    (CHIPKIN, "f", "DCBA", 123456.0),
    ("TUF-2000F User Manual 5.1.1, 0001: m3/h", "f", "CDAB", 1.2345678),
    ("SUTO S401 manual 9.3, little-endian: m3/h", "f", "DCBA", 12.75),
    ("Siemens PAC2200 in mbmd pac2200.go, 801: Wh", "d", "ABCDEFGH", 123456.789),
    ("myscada.org: 32-bit registers, word swap, of 64 bits", "d", "GHEFCDAB", 50.02),
    ("Carlo Gavazzi EM24 in mbmd carlogavazzi-em24.go, 0: 0.1 V", "i", "CDAB", 2301),
    ("Carlo Gavazzi EM340 in mbmd carlogavazzi-ex3x0.go, 40: 0.1 W", "i", "CDAB", -25000),
    ("Morningstar SunSaver MPPT Modbus Specification: 13D8 0022, hours", "I", "CDAB", 2233304),
    ("SUTO S401 manual 9.3, little-endian: m3", "I", "DCBA", 1000000),
    ("Huawei SUN2000 in huawei-solar-lib registers.py, 32080: W", "i", "ABCD", 4321),
    ("Huawei SUN2000 in huawei-solar-lib registers.py, 32106: 0.01 kWh", "I", "ABCD", 1234567),
    ("Growatt Modbus Protocol II in ESPHome growatt_solar, 35: 0.1 W", "I", "ABCD", 43215),
    ("SMA Modbus interface, 30775: W drawn", "i", "ABCD", -12),
    ("ABB B23 in mbmd abb.go, 0x5000: 0.01 kWh", "Q", "ABCDEFGH", 1234567),
    ("Socomec Diris B-10L 551174A, 0x1043: 0.1 Wh", "Q", "ABCDEFGH", 98765432),
    ("Schneider iEM3155, DOCA0005EN 3204: Wh", "q", "ABCDEFGH", 12345678),
    ("SunSpec model 103, PhVphA: 0.1 V", "H", "AB", 2301),
    ("Socomec Diris B-10L 551174A, 0x2503: 0.01 degrees Celsius", "h", "AB", -1050),
    ("Victron CCGX-Modbus-TCP-register-list, 820: W fed in", "h", "AB", -2044),
    ("myscada.org: 32-bit registers, byte swap, of 16 bits: 0.01 Hz", "H", "BA", 4998),
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
        (reading.type.removeprefix("u"), reading.value)
        for reading in readings(registers_of(form, order, value))
    ]
    return candidates.index((kind, number))


def test_public_examples_rank_among_the_first_three() -> None:
    ranks = {row: rank(*row[1:]) for row in EXAMPLES}
    assert len(ranks) == 30
    assert {row: place for row, place in ranks.items() if place > 2} == {}


@each_case("order", ["ABCD", "CDAB", "BADC", "DCBA"])
@each_case("value", [230.0, 100.0, 12.75, 50.0, 400.0, -5.5])
def test_round_floats_rank_before_integers(order: str, value: float) -> None:
    assert rank("f", order, value) <= 2


@each_case(
    ("registers", "first"),
    [
        ([0x4142, 0x4344, 0x2031], ("string:6", "ABCD", "ABCD 1")),
        ([0xFFFF, 0xFFFB], ("int32", "ABCD", -5)),
        ([0x4366, 0x199A], ("float32", "ABCD", 230.10000610351562)),
    ],
)
def test_the_most_plausible_reading_ranks_first(registers, first) -> None:
    assert readings(registers)[0] == first


@each_case("registers", [[0x4142], [0x0102, 0x0304], [0x1234, 0x5678, 0x1111, 0x2222]])
def test_readings_as_bits_rank_last(registers: list[int]) -> None:
    are_bits = [reading.type.startswith("bits") for reading in readings(registers)]
    assert are_bits == sorted(are_bits)
    assert are_bits[-1]
