"""What raw values mean: no value, states, bits, parts of registers, scales of the device."""

import math
import struct
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from libmodbus_py import NoValue, Point, RegisterMap
from libmodbus_py.maps.meaning import DecodedValue as Value
from libmodbus_py.maps.point_plan import scale_mistakes, sources_of
from tests.support.cases import each_case
from tests.support.golden import Refused

H = "holding_registers"


def point(name: str = "it", **keys: Any) -> Point:
    return Point(**{"name": name, "table": H, "address": 0, **keys})


MISSING = Value(None, "bad", "Missing")
IMPLAUSIBLE = Value(None, "bad", "Implausible")
INVALID = Value(None, "bad", "InvalidData")

# "Not implemented" of each type as the SunSpec Device Information Model Specification has it.
SUNSPEC = [
    ("int16", [0x8000]),
    ("uint16", [0xFFFF]),
    ("int32", [0x8000, 0]),
    ("uint32", [0xFFFF, 0xFFFF]),
    ("int64", [0x8000, 0, 0, 0]),
    ("uint64", [0xFFFF] * 4),
    ("float32", [0x7FC0, 0]),
    ("float64", [0x7FF8, 0, 0, 0]),
    ("bits16", [0xFFFF]),
    ("bits32", [0xFFFF, 0xFFFF]),
    ("string:8", [0, 0, 0, 0]),
]


@each_case(("type", "cells"), SUNSPEC)
def test_the_sunspec_value_not_implemented_decodes_to_no_value(type: str, cells: list[int]) -> None:
    point_ = point(type=type, missing="sunspec")
    assert point_.judge(cells) == MISSING
    assert point_.decode([0x4100] + [0x4101] * (len(cells) - 1)) is not None


