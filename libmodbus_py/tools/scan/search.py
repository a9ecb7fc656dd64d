"""
A search: which ranges of the tables of one unit exist.

A read that is answered proves that all its cells exist. One that is refused proves only that one
of them is missing, or that the read asked for too many. So single cells are tried at intervals;
from each that exists, reads grow in both directions until one is refused, and halving that one
finds the end.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ...ports.endpoint import parse
from ...ports.options import SERIAL_DEFAULTS
from ...protocol import errors
from ...protocol.checks import integer
from ...protocol.errors import NO_UNIT, ModbusConnectionError, ModbusError
from ...protocol.mistakes import named_parameters
from ...protocol.tables import TABLE_SIZE, TABLES
from ...security.security import Security
from .probe import LONGEST_SIZE, Place, Prober, Walker, checked_progress, places

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
    """The cells of one table, as far as they are known; one read may ask for `most` of them."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.states = bytearray(TABLE_SIZE)
        self.values: dict[int, int] = {}

    def ask(self, read: range) -> Reads:
        """Yield a read; a refusal proves something only if it is of a single cell."""
        answer = yield read
        if answer:
            self.states[read.start : read.stop] = bytes([THERE]) * len(read)
        elif len(read) == 1:
            self.states[read.start] = MISSING
        return answer

    @property
    def ranges(self) -> list[range]:
        return list(self._runs(THERE))

    @property
    def unseen(self) -> int:
        """The length of the longest run of cells that were not tried."""
        return max((len(run) for run in self._runs(UNKNOWN)), default=0)

    def _runs(self, state: int) -> Iterator[range]:
        for match in re.finditer(b"%c+" % state, self.states):
            yield range(*match.span())


def halving(cells: Cells) -> Generator[range, bool, None]:
    """Yield reads until no more are worthwhile; send True for each that was answered."""
    near: deque[int] = deque()
    rest = _places()
    while True:
        address = near.popleft() if near else next(rest, None)
        if address is None:
            return
        if cells.states[address] == UNKNOWN and (yield from cells.ask(range(address, address + 1))):
            last = yield from _grow(cells, address, 1)
            # A range usually begins where it is found: one read shows that, halving takes seven.
            if address and cells.states[address - 1] == UNKNOWN:
                yield from cells.ask(range(address - 1, address))
            first = yield from _grow(cells, address, -1)
            around = [last + step for step in BEHIND] + [first - step for step in BEFORE]
            near += [at for at in around if 0 <= at < TABLE_SIZE]


