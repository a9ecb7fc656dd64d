"""
A map of 20 registers, of which pymodbus's server lacks one: it is found with few requests.
"""

from __future__ import annotations

from libmodbus_py import Context, Point, RegisterMap
from tests.interop.test_interop_pymodbus import pymodbus_serving
from tests.support.interop import HOLDING_REGISTERS, UNIT, holding_register

H = "holding_registers"
END = HOLDING_REGISTERS.stop


def test_registers_behind_the_end_are_left_out() -> None:
    """Of twenty points the last three lie where pymodbus has no registers."""
    first = END - 17
    points = RegisterMap(Point(f"r{at}", H, at) for at in range(first, first + 20))
    with (
        pymodbus_serving("tcp") as url,
        Context.from_url(url, unit=UNIT, timeout=5, max_in_flight=1) as plc,
    ):
        counts = []
        for _ in range(4):
            before = plc.statistics.requests
            found = plc.read_map(points, return_exceptions=True)
            counts.append(plc.statistics.requests - before)
        good = {name: value for name, value in found.items() if isinstance(value, int)}
        assert good == {f"r{at}": holding_register(at) for at in range(first, END)}
        assert [each.name for each in plc.unreadable(points)] == [f"r{END + at}" for at in range(3)]
    assert counts[0] <= 1 + 10
    assert counts[1:] == [1, 1, 1]
