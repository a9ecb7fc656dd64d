"""
Durations that people type are numbers of seconds.
"""

from __future__ import annotations

import pytest

from libmodbus_py.protocol.checks import duration_of
from tests.support.cases import each_case


@each_case(
    ("text", "seconds"),
    [
        ("0.5", 0.5),
        ("-3", -3.0),
        ("1e3", 1000.0),
        ("500ms", 0.5),
        ("1ms", 0.001),
        ("1.5s", 1.5),
        ("10s", 10.0),
        ("2m", 120.0),
        ("2min", 120.0),
        ("1h", 3600.0),
        ("1d", 86_400.0),
        ("1h30m", 5400.0),
        (" 1 h 30 min 1 s ", 5401.0),
        ("2d1h1m1s1ms", 176_461.001),
        ("999999999s", 999_999_999.0),
        ("0.123456789s", 0.123456789),
    ],
)
def test_a_duration_has_units_or_none(text: str, seconds: float) -> None:
    assert duration_of(text) == seconds
    assert type(duration_of(text)) is float


@each_case("text", ["", "s", "1x", "1h-5m", "1,5s", "1H", "\u0661s", "1h30", "1000000000s"])
def test_any_other_text_is_no_duration(text: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        duration_of(text)
