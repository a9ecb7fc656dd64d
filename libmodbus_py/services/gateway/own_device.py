"""
The gateway itself as a device: its statistics as input registers.

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

from ...device.access import Access
from ...device.authorization import Authorize
from ...device.device import Device
from ...device.mapping import Mapping
from ...server.limits import ServerStatistics
from .statistics import GatewayStatistics, LineStatistics, UnitStatistics

__all__ = ["own_device"]

LINES, LINE, MOST_LINES = 100, 20, 40
UNITS, UNIT = 1000, 20
SIZE = UNITS + 256 * UNIT

UnitOf = Callable[[int], UnitStatistics | None]


def own_device(
    statistics: GatewayStatistics,
    clients: ServerStatistics,
    unit_of: UnitOf,
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
    mapping = Mapping(input_registers=SIZE)
    now = asyncio.get_running_loop().time
    made = now()

    def refresh(access: Access) -> None:
        if access.table == "input_registers":
            for first, numbers in _blocks(access, statistics, clients, unit_of, now() - made):
                words = [word for number in numbers for word in divmod(number % 2**32, 0x10000)]
                mapping.input_registers[first : first + len(words)] = words

    return Device(
        mapping,
        before_read=refresh,
        identification={"ProductCode": "Gateway"},
        authorize=authorize,
    )


def _blocks(
    access: Access,
    statistics: GatewayStatistics,
    clients: ServerStatistics,
    unit_of: UnitOf,
    age: float,
) -> Iterable[tuple[int, list[int]]]:
    """Yield only the blocks that an access reads, with their first addresses."""
    first, last = access.address, access.address + access.count - 1
    if first < LINES:
        yield 0, _of_gateway(statistics, clients, age)
    if first < UNITS:
        lines = list(statistics.lines.values())[:MOST_LINES]
        for at in range(MOST_LINES):
            yield LINES + at * LINE, _of_line(lines[at]) if at < len(lines) else [0] * (LINE // 2)
    for unit in range(max(0, first - UNITS) // UNIT, max(-1, last - UNITS) // UNIT + 1):
        yield UNITS + unit * UNIT, _of_unit(unit_of(unit) or UnitStatistics())


def _of_gateway(statistics: GatewayStatistics, clients: ServerStatistics, age: float) -> list[int]:
    return [
        1,
        len(statistics.lines),
        int(age),
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
