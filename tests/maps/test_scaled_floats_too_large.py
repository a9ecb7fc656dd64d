"""
A float of a device that is too large once it is scaled is infinite, whatever its sign.
"""

import struct

import pytest

from libmodbus_py import Point


@pytest.mark.parametrize("raw", [1e300, -1e300])
@pytest.mark.parametrize(
    ("keys", "source"), [({"scale": 1e30}, None), ({"scale_from": "exponent"}, 30)]
)
def test_too_large_a_value_is_infinite(raw, keys, source):
    point = Point("energy", "holding_registers", 0, type="float64", **keys)
    cells = struct.unpack(">4H", struct.pack(">d", raw))
    assert point.decode(cells, source=source) == raw * 1e300
