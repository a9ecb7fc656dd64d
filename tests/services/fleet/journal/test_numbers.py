"""
The ids of readings: above all that were given before, and with holes that no reading has.
"""

from __future__ import annotations

from libmodbus_py.services.fleet.journal.schema import MARGIN, Unused, first_id


def test_the_first_id_is_above_all_that_may_have_been_given() -> None:
    assert first_id(1.5, 0) == 1_500_000
    assert first_id(1e9, 7) == 10**15
    # The clock was set back, and the last readings were sent, but never came to the disk.
    assert first_id(0.0, 10**15) == 10**15 + MARGIN
    assert first_id(0.0, 0) == 1


def test_ids_that_no_reading_has_are_not_counted() -> None:
    unused = Unused([(100, 0), (1000, 50), (5000, 1000)])  # 950..999 and 4000..4999
    for after, last, count in (
        (99, 949, 850),
        (99, 999, 850),
        (99, 1000, 851),
        (960, 1000, 1),
        (999, 1009, 10),
        (3998, 4001, 1),
        (3998, 5000, 2),
        (4999, 5009, 10),
        (99, 5000, 850 + 3000 + 1),
        (5009, 5000, 0),
    ):
        assert unused.between(after, last) == count, (after, last)
