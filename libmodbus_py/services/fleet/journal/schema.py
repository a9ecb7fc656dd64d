"""
The tables of a journal.

::

    device (id, name, labels)               labels in JSON; a row for each set of labels
    point  (id, points, device, name, unit) `points` is the id of the first point of its list
    poll   (id, readings, time, device, points, chosen, data, trouble)       see `Row`
    place  (output, confirmed)              the last reading that each output has confirmed
    reading                                 a view: one row for each reading

The newest list of points of a device has all points that the device ever had. A poll refers to
positions in this list; only a poll with another point begins a new list. So polls of some points,
such as those that have changed, add no lists, also after a failed transaction or in the next run.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

from ....protocol.json_text import COMPACT_JSON
from ....protocol.plain import plain
from ..readings import Reading

# In the header of the file; `file` and other programs name the kind of a database by it.
APPLICATION = 0x4D424A31
VERSION = 1

SCHEMA = """
CREATE TABLE device (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    labels TEXT NOT NULL DEFAULT '{}',
    UNIQUE (name, labels)
);
CREATE TABLE point (
    id INTEGER PRIMARY KEY,
    points INTEGER NOT NULL,
    device INTEGER NOT NULL REFERENCES device,
    name TEXT NOT NULL,
    unit TEXT NOT NULL
);
CREATE INDEX point_of_device ON point (device, points);
CREATE TABLE poll (
    id INTEGER PRIMARY KEY,
    readings INTEGER NOT NULL,
    time REAL NOT NULL,
    device INTEGER NOT NULL REFERENCES device,
    points INTEGER NOT NULL REFERENCES point,
    chosen TEXT,
    data TEXT NOT NULL,
    trouble TEXT
);
CREATE INDEX poll_of_device ON poll (device, time);
CREATE TABLE place (
    output TEXT PRIMARY KEY,
    confirmed INTEGER NOT NULL
) WITHOUT ROWID;
CREATE VIEW reading AS
SELECT poll.id + value.key AS id,
       strftime('%Y-%m-%dT%H:%M:%fZ', poll.time, 'unixepoch') AS time,
       device.name AS device,
       point.name AS name,
       value.value AS value,
       point.unit AS unit,
       coalesce(json_extract(poll.trouble, '$."' || value.key || '"[0]'), 'good') AS quality,
       coalesce(json_extract(poll.trouble, '$."' || value.key || '"[1]'), '') AS reason,
       device.labels AS labels,
       poll.time AS seconds
  FROM device
  JOIN poll ON poll.device = device.id
  JOIN json_each(poll.data) AS value
  JOIN point ON point.id = poll.points
       + coalesce(json_extract(poll.chosen, '$[' || value.key || ']'), value.key);
"""

_SIMPLE = {int, float, bool, str, type(None)}


class JournalPoll(NamedTuple):
    """The readings of one poll of a device, with the ids from `first` to `last`."""

    first: int
    last: int
    readings: Sequence[Reading]


class Points(NamedTuple):
    """The positions in a list of points of a device, by name and units; the first one has `id`."""

    id: int
    device: int
    positions: Mapping[tuple[str, str], int]


class Row(NamedTuple):
    """
    A row of the table `poll`; `data`, `chosen` and `trouble` are JSON.

    `chosen` has the positions of the points in their list; None for the first ones, in order.
    `trouble` has quality and reason of readings that are not good, by their positions in `data`.
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
    for _, group in groupby(readings, lambda reading: reading.poll):
        poll = list(group)
        if poll[0].id != first:
            poll = [reading._replace(id=first + at) for at, reading in enumerate(poll)]
        yield JournalPoll(first, first + len(poll) - 1, poll)
        first += len(poll)


def encoded(poll: JournalPoll, points: Points) -> Row:
    """Return a poll as a row; raise KeyError if a reading is of none of the points."""
    readings = poll.readings
    positions = [points.positions[reading.name, reading.units] for reading in readings]
    values = [reading.value for reading in readings]
    if not _SIMPLE.issuperset(map(type, values)):
        values = [plain(value) for value in values]
    try:
        data = COMPACT_JSON.encode(values)
    except ValueError:  # nan or infinite
        data = COMPACT_JSON.encode(plain(values))
    trouble = {
        str(at): [reading.quality, reading.reason]
        for at, reading in enumerate(readings)
        if reading.reason or reading.quality != "good"
    }
    return Row(
        poll.first,
        len(readings),
        readings[0].time,
        points.device,
        points.id,
        None if positions == [*range(len(positions))] else COMPACT_JSON.encode(positions),
        data,
        COMPACT_JSON.encode(trouble) if trouble else None,
    )


def decoded(
    row: Row, device: str, labels: Mapping[str, str], names: Sequence[tuple[str, str]]
) -> JournalPoll:
    """Return a row as a poll of a device that has points with these names and units."""
    values = json.loads(row.data)
    positions = range(row.readings) if row.chosen is None else json.loads(row.chosen)
    trouble = json.loads(row.trouble) if row.trouble else {}
    readings = [
        Reading(row.time, device, name, value, units, "good", "", row.id + at, labels)
        for at, ((name, units), value) in enumerate(
            zip([names[position] for position in positions], values, strict=True)
        )
    ]
    for at, (quality, reason) in trouble.items():
        readings[int(at)] = readings[int(at)]._replace(quality=quality, reason=reason)
    return JournalPoll(row.id, row.id + len(readings) - 1, readings)


# More readings than can be sent to outputs, and be lost in a crash before they are on the disk.
MARGIN = 10_000_000


def first_id(now: float, last: int) -> int:
    """
    Return the first id of a run behind a last id, 0 if there is none: the time in microseconds, so
    that a journal in place of a deleted one has greater ids.
    """
    return max(int(now * 1e6), last + MARGIN if last else 1)


_DAMAGE = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}

_REASONS: dict[int, str] = {
    sqlite3.SQLITE_FULL: "the disk is full",
    sqlite3.SQLITE_READONLY: "cannot be written to",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened; its folder must exist, and be writable",
    sqlite3.SQLITE_PERM: "must not be opened",
    sqlite3.SQLITE_BUSY: "another program has locked it",
    sqlite3.SQLITE_LOCKED: "another program has locked it",
    sqlite3.SQLITE_IOERR: "the disk reports an error",
}


class JournalError(Exception):
    """A journal cannot be used: another program uses it, or the disk is full, for example."""


class JournalDamaged(JournalError):
    """The file of a journal is damaged, or another program has deleted or replaced it."""


@contextlib.contextmanager
def journal_errors(path: str) -> Iterator[None]:
    """Raise errors of SQLite and of the system as those of journals."""
    try:
        yield
    except sqlite3.Error as error:
        code = (getattr(error, "sqlite_errorcode", None) or 0) & 0xFF
        if code in _DAMAGE:
            raise JournalDamaged(f"{path}: is damaged: {error}") from error
        raise JournalError(f"{path}: {_REASONS.get(code, str(error))}") from error
    except OSError as error:
        raise JournalError(f"{path}: {error.strerror or error}") from error
