"""
Times and sizes with units, as texts of files.
"""

from __future__ import annotations

import pytest

from libmodbus_py.tools.files.amounts import in_bytes, in_seconds
from tests.support.cases import each_case


def test_amounts_have_units() -> None:
    for text, value in (("90 days", 7_776_000), ("1.5h", 5400), ("2 weeks", 1_209_600)):
        assert in_seconds("keep", text, "1 s", "100 years") == value
    for text, value in (("2 GB", 2 * 10**9), ("1 GiB", 1 << 30), ("0.5 MB", 500_000)):
        assert in_bytes("size", text, "1 B", "1 TB") == value


@each_case(
    ("given", "error"),
    [
        (90, TypeError),
        ("90", ValueError),
        ("ninety days", ValueError),
        ("-1 days", ValueError),
        ("1e9 days", ValueError),
        ("90 Days", ValueError),
        ("1 GB", ValueError),
        ("1 s", ValueError),
        ("101 years", ValueError),
        ("9" * 400 + " days", ValueError),
        ("", ValueError),
    ],
)
def test_a_wrong_amount_is_named_with_what_is_allowed(
    given: object, error: type[Exception]
) -> None:
    with pytest.raises(error, match=r'^keep must be a time in "1 minute".."100 years", not '):
        in_seconds("keep", given, "1 minute", "100 years")
