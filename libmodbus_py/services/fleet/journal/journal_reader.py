"""
Readers of a journal, also while it is being written: polls for outputs that are behind, and the
past of a value for charts. These functions block.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Mapping
from heapq import merge
from itertools import chain, groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ....protocol.checks import integer
from ....protocol.logs import HarmlessLogger
from ..readings import NO_LABELS
from .schema import JournalError, JournalPoll, Points, Row, decoded, raised

if TYPE_CHECKING:
    from ....tools.page.table_source import Older

__all__ = ["HistoricalValue", "JournalReader", "history", "past_in", "thinned"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Milliseconds to wait for a lock; readers need one only while a journal is opened or closed.
BUSY_MS = 2000

POLLS = f"SELECT {', '.join(Row._fields)} FROM poll WHERE id > ? ORDER BY id"

POINTS = "SELECT device, name, unit FROM point WHERE points = ? ORDER BY id"

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


def _connected(path: str) -> sqlite3.Connection:
    place = f"{Path(path).absolute().as_uri()}?mode=ro"
    database = sqlite3.connect(place, uri=True, isolation_level=None, check_same_thread=False)
    database.execute(f"PRAGMA busy_timeout = {BUSY_MS}")
    return database


class JournalReader:
    """Reads polls for outputs that are behind; one thread at a time calls its methods."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._database: sqlite3.Connection | None = None
        self._points: dict[int, tuple[str, Mapping[str, str], Points]] = {}

    def read(self, after: int, most: int) -> list[JournalPoll]:
        """Return the polls behind an id, at least one if there is one, without damaged rows."""
        with raised(self._path):
            if self._database is None:
                self._database = _connected(self._path)
            found: list[JournalPoll] = []
            count = 0
            with contextlib.closing(self._database.execute(POLLS, (after,))) as rows:
                for row in map(Row._make, rows):
                    count += row.readings
                    if found and count > most:
                        break
                    if (poll := self._decoded(row)) is not None:
                        found.append(poll)
            return found

    def _decoded(self, row: Row) -> JournalPoll | None:
        try:
            if row.points not in self._points:
                self._points[row.points] = self._points_of(row.points)
            return decoded(row, *self._points[row.points])
        except (AttributeError, LookupError, TypeError, ValueError, RecursionError) as error:
            logger.error("%s: poll %s cannot be read: %s", self._path, row.id, error)
            return None

    def _points_of(self, number: int) -> tuple[str, Mapping[str, str], Points]:
        assert self._database is not None
        points = self._database.execute(POINTS, (number,)).fetchall()
        device = points[0][0]
        query = "SELECT name, labels FROM device WHERE id = ?"
        [[name, labels]] = self._database.execute(query, (device,))
        named = [(point, unit) for _, point, unit in points]
        return name, json.loads(labels) or NO_LABELS, Points(number, device, named)

    def close(self) -> None:
        """Close the file, until `read` is called again."""
        database, self._database = self._database, None
        self._points = {}
        if database is not None:
            database.close()


def history(
    path: str, device: str, name: str, since: float, until: float, most: int = 1000
) -> list[HistoricalValue]:
    """Return the values of a point from the journal at a path; see `Journal.history`."""
    integer("most", most, 3, 1_000_000)
    with raised(path), contextlib.closing(_connected(path)) as database:
        positions = database.execute(POSITIONS, (device, name)).fetchall()
        span = {"since": since, "until": until}
        series = [
            map(
                HistoricalValue._make,
                database.execute(VALUES, {"device": id, "points": points, "at": at, **span}),
            )
            for id, points, at in positions
        ]
        return thinned(merge(*series, key=lambda each: each.time), since, until, most)


def past_in(path: str) -> Older:
    """Return a function that finds the numbers of a value in a journal; None is a gap."""

    def past(*asked: Any) -> list[tuple[float, float | None]]:
        try:
            found = history(path, *asked)
        except JournalError as error:
            logger.info("%s: %s", path, error)
            return []
        return [
            (time, value if isinstance(value, int | float) else None) for time, value, _ in found
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
    found: list[HistoricalValue] = []
    for _, group in groupby(
        chain(whole, values), lambda each: min(spans - 1, int((each.time - since) / length))
    ):
        found += _of_span(group)
    return found


def _of_span(group: Iterable[HistoricalValue]) -> list[HistoricalValue]:
    smallest = greatest = bad = None
    for at, each in enumerate(group):
        if each.quality != "good" or not isinstance(each.value, int | float):
            bad = bad or (at, each)
            continue
        if smallest is None or each.value < smallest[1].value:
            smallest = (at, each)
        if greatest is None or each.value >= greatest[1].value:
            greatest = (at, each)
    chosen = dict(each for each in (smallest, greatest, bad) if each is not None)
    return [chosen[at] for at in sorted(chosen)]
