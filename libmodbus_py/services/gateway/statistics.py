"""
Counters of a gateway: of all requests, by line, and by unit; and the gateway itself as a device,
whose input registers contain them.

Every number has two registers, the high word first, and wraps around at 2^32. The tables here list
the numbers in the order of their registers: those of the gateway from 0 on, those of each line from
100 + 20 * line, lines in the order of the routes, and those of each unit from 1000 + 20 * unit.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter

from ...client.statistics import Statistics
from ...device.access import Access
from ...device.authorization import Authorize
from ...device.device import Device
from ...device.mapping import Mapping
from ...server.limits import ServerStatistics

LINES, MOST_LINES = 100, 40
UNITS, MOST_UNITS = 1000, 256

EACH = 20
"""Registers of each line and each unit."""


@dataclass(slots=True)
class UnitStatistics:
    """
    Counters of the requests to one unit of a line.

    Attributes:
        requests: requests sent to the unit.
        answers: valid responses of the unit, exceptions included.
        exceptions: exception responses of the unit.
        timeouts: requests without a response in time.
        invalid: requests with an invalid response.
        lost: requests without a connection, or whose connection was lost.
        refused: requests answered with exception 11 at once because the unit, or the function
            of the unit, was silent.
        given_up: trials of a silent unit that were ended because other requests waited.
        cached: requests answered from the cache.
        merged: requests answered with the response to an equal request.
        seconds: total response time, in seconds.
        is_silent: True if the unit is paused, because it answers nothing.
    """

    requests: int = 0
    answers: int = 0
    exceptions: int = 0
    timeouts: int = 0
    invalid: int = 0
    lost: int = 0
    refused: int = 0
    given_up: int = 0
    cached: int = 0
    merged: int = 0
    seconds: float = 0.0
    is_silent: bool = False

    @property
    def saved(self) -> int:
        """Requests that were not sent, because an equal one was."""
        return self.cached + self.merged

    @property
    def mean_us(self) -> int:
        """The mean response time, in microseconds."""
        return int(1e6 * self.seconds / self.answers) if self.answers else 0


@dataclass(slots=True)
class LineStatistics:
    """
    Counters of one line.

    Attributes:
        url: the URL of the line.
        connection: the statistics of its client; `late_answers` were dropped.
        units: the counters of each unit that requests were sent to, by its number on the line.
        waiting: requests in the queue now.
        in_flight: requests that wait for their response now.
        full: requests refused with exception 6 because the queue was full, or after a long wait.
        unwanted: responses dropped because the client did not wait any more.
        trouble: why there is no connection now; empty if there is one, or none was wanted.
        since: since when that is so, in seconds since the epoch; 0 before the first connection.
    """

    url: str
    connection: Statistics
    units: dict[int, UnitStatistics] = field(default_factory=dict)
    waiting: int = 0
    in_flight: int = 0
    full: int = 0
    unwanted: int = 0
    trouble: str = ""
    since: float = 0.0

    @property
    def is_down(self) -> bool:
        """True if there is no connection, although one was wanted."""
        return bool(self.trouble)

    @property
    def lost(self) -> int:
        """Connections lost or failed."""
        return self.connection.lost + self.connection.failed_connects

    def unit(self, number: int) -> UnitStatistics:
        """Return the counters of a unit."""
        statistics = self.units.get(number)
        if statistics is None:
            statistics = self.units[number] = UnitStatistics()
        return statistics


@dataclass(slots=True, weakref_slot=True)
class GatewayStatistics:
    """
    Counters of a gateway since it was made.

    Attributes:
        lines: the counters of the current lines, by URL.
        requests: requests received from clients.
        no_route: requests refused because there is no route for their unit.
        refused: requests not allowed by a route or by `authorize`.
        malformed: requests refused because of an invalid function code or a wrong length.
        broadcasts: writes to unit 0, sent to all lines.
    """

    lines: dict[str, LineStatistics] = field(default_factory=dict)
    requests: int = 0
    no_route: int = 0
    refused: int = 0
    malformed: int = 0
    broadcasts: int = 0


# --- the gateway as a device ------------------------------------------------------------------

VERSION = 1
"""Of the tables that follow."""

numbers_of_gateway = attrgetter("requests", "no_route", "refused", "malformed", "broadcasts")

numbers_of_line = attrgetter(
    *("waiting", "in_flight", "full", "connection.late_answers", "unwanted"),
    *("connection.timeouts", "connection.connects", "lost"),
)

numbers_of_unit = attrgetter(
    *("requests", "answers", "exceptions", "timeouts", "invalid", "lost", "refused"),
    *("saved", "mean_us", "is_silent"),
)


def own_device(
    statistics: GatewayStatistics,
    clients: ServerStatistics,
    unit_of: Callable[[int], UnitStatistics | None],
    authorize: Authorize | None = None,
) -> Device:
    """Return the device; `unit_of` returns the counters of a unit as clients number it."""
    mapping = Mapping(input_registers=UNITS + MOST_UNITS * EACH)
    now = asyncio.get_running_loop().time
    start = now()

    def blocks(access: Access) -> Iterator[tuple[int, Sequence[int]]]:
        if access.address < LINES:
            requests, *others = numbers_of_gateway(statistics)
            head = [VERSION, len(statistics.lines), int(now() - start), clients.connections]
            yield 0, [*head, requests, clients.refused, *others, clients.bad_frames]
        if access.address < UNITS:
            lines = [*map(numbers_of_line, statistics.lines.values())]
            for at in range(MOST_LINES):
                yield LINES + at * EACH, lines[at] if at < len(lines) else [0] * (EACH // 2)
        first, last = access.address - UNITS, access.address + access.count - 1 - UNITS
        for unit in range(max(0, first) // EACH, max(-1, last) // EACH + 1):
            yield UNITS + unit * EACH, numbers_of_unit(unit_of(unit) or UnitStatistics())

    def refresh(access: Access) -> None:
        if access.table == "input_registers":
            for at, numbers in blocks(access):
                words = [word for number in numbers for word in divmod(number % 2**32, 0x10000)]
                mapping.input_registers[at : at + len(words)] = words

    return Device(
        mapping, before_read=refresh, identification={"ProductCode": "Gateway"}, authorize=authorize
    )
