"""
Counters of a gateway: of all requests, by line, and by unit; and the gateway itself as a device,
whose input registers contain them.

Every number has two registers, the high word first, and wraps around at 2^32::

    0       version of this layout, 1        2   lines
    4       seconds since the start          6   connections now
    8       requests                         10  exception responses
    12      no route (0A)                    14  not allowed
    16      malformed                        18  broadcasts
    20      invalid frames

    100 + 20 * line, lines in the order of the routes, 0..39:
    +0      waiting now                      +2  in flight now
    +4      refused with exception 6         +6  late responses dropped
    +8      responses without a client       +10 timeouts
    +12     connections established          +14 connections lost or failed

    1000 + 20 * unit, units as clients address them, 0..255:
    +0      requests sent                    +2  responses
    +4      exception responses              +6  timeouts
    +8      invalid responses                +10 no connection
    +12     exception 11 while silent        +14 cached or merged
    +16     mean response time, in us        +18 1 if the unit is silent
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from ...client.statistics import Statistics
from ...device.access import Access
from ...device.authorization import Authorize
from ...device.device import Device
from ...device.mapping import Mapping
from ...server.limits import ServerStatistics

__all__ = ["GatewayStatistics", "LineStatistics", "UnitStatistics", "own_device"]

LINES, LINE, MOST_LINES = 100, 20, 40
UNITS, UNIT = 1000, 20


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
        resting: requests answered with exception 11 at once because the unit, or the function
            of the unit, was silent.
        given_up: trials of a silent unit that were ended because other requests waited.
        cached: requests answered from the cache.
        merged: requests answered with the response to an equal request.
        seconds: total response time, in seconds.
        is_silent: True if the unit rests, because it answers nothing.
    """

    requests: int = 0
    answers: int = 0
    exceptions: int = 0
    timeouts: int = 0
    invalid: int = 0
    lost: int = 0
    resting: int = 0
    given_up: int = 0
    cached: int = 0
    merged: int = 0
    seconds: float = 0.0
    is_silent: bool = False


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

    def unit(self, number: int) -> UnitStatistics:
        """Return the counters of a unit."""
        found = self.units.get(number)
        if found is None:
            found = self.units[number] = UnitStatistics()
        return found


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


def own_device(
    statistics: GatewayStatistics,
    clients: ServerStatistics,
    unit_of: Callable[[int], UnitStatistics | None],
    authorize: Authorize | None = None,
) -> Device:
    """
    Return the device.

    Args:
        statistics: the statistics of the gateway.
        clients: the statistics of its endpoints.
        unit_of: returns the statistics of a unit by the number that clients use.
        authorize: as for `Device`.
    """
    mapping = Mapping(input_registers=UNITS + 256 * UNIT)
    now = asyncio.get_running_loop().time
    made = now()

    def refresh(access: Access) -> None:
        if access.table != "input_registers":
            return
        first, last = access.address, access.address + access.count - 1
        blocks: list[tuple[int, Iterable[int]]] = []
        if first < LINES:
            blocks.append((0, _of_gateway(statistics, clients, int(now() - made))))
        if first < UNITS:
            lines = [*map(_of_line, statistics.lines.values()), *[[0] * 10] * MOST_LINES]
            blocks += ((LINES + at * LINE, lines[at]) for at in range(MOST_LINES))
        for unit in range(max(0, first - UNITS) // UNIT, max(-1, last - UNITS) // UNIT + 1):
            blocks.append((UNITS + unit * UNIT, _of_unit(unit_of(unit) or UnitStatistics())))
        for at, numbers in blocks:
            words = [word for number in numbers for word in divmod(number % 2**32, 0x10000)]
            mapping.input_registers[at : at + len(words)] = words

    return Device(
        mapping,
        before_read=refresh,
        identification={"ProductCode": "Gateway"},
        authorize=authorize,
    )


def _of_gateway(statistics: GatewayStatistics, clients: ServerStatistics, age: int) -> list[int]:
    return [
        1,
        len(statistics.lines),
        age,
        clients.connections,
        statistics.requests,
        clients.refused,
        statistics.no_route,
        statistics.refused,
        statistics.malformed,
        statistics.broadcasts,
        clients.bad_frames,
    ]


def _of_line(line: LineStatistics) -> list[int]:
    connection = line.connection
    return [
        line.waiting,
        line.in_flight,
        line.full,
        connection.late_answers,
        line.unwanted,
        connection.timeouts,
        connection.connects,
        connection.lost + connection.failed_connects,
        0,
        0,
    ]


def _of_unit(unit: UnitStatistics) -> list[int]:
    return [
        unit.requests,
        unit.answers,
        unit.exceptions,
        unit.timeouts,
        unit.invalid,
        unit.lost,
        unit.resting,
        unit.cached + unit.merged,
        int(1e6 * unit.seconds / unit.answers) if unit.answers else 0,
        int(unit.is_silent),
    ]
