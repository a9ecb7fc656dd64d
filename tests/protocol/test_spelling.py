"""
Values and lists as people type them.
"""

from __future__ import annotations

import pytest

from libmodbus_py.protocol.spelling import units_of
from tests.support.cases import each_case


@each_case(
    ("text", "units"),
    [
        ("7", [7]),
        ("0,255", [0, 255]),
        ("1-3,9", [1, 2, 3, 9]),
        (" 9 , 1 - 3", [9, 1, 2, 3]),
        ("4-4,4", [4, 4]),
    ],
)
def test_units_are_listed_in_the_order_of_the_text(text: str, units: list[int]) -> None:
    assert units_of(text) == units


@each_case(
    ("text", "message"),
    [
        ("10-1,5", "'10-1' must go up, within 0..255"),
        ("0-256", "'0-256' must go up, within 0..255"),
        ("", "'' must be a unit, or a range such as 1-247"),
        ("1,,3", "'' must be a unit"),
        ("1-", "'1-' must be a unit"),
        ("1000", "'1000' must be a unit"),
        ("\u0663", "must be a unit"),
    ],
)
def test_what_is_no_list_of_units_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}|{message}"):
        units_of(text)
