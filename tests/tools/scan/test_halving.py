"""
Which cells exist, by what can be read: devices of every kind, without a wire.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py.tools.scan.search import FINEST, Cells, halving

SIZE = 65536

Reader = Callable[[range], bool]


def strict(*there: range) -> Reader:
    """Refuses every read that touches a hole."""
    cells = {cell for each in there for cell in each}
    return lambda read: all(cell in cells for cell in read)


def limited(most: int, *there: range) -> Reader:
    """Refuses reads of more than so many, too."""
    answers = strict(*there)
    return lambda read: len(read) <= most and answers(read)


def found(reader: Reader, most: int = 125, bound: int = 1_000_000) -> tuple[Cells, list[range]]:
    """Return what halving finds, and all its reads."""
    cells = Cells(most)
    steps = halving(cells)
    reads: list[range] = []
    try:
        read = next(steps)
        while len(reads) < bound:
            assert 1 <= len(read) <= most
            assert 0 <= read.start < read.stop <= SIZE
            reads.append(read)
            read = steps.send(reader(read))
    except StopIteration:
        pass
    return cells, reads


@pytest.mark.parametrize(
    "there",
    [
        [range(10)],
        [range(1)],
        [range(100, 400)],
        [range(2), range(5, 6)],
        [range(99, 223), range(224, 225), range(230, 300)],
        [range(65_400, 65_536)],
        [range(65_536)],
        [range(40_000, 40_125), range(40_126, 40_300)],
        [range(777, 777 + FINEST)],
        [],
    ],
    ids=str,
)
@pytest.mark.parametrize("most", [1, 2, 7, 100, 125, 2000])
def test_ranges_are_found_exactly_whatever_the_length_that_a_device_reads(
    there: list[range], most: int
) -> None:
    cells, reads = found(limited(most, *there), 2000 if most == 2000 else 125)
    assert cells.ranges == there
    assert cells.unseen < FINEST
    assert len(set(reads)) == len(reads)  # nothing is asked twice


def test_a_whole_table_takes_few_reads() -> None:
    cells, reads = found(strict(range(SIZE)))
    assert cells.ranges == [range(SIZE)]
    assert cells.unseen == 0
    assert len(reads) <= SIZE // 125 + 10  # 525 at least


def test_a_range_takes_few_reads_for_each_of_its_ends() -> None:
    """Halving 125 cells takes 7 reads, and one more to prove it."""
    _, empty = found(strict())
    _, reads = found(strict(range(100, 400)))
    assert len(reads) - len(empty) < 3 + 2 * 9 + 36


@pytest.mark.parametrize(("limit", "least"), [(1, 1), (2, 1), (10, 5), (60, 30), (124, 62)])
def test_the_length_that_a_device_reads_is_learnt(limit: int, least: int) -> None:
    cells, reads = found(limited(limit, range(5000)), bound=10_000)
    assert least <= cells.most <= limit
    assert cells.ranges == [range(5000)]
    refused = [read for read in reads if len(read) > limit and read.start < 5000]
    assert len(refused) < 20  # once, not with each


def test_what_was_found_so_far_is_told_when_it_is_left() -> None:
    cells, _ = found(strict(range(1000)), bound=5)
    assert len(cells.ranges) == 1
    assert cells.ranges[0].start == 0
    assert 100 < len(cells.ranges[0]) < 1000
    assert cells.unseen > 60_000


@settings(max_examples=60)
@given(
    st.lists(st.integers(0, 2000), max_size=12),
    st.integers(1, 125),
    st.randoms(use_true_random=False),
)
def test_nothing_is_claimed_that_cannot_be_read(ends: list[int], most: int, random: Any) -> None:
    """Also of a device that sometimes refuses what it has."""
    points = sorted(set(ends))
    there = [range(*pair) for pair in zip(points[::2], points[1::2], strict=False)]
    reader = limited(most, *there)
    cells, _ = found(lambda read: reader(read) and random.random() > 0.1, bound=5000)
    claimed = {cell for each in cells.ranges for cell in each}
    assert claimed <= {cell for each in there for cell in each}