# The arguments of a point, its cells, and their value.
MEANT = [
    ({"missing": 0xFFFF, "scale": 0.1}, [0xFFFF], MISSING),
    ({"missing": 0xFFFF, "scale": 0.1}, [0xFFFE], Value(6553.4)),
    ({"missing": [0, 65535]}, [0], MISSING),
    ({"missing": 0x8000, "type": "int16"}, [0x8000], MISSING),
    ({"missing": -32768, "type": "int16"}, [0x8000], MISSING),
    ({"missing": 0, "type": "uint32"}, [0, 0], MISSING),
    ({"missing": -9999.9, "type": "float32"}, [0xC61C, 0x3F9A], MISSING),
    ({"type": "float32"}, [0x4366, 0x199A], Value(230.1)),
    ({"type": "float32", "order": "CDAB"}, [0x199A, 0x4366], Value(230.1)),
    ({"type": "float32", "scale": 0.1}, [0x4366, 0x199A], Value(23.01)),
    ({"type": "float32", "offset": -0.1}, [0x4366, 0x199A], Value(230)),
    ({"type": "float16"}, [0x5B31], Value(230.1)),
    ({"missing": 0, "type": "unix32"}, [0, 0], MISSING),
    ({"missing": 3, "bit": "4..7"}, [0x3A], MISSING),
    ({"missing": 65535, "count": 2}, [65535, 7], Value([None, 7], "good", "Missing")),
    ({"missing": 65535, "count": 2}, [65535, 65535], Value([None, None], "bad", "Missing")),
    ({"plausible_maximum": 300, "scale": 0.1}, [3000], Value(300)),
    ({"plausible_maximum": 300, "scale": 0.1}, [3001], IMPLAUSIBLE),
    ({"plausible_minimum": -5, "type": "int16"}, [0xFFFA], IMPLAUSIBLE),
    ({"plausible_minimum": 1, "type": "float32"}, [0x7FC0, 0], MISSING),
    ({"plausible_minimum": 1, "type": "float32"}, [0x7F80, 0], Value(math.inf)),
    ({"plausible_maximum": 1, "type": "float32"}, [0x7F80, 0], IMPLAUSIBLE),
    ({"states": {0: "off", 1: "on"}}, [1], Value("on")),
    ({"states": {0: "off", 1: "on"}}, [2], Value(2)),
    ({"states": {"-1": "none", "0x10": "much"}, "type": "int16"}, [0xFFFF], Value("none")),
    ({"states": {0: "off", 1: "on"}, "missing": 255}, [255], MISSING),
    ({"states": {0: "off", "1..5": "on", "else": "?"}}, [5], Value("on")),
    ({"states": {0: "off", "1..5": "on", "else": "?"}}, [6], Value("?")),
    ({"states": {0: "off", "1..5": "on", 3: "hot"}}, [3], Value("hot")),
    ({"states": {0: "off", "1..5": "on", 3: "hot"}}, [6], Value(6)),
    ({"states": {1: "on", 2: "on", "0x10..": "on"}}, [0xFFFF], Value("on")),
    ({"states": {"..-1": "below", "0..": "above"}, "type": "int16"}, [0xFFFF], Value("below")),
    ({"states": {1.5: "half", "2..2.5": "more"}, "type": "float32"}, [0x3FC0, 0], Value("half")),
    ({"states": {"0.1": "a", "0.2..": "b"}, "type": "float32"}, [0x3DCC, 0xCCCD], Value("a")),
    ({"states": {"0.1": "a", "..0.2": "b"}, "type": "float32"}, [0x3E4C, 0xCCCD], Value("b")),
    ({"states": {1: "a"}, "type": "float32", "order": "CDAB"}, [0, 0x3F80], Value("a")),
    ({"states": {"0": "a", "else": "b"}, "type": "float32"}, [0x7FC0, 0], MISSING),
    ({"states": {0: "shut", "else": "open"}, "table": "coils"}, [True], Value("open")),
    ({"states": {"0..7": "low", "else": "high"}, "byte": "low"}, [0x1208], Value("high")),
    ({"states": {0: "shut", 1: "open"}, "table": "coils"}, [True], Value("open")),
    ({"states": {0: "shut", 1: "open"}, "bit": 3}, [8], Value("open")),
    ({"bits": {0: "door", "4..7": "mode"}}, [0x51], Value({"door": True, "mode": 5})),
    ({"bits": {31: "top", 0: "low"}, "type": "uint32"}, [0x8000, 0],
     Value({"top": True, "low": False})),
    ({"bits": {0: "a"}, "type": "bits16", "missing": "sunspec"}, [0xFFFF], MISSING),
    ({"bit": 3}, [8], Value(True)),
    ({"bit": 3}, [0xFFF7], Value(False)),
    ({"bit": "4..7"}, [0x1234], Value(3)),
    ({"bit": "4..7", "scale": 0.5}, [0x1234], Value(1.5)),
    ({"bit": 8, "order": "BADC"}, [1], Value(True)),
    ({"byte": "high"}, [0x1234], Value(0x12)),
    ({"byte": "low"}, [0x1234], Value(0x34)),
    ({"byte": "low", "type": "int16"}, [0x12FE], Value(-2)),
    ({"type": "int8"}, [0x12FE], Value(-2)),
    ({"type": "uint8", "order": "BADC"}, [0x12FE], Value(0x12)),
    ({"type": "uint8", "byte": "high", "scale": 0.5}, [0x1234], Value(9)),
    ({"type": "int8", "missing": 0x80}, [0x1280], MISSING),
    ({"type": "int24", "missing": 0x80_0000}, [0x0080, 0], MISSING),
    ({"type": "mod10k32", "missing": 0x8000_8000, "scale": 0.1}, [0x8000, 0x8000], MISSING),
    ({"type": "sbcd16", "missing": 0xFFFF}, [0xFFFF], MISSING),
    ({"type": "sbcd16", "missing": -1}, [0xF001], MISSING),
    ({"type": "uint48", "bit": 47, "order": "CDAB"}, [0, 0, 0x8000], Value(True)),
    ({"type": "y2k32", "missing": 0}, [0, 0], MISSING),
    ({"type": "iec870"}, [0xFFFF] * 4, Value(None, "bad", "InvalidTime")),
    ({"type": "bcd16"}, [0x000F], INVALID),
    ({"type": "bcd16", "scale": 0.1}, [0xFFFF], INVALID),
    ({"type": "bcd16", "count": 2}, [0x12, 0xA0], Value([12, None], "good", "InvalidData")),
    ({"type": "bcd16", "missing": 0xFFFF}, [0xFFFF], MISSING),
    ({"type": "bcd16", "missing": [0xFFFF, 9999]}, [0x9999], MISSING),
    ({"type": "bcd16", "missing": [0xFFFF, 9999]}, [0x000F], INVALID),
    ({"type": "bcd32", "missing": 0xFFFF_FFFF, "order": "CDAB"}, [0xFFFF, 0xFFFF], MISSING),
    ({"type": "unix64", "missing": 1 << 63}, [0x8000, 0, 0, 0], MISSING),
    ({"type": "string:4"}, [0x4180, 0], INVALID),
    ({"type": "string:4"}, [0x4100, 0x80FF], Value("A")),
    ({"type": "string:4", "missing": "sunspec"}, [0x0041, 0xFF00], MISSING),
    ({"type": "unix32"}, [0, 60], Value(datetime(1970, 1, 1, 0, 1, tzinfo=UTC))),
    ({"type": "int16", "scale_from": "sf"}, [5], Value(None, "bad", "BadScale")),
]  # fmt: skip


