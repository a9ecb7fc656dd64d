"""Values as JSON can contain them."""

import json
import math
import re
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import InvalidResponse, pdu
from libmodbus_py.client.reconnecting import State
from libmodbus_py.pdu import ReadHoldingRegisters
from libmodbus_py.protocol.json_text import COMPACT_JSON, SORTED_JSON, each_once, json_text
from libmodbus_py.protocol.mistakes import WrongValue
from libmodbus_py.protocol.plain import (
    clock_text,
    plain,
    text_of,
    time_text,
    value_of,
    without_controls,
)
from libmodbus_py.protocol.values import value_type
from tests.support.cases import each_case


@each_case(
    ("value", "result"),
    [
        (None, None),
        (True, True),
        (7, 7),
        (0.5, 0.5),
        (float("nan"), None),
        (float("-inf"), None),
        ("text", "text"),
        (datetime(2026, 3, 29, 1, 30, tzinfo=UTC), "2026-03-29T01:30:00+00:00"),
        (b"\x01\xff", "01ff"),
        ([1, (b"\x02", float("inf"))], [1, ["02", None]]),
        ({1: b"\x03"}, {"1": "03"}),
        (pdu.ServerId(b"\x01", True, b""), {"identifier": "01", "running": True, "additional": ""}),
        (pdu.ServerId(b"A", None, b"C"), {"identifier": "41", "running": None, "additional": "43"}),
        (pdu.SubFunction.CLEAR_COUNTERS, 10),
        (State.CONNECTED, "connected"),
        (
            pdu.ReadHoldingRegisters(0, 2),
            {"name": "ReadHoldingRegisters", "address": 0, "count": 2},
        ),
        (
            pdu.WriteFileRecords(((4, 1, (7,)),)),
            {"name": "WriteFileRecords", "records": [[4, 1, [7]]]},
        ),
    ],
)
def test_each_value_becomes_a_value_of_json(value: Any, result: Any) -> None:
    assert plain(value) == result
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == result


def test_control_characters_are_shown_instead_of_sent() -> None:
    assert without_controls("a\x1b[2J\x9b\tb\nc \xe4") == "a\\x1b[2J\\x9b\\x09b\nc \xe4"


def test_text_is_in_ascii_and_numbers_are_finite() -> None:
    assert json_text({"b": "°C", "a": [1]}) == '{"b": "\\u00b0C", "a": [1]}'
    assert COMPACT_JSON.encode({"b": "ü", "a": [1]}) == '{"b":"\\u00fc","a":[1]}'
    assert SORTED_JSON.encode({"b": 1, "a": [1, 2]}) == '{"a":[1,2],"b":1}'


@each_case("value", [math.nan, math.inf, [-math.inf]])
def test_infinite_numbers_and_nan_are_refused(value: object) -> None:
    for encode in (json_text, COMPACT_JSON.encode, SORTED_JSON.encode):
        with pytest.raises(ValueError, match="not JSON compliant"):
            encode(value)


def test_a_repeated_name_is_refused() -> None:
    assert json.loads('{"a": 1, "b": {"a": 2}}', object_pairs_hook=each_once) == {
        "a": 1,
        "b": {"a": 2},
    }
    with pytest.raises(WrongValue, match=r"^a: occurs twice"):
        json.loads('{"a": 1, "a": 1}', object_pairs_hook=each_once)


@pytest.fixture
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "Europe/Berlin")
        time.tzset()
        yield
    time.tzset()


@each_case(
    ("seconds", "text"),
    [
        (0.0004, "1970-01-01T00:00:00.000Z"),
        (1_700_000_000, "2023-11-14T22:13:20.000Z"),
        (1_700_000_000.1239, "2023-11-14T22:13:20.123Z"),
    ],
)
def test_times_are_iso_8601_in_utc(berlin: None, seconds: float, text: str) -> None:
    assert time_text(seconds) == text


@each_case("seconds", [-1e11, 253_402_300_800.0, 18_446_744_073_709.551, 1e300])
def test_a_time_outside_the_calendar_is_shown_in_seconds(seconds: float) -> None:
    """A capture holds any time of 64 bits."""
    assert time_text(seconds) == clock_text(seconds) == f"{seconds:.3f}s"


@pytest.mark.parametrize(
    ("response", "answers_another"),
    [(b"\x03", False), (b"\x83\x02\x00", False), (b"\x84\x02", True), (b"\x04\x02\x00\x01", True)],
)
def test_a_response_of_another_function_belongs_to_another_request(response, answers_another):
    with pytest.raises(InvalidResponse) as invalid:
        ReadHoldingRegisters(0, 1).decode_response(response)
    assert invalid.value.answers_another is answers_another


@each_case(
    ("kind", "value", "text"),
    [
        ("float16", 3.140625, "3.14"),
        ("float16", 2.0**-24, "5.96e-08"),
        ("float16", 65504.0, "65500.0"),
        ("float32", 3.140000104904175, "3.14"),
        ("float32", 2.0**-149, "1.4013e-45"),
        ("float32", 1048576.125, "1048576.1"),
        ("float64", 0.1 + 0.2, "0.30000000000000004"),
        ("float64", 5e-324, "5e-324"),
        ("float64", math.inf, "inf"),
        ("float64", -math.nan, "nan"),
        ("uint16", 7, "7"),
        ("bits16", [True, False] * 8, "1010101010101010"),
        ("string:4", "it's", '"it\'s"'),
        ("unix32", datetime(2026, 7, 1, 12, tzinfo=UTC), "2026-07-01T12:00:00+00:00"),
    ],
)
def test_a_value_is_shown_as_its_shortest_text(kind: str, value: Any, text: str) -> None:
    assert text_of(value, value_type(kind)) == text


@each_case(
    ("kind", "text", "value"),
    [
        ("float32", "21.5", 21.5),
        ("uint16", "0x1F", 31),
        ("bits16", "10", [1, 0]),
        ("string:4", " a'", " a'"),
        ("unix32", "2026-07-01T12:00:00Z", datetime(2026, 7, 1, 12, tzinfo=UTC)),
    ],
)
def test_a_value_can_be_typed_as_it_is_shown(kind: str, text: str, value: Any) -> None:
    assert value_of(text, value_type(kind)) == value


PACKAGE = Path(__file__).parents[2] / "libmodbus_py"


OTHERS = {
    *("protocol/plain.py", "protocol/times.py"),  # values of registers
    "services/fleet/journal/schema.py",  # SQL
}


def test_only_this_module_formats_times() -> None:
    forms = re.compile(r"strftime\(|\.isoformat\(|fromtimestamp\(")
    files = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if forms.search(path.read_text())
    }
    assert files == OTHERS
