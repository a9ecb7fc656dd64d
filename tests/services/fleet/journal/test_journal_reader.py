"""
Histories that are thinned to a number of values.
"""

from __future__ import annotations

from libmodbus_py.services.fleet.journal.journal_reader import HistoricalValue, thinned


def test_a_thinned_history_keeps_the_smallest_and_the_greatest() -> None:
    values = [HistoricalValue(float(at), at % 100, "good") for at in range(1000)]
    values[555] = HistoricalValue(555.0, None, "down")
    found = thinned(values, 0.0, 1000.0, 30)
    assert len(found) <= 30
    assert [each.time for each in found] == sorted(each.time for each in found)
    assert {0, 99} <= {each.value for each in found}
    assert values[555] in found
    assert thinned(values[:5], 0.0, 1000.0, 3000) == values[:5]
    assert thinned([], 0.0, 0.0, 3) == []


def test_values_that_are_no_numbers_thin_to_one() -> None:
    values = [HistoricalValue(float(at), "on", "good") for at in range(10)]
    assert thinned(values, 0.0, 10.0, 3) == values[:1]
    assert thinned(values, 0.0, 10.0, 10) == values
