"""
Which cells of a table exist, from the reads that a device answers; without I/O.

A read that is answered proves that all its cells exist. One that is refused proves only that one
of them is missing, or that the read asked for too many. So single cells are tried at intervals;
from each that exists, reads grow in both directions until one is refused, and halving that one
finds the end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator

from ...protocol.tables import TABLE_SIZE

__all__ = ["Cells", "halving"]

UNKNOWN, THERE, MISSING = 0, 1, 2

# Where tables usually begin, before halves of halves of the rest are tried.
USUAL = (
    0, 1, 100, 200, 300, 400, 500, *range(1000, 10_000, 1000),
    *range(10_000, 65_536, 10_000), *range(0x100, 0x1000, 0x100), *range(0x1000, 0x10000, 0x1000),
)  # fmt: skip

# Cells between two that are tried, in the end.
FINEST = 64

# Distances from a range at which others are looked for: ranges come in groups, and usual addresses
# begin them.
BEHIND, BEFORE = (*range(1, 17), 32, 64), (1, 2, 4, 8)

# Yields a read; is sent True if it was answered.
Reads = Generator[range, bool, bool]


class Cells:
    """
    The cells of one table, as far as they are known.

    Attributes:
        most: the number of cells that one read may ask for, as far as the device has shown.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._states = bytearray(TABLE_SIZE)

    def state(self, address: int) -> int:
        return self._states[address]

    def note(self, read: range, answered: bool) -> None:
        """Note a read; a refusal proves something only if it was of a single cell."""
        if answered:
            self._states[read.start : read.stop] = bytes([THERE]) * len(read)
        elif len(read) == 1:
            self._states[read.start] = MISSING

    @property
    def ranges(self) -> list[range]:
        """Return the ranges that exist."""
        return list(self._runs(THERE))

    @property
    def unseen(self) -> int:
        """Return the length of the longest run of cells that were not tried."""
        return max((len(run) for run in self._runs(UNKNOWN)), default=0)

    def _runs(self, state: int) -> Iterator[range]:
        others = [bytes([other]) for other in (UNKNOWN, THERE, MISSING) if other != state]
        start = self._states.find(state)
        while start >= 0:
            ends = [self._states.find(other, start) for other in others]
            stop = min((end for end in ends if end >= 0), default=TABLE_SIZE)
            yield range(start, stop)
            start = self._states.find(state, stop)


def halving(cells: Cells) -> Generator[range, bool, None]:
    """
    Yield reads until no more are worthwhile; send True for each that was answered.

    Args:
        cells: is told of each read.
    """
    near: deque[int] = deque()
    rest = _places()
    while True:
        address = near.popleft() if near else next(rest, None)
        if address is None:
            return
        if cells.state(address) == UNKNOWN and (
            yield from _ask(cells, range(address, address + 1))
        ):
            last = yield from _grow(cells, address, 1)
            # A range usually begins where it is found: one read shows that, halving takes seven.
            if address and cells.state(address - 1) == UNKNOWN:
                yield from _ask(cells, range(address - 1, address))
            first = yield from _grow(cells, address, -1)
            around = [last + each for each in BEHIND] + [first - each for each in BEFORE]
            near += [each for each in around if 0 <= each < TABLE_SIZE]


def _places() -> Iterator[int]:
    yield from USUAL
    step = TABLE_SIZE
    while step > FINEST:
        yield from range(step // 2, TABLE_SIZE, step)
        step //= 2


def _ask(cells: Cells, read: range) -> Reads:
    answered = yield read
    cells.note(read, answered)
    return answered


def _between(near: int, far: int, way: int) -> range:
    """Return the cells from `near` up to, but without, `far`, in either direction."""
    return range(near, far) if way > 0 else range(far + 1, near + 1)


def _grow(cells: Cells, address: int, way: int) -> Generator[range, bool, int]:
    """Go on from a cell that exists; return the first that does not."""
    near = address + way
    while 0 <= near < TABLE_SIZE and cells.state(near) != MISSING:
        if cells.state(near) == THERE:
            near += way
            continue
        far = near
        while (
            0 <= far < TABLE_SIZE and abs(far - near) < cells.most and cells.state(far) == UNKNOWN
        ):
            far += way
        if (yield from _ask(cells, _between(near, far, way))):
            near = far
        else:
            near = yield from _halve(cells, near, far, way)
    return near


def _halve(cells: Cells, near: int, far: int, way: int) -> Generator[range, bool, int]:
    """Find the cell because of which a read was refused, or that its length was the reason."""
    largest = 1
    while abs(far - near) > 1:
        middle = near + way * (abs(far - near) // 2)
        if (yield from _ask(cells, _between(near, middle, way))):
            largest = max(largest, abs(middle - near))
            near = middle
        else:
            far = middle
    if cells.state(near) == UNKNOWN:
        yield from _ask(cells, _between(near, far, way))
    if cells.state(near) == THERE:  # all of them exist: the length was the reason
        cells.most = min(cells.most, largest)
    return near
