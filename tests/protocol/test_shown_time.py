"""
Points in time as outputs show them; only one file makes them.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.protocol.plain import clock_text, time_text
from tests.support.cases import each_case

PACKAGE = Path(__file__).parents[2] / "libmodbus_py"

OTHERS = {
    *("protocol/plain.py", "protocol/spelling.py", "protocol/times.py"),  # values of registers
    "services/fleet/journal/journal_file.py",  # SQL
}


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


def test_a_clock_is_that_of_the_place(berlin: None) -> None:
    assert clock_text(1_700_000_000) == "23:13:20"
    assert clock_text(1_700_000_000.25, with_milliseconds=True) == "23:13:20.250"
    assert clock_text(1_700_000_000.9996, with_milliseconds=True) == "23:13:21.000"


@each_case("seconds", [-1e11, 253_402_300_800.0, 18_446_744_073_709.551, 1e300])
def test_a_time_that_no_calendar_has_is_shown_in_seconds(seconds: float) -> None:
    """A capture holds any time of 64 bits."""
    assert time_text(seconds) == clock_text(seconds) == f"{seconds:.3f}s"


def test_no_other_file_formats_times() -> None:
    forms = re.compile(r"strftime\(|\.isoformat\(|fromtimestamp\(")
    found = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if forms.search(path.read_text())
    }
    assert found == OTHERS
