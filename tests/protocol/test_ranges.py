"""
Ranges that are joined, and taken from each other.
"""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.protocol.tables import contains, joined, touches, without
from tests.support.cases import each_case


@each_case(
    ("ranges", "together"),
    [
        ([], []),
        ([range(5, 5)], []),
        ([range(8, 9), range(3)], [range(3), range(8, 9)]),
        ([range(3), range(3, 5)], [range(5)]),
        ([range(9), range(2, 4)], [range(9)]),
        ([range(2, 4), range(3, 6), range(7, 8)], [range(2, 6), range(7, 8)]),
    ],
)
def test_ranges_are_joined(ranges: list[range], together: list[range]) -> None:
    assert joined(ranges) == tuple(together)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 9))))
def test_joined_ranges_have_the_same_addresses(found: list[tuple[int, int]]) -> None:
    ranges = [range(first, first + size) for first, size in found]
    together = joined(ranges)
    addresses = {at for each in ranges for at in each}
    assert [at for each in together for at in each] == sorted(addresses)
    assert all(one.stop < other.start for one, other in pairwise(together))


Spans = st.lists(st.tuples(st.integers(0, 50), st.integers(0, 9)))


@given(Spans, Spans)
def test_ranges_without_others(
    given_: list[tuple[int, int]], others: list[tuple[int, int]]
) -> None:
    kept, taken = (joined(range(at, at + size) for at, size in each) for each in (given_, others))
    left = without(kept, taken)
    expected = {at for each in kept for at in each} - {at for each in taken for at in each}
    assert [at for each in left for at in each] == sorted(expected)
    assert all(left)


@given(Spans, st.integers(0, 60), st.integers(1, 9))
def test_searched_ranges(found: list[tuple[int, int]], address: int, count: int) -> None:
    ranges = joined(range(at, at + size) for at, size in found)
    all_of_it = {at for each in ranges for at in each}
    asked = set(range(address, address + count))
    assert contains(ranges, address, count) == (asked <= all_of_it)
    assert touches(ranges, address, count) == bool(asked & all_of_it)