def _places() -> Iterator[int]:
    yield from USUAL
    step = TABLE_SIZE
    while step > FINEST:
        yield from range(step // 2, TABLE_SIZE, step)
        step //= 2


def _between(near: int, far: int, way: int) -> range:
    """Return the cells from `near` to the last before `far`, in either direction."""
    return range(near, far) if way > 0 else range(far + 1, near + 1)


def _grow(cells: Cells, address: int, way: int) -> Generator[range, bool, int]:
    """Go on from a cell that exists; return the first that does not."""
    near = address + way
    while 0 <= near < TABLE_SIZE and cells.states[near] != MISSING:
        if cells.states[near] == THERE:
            near += way
            continue
        far = near
        while (
            0 <= far < TABLE_SIZE and abs(far - near) < cells.most and cells.states[far] == UNKNOWN
        ):
            far += way
        if (yield from cells.ask(_between(near, far, way))):
            near = far
        else:
            near = yield from _halve(cells, near, far, way)
    return near


def _halve(cells: Cells, near: int, far: int, way: int) -> Generator[range, bool, int]:
    """Find the cell because of which a read was refused, or that its length was the reason."""
    largest = 1
    while abs(far - near) > 1:
        middle = near + way * (abs(far - near) // 2)
        if (yield from cells.ask(_between(near, middle, way))):
            largest = max(largest, abs(middle - near))
            near = middle
        else:
            far = middle
    if cells.states[near] == UNKNOWN:
        yield from cells.ask(_between(near, far, way))
    if cells.states[near] == THERE:  # all of them exist: the length was the reason
        cells.most = min(cells.most, largest)
    return near


# --- the search -----------------------------------------------------------------------------------


# Requests of a search unless the caller sets another limit: minutes on a serial line.
MOST_REQUESTS = 2000

# Seconds before a busy device is sent a request again.
BUSY_PAUSES = (0.1, 0.2, 0.4, 0.8)

# After so many reads without a response the unit is probed: some units do not answer where they
# should send exception 2.
SILENT = 4

# Why the search of a table ends early.
EARLY = "the user, or a lost connection"
BOUND = "the bound on requests"
BUSY = "the device stays busy"
GONE = "the unit does not answer any more"
NO_FUNCTION = "the device lacks the function"


class _EndedError(Exception):
    """The search of a table ends early; the argument is the reason."""


class Searching(NamedTuple):
    """The progress of a search: the requests that were sent, and may be sent."""

    unit: int
    table: str
    requests: int
    most_requests: int


@dataclass(frozen=True, slots=True)
class Extent:
    """
    The ranges of one table that exist.

    Attributes:
        table: "coils", "discrete_inputs", "holding_registers" or "input_registers".
        ranges: the ranges of addresses that can be read, in ascending order.
        values: the values of each of these ranges, as the search read them. It takes its time, so
            that the registers of one value may be of different moments.
        unseen: the length of the longest run of addresses that were not tried: shorter ranges
            may have been missed.
        ended: why the search of this table ended early; empty if it did not.
        most: the most cells that one read may ask for, as far as the device has shown.
        requests: the number of requests sent.
    """

    table: str
    ranges: list[range]
    values: list[list[int]] = field(repr=False)
    unseen: int
    ended: str
    most: int
    requests: int


class Search(Walker[Extent]):
    """
    An iterator over the `Extent` of each table, made by `search`. It can be stopped at any time.

    It sends requests, ends and raises errors as a `Scan` does.

    Attributes:
        longest: the most seconds that the search takes, if there are no responses.
        extents: the extents of the tables so far, including one whose search was stopped.
        requests: the number of requests sent.
    """

    def __init__(
        self,
        place: Place,
        unit: int,
        most_requests: int,
        on_progress: Callable[[Searching], object],
    ) -> None:
        # After a request without a response a line must be silent for as long again.
        self.longest: float = 2 * most_requests * place.wait(LONGEST_SIZE)
        self.extents: list[Extent] = []
        prober = Prober()
        tables = _Tables(prober, unit, most_requests, on_progress, self.extents)
        super().__init__(prober, tables.steps(place))


@dataclass
class _Tables:
    """The search of all tables of a unit; the results are added to `extents`."""

    prober: Prober
    unit: int
    most_requests: int
    on_progress: Callable[[Searching], object]
    extents: list[Extent]
    silent: int = 0

    def steps(self, place: Place) -> Generator[Extent, None, None]:
        with self.prober.at(place):
            for index, table in enumerate(TABLES):
                rest = self.most_requests - self.prober.requests
                reason = self._table(table, rest // (len(TABLES) - index))
                yield self.extents[-1]
                if reason in (GONE, BUSY):
                    return

    def _table(self, table: str, most: int) -> str:
        """Search a table with a limited number of requests; return why the search ended early."""
        cells = Cells(TABLES[table].most_read)
        first = self.prober.requests
        reason = EARLY
        try:
            reason = self._halve(table, cells, first + most)
        finally:
            requests = self.prober.requests - first
            unseen = 0 if reason == NO_FUNCTION else cells.unseen
            ranges = cells.ranges
            values = [[cells.values[at] for at in bounds] for bounds in ranges]
            extent = Extent(table, ranges, values, unseen, reason, cells.most, requests)
            self.extents.append(extent)
        return reason

    def _halve(self, table: str, cells: Cells, until: int) -> str:
        prober, steps = self.prober, halving(cells)
        read = next(steps)
        try:
            while prober.requests < until:
                state = Searching(self.unit, table, prober.requests, self.most_requests)
                self.on_progress(state)
                values = self._answer(TABLES[table].read(read.start, len(read)))
                cells.values.update(zip(read, values, strict=False))
                read = steps.send(bool(values))
        except _EndedError as error:
            reason: str = error.args[0]
            return "" if reason == NO_FUNCTION and cells.ranges else reason
        except StopIteration:
            return ""
        return BOUND

    def _answer(self, request: Any) -> list[int]:
        """Return the values that a read is answered with; none if it is refused."""
        for pause in (0.0, *BUSY_PAUSES):
            self.prober.waker.sleep(pause)
            try:
                return [int(value) for value in self._read(request)]
            except (errors.Acknowledge, errors.ServerDeviceBusy):
                continue
            except errors.IllegalFunction:
                raise _EndedError(NO_FUNCTION) from None
            except NO_UNIT:
                raise _EndedError(GONE) from None
            except ModbusConnectionError:
                raise
            except ModbusError:
                return []
        raise _EndedError(BUSY)

    def _read(self, request: Any) -> Any:
        """Repeat a read that was lost or damaged; after many of them, probe the unit."""
        try:
            values = self.prober.read(self.unit, request)
        except (errors.ExceptionResponse, ModbusConnectionError):
            self.silent = 0
            raise
        except ModbusError:
            self.silent += 1
            if self.silent >= SILENT:
                self.silent = 0
                if isinstance(self.prober.probe(self.unit), ModbusError):
                    raise _EndedError(GONE) from None
            values = self.prober.read(self.unit, request)
        self.silent = 0
        return values


@named_parameters
def search(
    url: str,
    *,
    timeout: float | None = None,
    most_requests: int = MOST_REQUESTS,
    security: Security | None = None,
    on_progress: Callable[[Searching], object] | None = None,
) -> Search:
    """
    Find the address ranges of the tables of a unit, only by reading.

    Single addresses are tried: usual ones, neighbours of ranges that were found, and the middle of
    each remaining gap, again and again. From an address that can be read, longer and longer reads
    are tried until one is refused; halving that one finds the end of the range, or the most cells
    that one read may ask for. Nothing is sent before the result is iterated.

    Args:
        url: a URL for clients of the unit, such as `FoundUnit.url`.
        timeout: seconds for each response, 0.001..86400; None for that of the URL, or 0.6 on
            serial ports and 1 elsewhere.
        most_requests: the most requests for all tables together, 4..1000000; each table gets an
            equal share of those that are left.
        security: for "tls", unless the URL contains these options.
        on_progress: called with a `Searching` before each read.

    Returns:
        An iterator over the extents of the tables.

    Raises:
        TypeError, ValueError: an argument is wrong; the message names it and its range.
    """
    endpoint = parse(url)
    baudrates = parities = None
    if endpoint.is_serial:
        # One setting, as for clients.
        settings = {**SERIAL_DEFAULTS, **endpoint.options}
        baudrates, parities = [settings["baudrate"]], [settings["parity"]]
    (place,) = places(endpoint, baudrates, parities, timeout, security)
    integer("most_requests", most_requests, len(TABLES), 1_000_000)
    place.context().close()  # which checks the rest of the URL
    lowest = int(not endpoint.has_transactions)  # without them 0 is a broadcast
    unit = integer("unit", endpoint.client_options.get("unit", 1), lowest, 255)
    return Search(place, unit, most_requests, checked_progress(on_progress))
