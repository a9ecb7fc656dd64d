"""
Polls as rows of a journal. One row holds all readings of a poll: a row for each reading takes
four times the space, and six times the processor time with the index that histories need.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from ....protocol.plain import COMPACT_JSON, plain
from ..readings import Reading

__all__ = ["JournalPoll", "Points", "Row", "decoded", "encoded", "numbered"]

_SIMPLE = {int, float, bool, str, type(None)}


class JournalPoll(NamedTuple):
    """
    The readings of one poll of a device, with ids that follow each other.

    Attributes:
        first, last: the ids of the first and the last reading.
        readings: the readings.
    """

    first: int
    last: int
    readings: Sequence[Reading]


class Points:
    """
    A list of points of a device, to whose positions rows refer.

    Args:
        id: the id of the first point in the table `point`; the others have the next ones.
        device: the id of the device.
        named: name and unit of each point.

    Attributes:
        id, device, named: as given.
        positions: name and unit -> position.
    """

    def __init__(self, id: int, device: int, named: Sequence[tuple[str, str]]) -> None:
        self.id: int = id
        self.device: int = device
        self.named: Sequence[tuple[str, str]] = named
        self.positions: dict[tuple[str, str], int] = {each: at for at, each in enumerate(named)}


class Row(NamedTuple):
    """
    A row of the table `poll`.

    Attributes:
        id: the id of the first reading.
        readings: the number of readings.
        time: seconds since the epoch.
        device: the id of the device.
        points: the id of the first of its points.
        chosen: the positions of the points that the row contains, in JSON; None for the first
            ones, in order.
        data: the values, in JSON.
        trouble: quality and reason of each reading that is not simply good, by its position in
            the data, in JSON; None if all are good.
    """

    id: int
    readings: int
    time: float
    device: int
    points: int
    chosen: str | None
    data: str
    trouble: str | None


def numbered(readings: Iterable[Reading], first: int) -> Iterator[JournalPoll]:
    """Yield readings as polls, with ids from `first` on; those that have them keep them."""
    for _, group in groupby(readings, lambda each: each.poll):
        poll = list(group)
        if poll[0].id != first:
            poll = [each._replace(id=first + at) for at, each in enumerate(poll)]
        yield JournalPoll(first, first + len(poll) - 1, poll)
        first += len(poll)


def encoded(poll: JournalPoll, points: Points) -> Row:
    """
    Return a poll as a row.

    Raises:
        KeyError: a reading is of none of the points.
        TypeError, ValueError: a value that JSON cannot contain.
    """
    readings = poll.readings
    positions = [points.positions[each.name, each.unit] for each in readings]
    values = [each.value for each in readings]
    if not _SIMPLE.issuperset(map(type, values)):
        values = [plain(value) for value in values]
    trouble = {
        str(at): [each.quality, each.reason]
        for at, each in enumerate(readings)
        if each.reason or each.quality != "good"
    }
    return Row(
        poll.first,
        len(readings),
        readings[0].time,
        points.device,
        points.id,
        None if positions == [*range(len(positions))] else COMPACT_JSON.encode(positions),
        _json_of(values),
        COMPACT_JSON.encode(trouble) if trouble else None,
    )


def _json_of(values: list[Any]) -> str:
    try:
        return COMPACT_JSON.encode(values)
    except ValueError:  # nan or infinite
        return COMPACT_JSON.encode(plain(values))


def decoded(row: Row, device: str, labels: Mapping[str, str], points: Points) -> JournalPoll:
    """
    Return a row as a poll.

    Raises:
        AttributeError, LookupError, TypeError, ValueError: the row is damaged.
    """
    values = json.loads(row.data)
    positions = range(row.readings) if row.chosen is None else json.loads(row.chosen)
    trouble = json.loads(row.trouble) if row.trouble else {}
    readings = [
        Reading(row.time, device, name, value, unit, "good", "", row.id + at, labels)
        for at, ((name, unit), value) in enumerate(
            zip([points.named[each] for each in positions], values, strict=True)
        )
    ]
    for at, (quality, reason) in trouble.items():
        readings[int(at)] = readings[int(at)]._replace(quality=quality, reason=reason)
    return JournalPoll(row.id, row.id + len(readings) - 1, readings)