@each_case(("keys", "cells", "judged"), MEANT)
def test_invalid_values_have_reasons(keys: dict[str, Any], cells: list[Any], judged: Value) -> None:
    point_ = point(**keys)
    assert point_.judge(cells) == judged
    assert point_.decode(cells) == judged.value


@given(st.integers(0, 0xFFFF_FFFF))
@example(0x7F7F_FFFF)  # the largest
@example(1)
def test_a_float_is_the_shortest_decimal_of_its_registers(bits: int) -> None:
    cells = [bits >> 16, bits & 0xFFFF]
    value = point(type="float32").decode(cells)
    exactly = struct.unpack(">f", bits.to_bytes(4, "big"))[0]
    if value is None:
        assert math.isnan(exactly)
        return
    assert point(type="float32").encode(value) == cells
    shorter = (float(f"{exactly:.{digits}g}") for digits in range(1, len(repr(value))))
    assert value in [exactly, *shorter]
    assert len(repr(value)) <= len(repr(exactly))


def test_a_plan_and_its_points_decode_alike() -> None:
    cases = [row for row in MEANT if row[0].get("table", H) == H and "scale_from" not in row[0]]
    points, cells = [], []
    for at, (keys, some, _) in enumerate(cases):
        points.append(point(f"p{at}", address=len(cells), **keys))
        cells += some
    plan = RegisterMap(points).plan()
    answers = [cells[item.address : item.address + item.count] for item in plan.requests]  # type: ignore[attr-defined]
    verdicts = {f"p{at}": judged for at, (_, _, judged) in enumerate(cases)}
    assert plan.results(answers) == {name: judged.value for name, judged in verdicts.items()}
    results = plan.results(answers, return_exceptions=True)
    reasons = {name: item.reason for name, item in results.items() if isinstance(item, NoValue)}
    assert reasons == {name: item.reason for name, item in verdicts.items() if item.quality == "bad"
                       and item.value is None}  # fmt: skip
    assert str(results["p0"]) == "p0 has no value: the device says 65535"


SCALED = RegisterMap(
    [
        point("v", type="int16", scale_from="v_sf", missing="sunspec"),
        point("w", address=1, type="uint32", scale_from="v_sf", offset=-1),
        point("v_sf", address=3, type="int16", missing="sunspec"),
        point("energy", address=4, scale_from="ratio", scale_as="factor", scale=0.5),
        point("ratio", address=5),
        point("far", address=6, scale_from="ratio_of_far", scale_as="factor"),
        point("ratio_of_far", address=7, scale_from="v_sf"),
    ]
)


def scaled(cells: list[int], names: list[str] | None = None, **options: Any) -> dict[str, Any]:
    plan = SCALED.plan(names)
    answers = [cells[item.address : item.address + item.count] for item in plan.requests]  # type: ignore[attr-defined]
    return plan.results(answers, **options)


def test_a_point_can_be_the_scale_of_others() -> None:
    cells = [2305, 0, 700, 0xFFFF, 9, 40, 3, 20]
    assert scaled(cells) == {
        "v": 230.5, "w": 69.0, "v_sf": -1, "energy": 180, "ratio": 40, "far": 6.0,
        "ratio_of_far": 2.0,
    }  # fmt: skip
    assert repr(scaled([2305, 0, 7, 0, 9, 40, 3, 20])["v"]) == "2305"


