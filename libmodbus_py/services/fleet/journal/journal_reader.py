"""
The past of a value in a journal, for charts, also while the journal is being written. These
functions block.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterable
from heapq import merge
from itertools import chain, groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ....protocol.checks import integer
from ....protocol.logs import HarmlessLogger
from .schema import JournalError, journal_errors

if TYPE_CHECKING:
    from ....tools.page.table_source import Older

logger: HarmlessLogger = HarmlessLogger(__name__)

# Milliseconds to wait for a lock; readers need one only while a journal is opened or closed.
BUSY_MS = 2000

POSITIONS = """
SELECT point.device, point.points, point.id - point.points
  FROM device JOIN point ON point.device = device.id
 WHERE device.name = ? AND point.name = ?
"""

# Values are extracted by SQLite, which takes a quarter of the time. `place` is the position of the
# point in the data of a poll.
VALUES = """
SELECT time, json_extract(data, '$[' || place || ']'),
       coalesce(json_extract(trouble, '$."' || place || '"[0]'), 'good')
  FROM (SELECT time, data, trouble, readings,
               iif(chosen IS NULL, :at, (SELECT key FROM json_each(chosen) WHERE value = :at))
               AS place
          FROM poll
         WHERE device = :device AND time BETWEEN :since AND :until AND points = :points)
 WHERE place < readings
 ORDER BY time
"""


class HistoricalValue(NamedTuple):
    """
    A value of a point in the past.

    Attributes:
        time: seconds since the epoch.
        value: the value; True and False are 1 and 0, a list or an object is text in JSON. None
            unless the quality is "good".
        quality: as of `Reading`.
    """

    time: float
    value: Any
    quality: str


def history(
    path: str, device: str, name: str, since: float, until: float, most: int = 1000
) -> list[HistoricalValue]:
    """Return the values of a point from the journal at a path; see `Journal.history`."""
    integer("most", most, 3, 1_000_000)
    place = f"{Path(path).absolute().as_uri()}?mode=ro"
    with journal_errors(path), contextlib.closing(sqlite3.connect(place, uri=True)) as database:
        database.execute(f"PRAGMA busy_timeout = {BUSY_MS}")
        positions = database.execute(POSITIONS, (device, name)).fetchall()
        span = {"since": since, "until": until}
        series = [
            map(
                HistoricalValue._make,
                database.execute(VALUES, {"device": id, "points": points, "at": at, **span}),
            )
            for id, points, at in positions
        ]
        return thinned(merge(*series, key=lambda value: value.time), since, until, most)


def past_in(path: str) -> Older:
    """Return a function that finds the numbers of a value in a journal; None is a gap."""

    def past(*query: Any) -> list[tuple[float, float | None]]:
        try:
            values = history(path, *query)
        except JournalError as error:
            logger.info("%s: %s", path, error)
            return []
        return [
            (time, value if isinstance(value, int | float) else None) for time, value, _ in values
        ]

    return past


def thinned(
    values: Iterable[HistoricalValue], since: float, until: float, most: int
) -> list[HistoricalValue]:
    """Return at most so many values, 3 or more, of those in the order of their times."""
    values = iter(values)
    whole = list(islice(values, most + 1))
    if len(whole) <= most:
        return whole
    spans = most // 3
    length = max(until - since, 1e-6) / spans
    result: list[HistoricalValue] = []
    for _, group in groupby(
        chain(whole, values), lambda value: min(spans - 1, int((value.time - since) / length))
    ):
        result += _of_span(group)
    return result


def _of_span(group: Iterable[HistoricalValue]) -> list[HistoricalValue]:
    smallest = greatest = bad = None
    for at, value in enumerate(group):
        if value.quality != "good" or not isinstance(value.value, int | float):
            bad = bad or (at, value)
            continue
        if smallest is None or value.value < smallest[1].value:
            smallest = (at, value)
        if greatest is None or value.value >= greatest[1].value:
            greatest = (at, value)
    extremes = dict(pair for pair in (smallest, greatest, bad) if pair is not None)
    return [extremes[at] for at in sorted(extremes)]
