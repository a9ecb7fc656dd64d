"""
Named bits from typed text: a name that occurs twice is refused, in both forms.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Point
from libmodbus_py.maps.typed import typed_value
from tests.support.cases import each_case

FLAGS = Point("flags", "holding_registers", 0, bits={0: "door", "4..7": "mode"})


@each_case(
    "text",
    ["door=1, door=0", "door=1,mode=3, door=1", '{"door": 1, "door": 0}', '{"mode":1,"mode":1}'],
)
def test_a_bit_that_is_named_twice_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^value\.(door|mode): occurs twice$"):
        typed_value(FLAGS, text)


def test_bits_that_are_named_once_are_taken() -> None:
    assert typed_value(FLAGS, "door=1, mode=3") == {"door": True, "mode": 3}
    assert typed_value(FLAGS, '{"mode": 3, "door": true}') == {"mode": 3, "door": True}