def test_a_plan_reads_the_point_of_the_scale_too() -> None:
    plan = SCALED.plan(["far"])
    read = [(item.address, item.count) for item in plan.requests]  # type: ignore[attr-defined]
    assert read == [(3, 1), (6, 2)]
    assert plan.results([[0xFFFE], [3, 200]]) == {"far": 6}


# The register with the exponent, and the reason without a scaled value.
EXPONENTS = [
    (300, "v has no value: v_sf, which scales it, must hold a power of ten in -30..30, not 300"),
    (
        0xFED4,
        "v has no value: v_sf, which scales it, must hold a power of ten in -30..30, not -300",
    ),
    (0x8000, "v has no value: v_sf, which scales it, must hold a number, but has no value"),
]


@each_case(("cell", "reason"), EXPONENTS)
def test_a_value_without_a_scale_is_no_value(cell: int, reason: str) -> None:
    results = scaled([5, 0, 7, cell, 9, 40, 3, 20], return_exceptions=True)
    assert str(results["v"]) == reason
    assert results["v"].reason == results["w"].reason == results["far"].reason == "BadScale"
    assert results["energy"] == 180
    assert scaled([5, 0, 7, cell, 9, 40, 3, 20])["v"] is None


def test_a_factor_of_0_gives_no_value() -> None:
    assert scaled([5, 0, 7, 1, 9, 0, 3, 20], return_exceptions=True)["energy"].reason == "BadScale"


def test_cells_are_written_with_the_scale_of_the_device() -> None:
    requests = SCALED.writes({"v": 230.5}, sources={"v_sf": -1})
    assert [(item.address, item.value) for item in requests] == [(0, 2305)]  # type: ignore[attr-defined]
    assert SCALED.scale_sources({"v": 230.5, "far": 1}) == ["v_sf", "ratio_of_far"]
    with pytest.raises(NoValue, match="v has no value: v_sf, which scales it, must hold a number"):
        SCALED.writes({"v": 230.5})
    with pytest.raises(
        ValueError, match="v is scaled by v_sf, which must be written before, in a call"
    ):
        SCALED.writes({"v": 230.5, "v_sf": 0}, sources={"v_sf": 0})


# Points of a map, and what is wrong.
WRONG_SCALES = [
    ([point("a", scale_from="b")], r"a.scale_from: the map has no point 'b'"),
    ([point("a", scale_from="b"), point("b", address=1, scale_from="a")],
     "a.scale_from: leads back to a point: a, b, a"),
    ([point("a", scale_from="b"), point("b", address=1, count=2)], "'b' must be one number"),
    ([point("a", scale_from="b"), point("b", type="string:2")], "'b' must be one number"),
    ([point("a", scale_from="b"), point("b", access="write")], "'b' cannot be read"),
]  # fmt: skip


