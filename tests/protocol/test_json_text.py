"""
JSON that the package writes, and names that occur twice in JSON that it reads.
"""

from __future__ import annotations

import json
import math

import pytest

from libmodbus_py.protocol.json_text import COMPACT_JSON, SORTED_JSON, each_once, json_text
from libmodbus_py.protocol.mistakes import WrongValue
from tests.support.cases import each_case


def test_text_is_in_ascii_and_numbers_are_finite() -> None:
    assert json_text({"b": "°C", "a": [1]}) == '{"b": "\\u00b0C", "a": [1]}'
    assert COMPACT_JSON.encode({"b": "ü", "a": [1]}) == '{"b":"\\u00fc","a":[1]}'
    assert SORTED_JSON.encode({"b": 1, "a": [1, 2]}) == '{"a":[1,2],"b":1}'


@each_case("value", [math.nan, math.inf, [-math.inf]])
def test_what_json_has_no_number_for_is_refused(value: object) -> None:
    for encode in (json_text, COMPACT_JSON.encode, SORTED_JSON.encode):
        with pytest.raises(ValueError, match="not JSON compliant"):
            encode(value)


def test_a_name_that_occurs_twice_is_refused() -> None:
    assert json.loads('{"a": 1, "b": {"a": 2}}', object_pairs_hook=each_once) == {
        "a": 1,
        "b": {"a": 2},
    }
    with pytest.raises(WrongValue, match=r"^a: occurs twice"):
        json.loads('{"a": 1, "a": 1}', object_pairs_hook=each_once)