@each_case(("points", "message"), WRONG_SCALES)
def test_a_map_with_invalid_scales_is_refused(points: list[Point], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RegisterMap(points)


def test_a_map_with_invalid_keys_is_refused(refused: Refused) -> None:
    refused("wrong_meanings.txt", lambda keys: point(**keys))


PARTS = RegisterMap(
    [
        point("flag", bit=3),
        point("mode", bit="4..7", scale=0.5, maximum=5),
        point("high", address=1, byte="high"),
        point("low", address=1, byte="low"),
        point("wide", address=2, type="uint32", bits={0: "a", 31: "z", "8..11": "n"}),
        point("state", address=4, states={0: "off", 1: "on"}),
        point("whole", address=0),
        point("small", address=5, type="int8"),
        point("many", address=6, states={1: "on", 2: "on", 0: "off", "3..9": "bad", "else": "?"}),
        point("level", address=7, type="float32", states={"1.5": "half"}),
    ]
)

# What is written, and the requests: function, address, and what follows it (as in section 6.16
# of the specification: the bits that stay, the bits that are set).
WRITES = [
    ({"flag": True}, [(22, 0, 0xFFF7, 8)]),
    ({"flag": False}, [(22, 0, 0xFFF7, 0)]),
    ({"flag": 1, "mode": 2.5}, [(22, 0, 0xFF07, 0x58)]),
    ({"high": 0x12}, [(22, 1, 0x00FF, 0x1200)]),
    ({"high": 0x12, "low": 0x34}, [(6, 1, 0x1234)]),
    ({"wide": {"z": True}}, [(22, 2, 0x7FFF, 0x8000)]),
    ({"wide": {"a": False, "n": 5, "z": 1}}, [(22, 2, 0x7FFF, 0x8000), (22, 3, 0xF0FE, 0x0500)]),
    ({"state": "on"}, [(6, 4, 1)]),
    ({"state": 7}, [(6, 4, 7)]),
    ({"small": -2}, [(22, 5, 0xFF00, 0xFE)]),
    ({"many": "off"}, [(6, 6, 0)]),
    ({"many": 2}, [(6, 6, 2)]),
    ({"level": "half"}, [(16, 7, 2, 0x043F, 0xC000, 0)]),
]


def told(request: Any) -> tuple[int, ...]:
    data = request.encode()
    return (data[0], *(int.from_bytes(data[at : at + 2], "big") for at in range(1, len(data), 2)))


@each_case(("values", "requests"), WRITES)
def test_parts_of_registers_are_written(values: dict[str, Any], requests: list[tuple[int, ...]]):
    assert [told(write) for write in PARTS.writes(values)] == requests


def test_writes_of_parts_that_are_impossible_are_refused(refused: Refused) -> None:
    refused("wrong_writes.txt", PARTS.writes)


@given(st.integers(0, 0xFFFF), st.integers(0, 15), st.integers(0, 15), st.booleans())
def test_parts_of_registers_decode_as_encoded(cell: int, first: int, last: int, signed: bool):
    first, last = sorted((first, last))
    point_ = point(bit=f"{first}..{last}", type="int16" if signed else "uint16")
    value = point_.decode([cell])
    change = point_.change(value)
    assert change.masks is not None
    (bits,), (mask,) = change
    assert cell & mask == bits
    assert mask == sum(1 << at for at in range(first, last + 1))
    assert point_.decode(point_.encode(value)) == value


@given(st.integers(0, 0xFFFFFFFF), st.sampled_from(["ABCD", "CDAB", "BADC", "DCBA"]))
def test_named_bits_decode_to_what_was_encoded(number: int, order: str) -> None:
    names: dict[int | str, str] = {0: "a", "1..15": "b", 16: "c", "17..31": "d"}
    point_ = point(type="uint32", order=order, bits=names)
    cells = point(type="uint32", order=order).encode(number)
    assert point_.encode(point_.decode(cells)) == cells
    assert point_.change(point_.decode(cells)).masks == [0xFFFF, 0xFFFF]


class Counting(Mapping[str, Point]):
    """Points by name; `looked_up` counts how often one is looked up."""

    def __init__(self, *points: Point) -> None:
        self._points = {point.name: point for point in points}
        self.looked_up = 0

    def __getitem__(self, name: str) -> Point:
        self.looked_up += 1
        return self._points[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._points)

    def __len__(self) -> int:
        return len(self._points)


def chain(count: int, first: str | None = None) -> Counting:
    """Return points of which each is scaled by the one before, and the first by another one."""
    points = [Point("p0", H, 0, scale_from=first)]
    points += [Point(f"p{at}", H, at, scale_from=f"p{at - 1}") for at in range(1, count)]
    return Counting(*points)


def test_each_point_of_a_long_chain_of_scales_is_visited_once() -> None:
    points = chain(1600)
    assert list(scale_mistakes(points)) == []
    assert points.looked_up <= 4 * 1600
    points.looked_up = 0
    assert len(sources_of(points.values(), points)) == 1599
    assert points.looked_up <= 4 * 1600


def test_each_point_in_a_cycle_of_scales_is_named() -> None:
    mistakes = dict(scale_mistakes(chain(3, first="p1")))
    assert {name: str(mistake) for name, mistake in mistakes.items()} == {
        "p0": "p0.scale_from: leads back to a point: p0, p1, p0",
        "p1": "p1.scale_from: leads back to a point: p1, p0, p1",
        "p2": "p2.scale_from: leads back to a point: p2, p1, p0, p1",
    }


def test_only_the_point_whose_scale_is_missing_is_wrong() -> None:
    ((name, mistake),) = scale_mistakes(chain(3, first="x"))
    assert (name, str(mistake)) == ("p0", "p0.scale_from: the map has no point 'x'")
